# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proofs of a decision, in exact arithmetic, looked for after its command was sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.loop.task import joined
from orbimpc_ros.mpc.plan import Plan


def proved(
    decision: Decision, clock: Callable[[], float], end: float, *, catches: bool = False
) -> Decision:
    """Return the decision with proofs of what it states, as far as there are any in time.

    That is of a bound that closes the gap and was not verified by the solver, that nothing is
    feasible, and that nothing is caught before a time.

    Args:
        decision: to be proved.
        clock: by which proofs end.
        end: on that clock [s].
        catches: whether to refute earlier catches, too.
    """
    if decision.plan is not None and decision.plan.is_the_methods_word and not decision.fallback:
        decision = _bounded(decision, decision.plan, clock, end)
    if decision.infeasible is None and not (catches and decision.catch):
        return decision
    # Imported by the first decision that needs it: a tenth of a second that starts are spared.
    from orbimpc_ros.mpc.proof.prove import WORD, held_in_time
    from orbimpc_ros.mpc.proof.refute import catches_refuted, refutation_of

    nothing, catch = decision.infeasible, decision.catch
    if nothing is not None:
        made = held_in_time(lambda late: [refutation_of(nothing, late)], clock, end)
        if made is None:
            decision = replace(decision, reason=joined(decision.reason, WORD))
        return replace(decision, refutation=made)
    assert catch is not None
    count = steps_before(catch.bound, catch.sought.problem.step)
    if not count:
        return decision
    made = held_in_time(lambda late: [catches_refuted(catch.sought, count, late)], clock, end)
    return replace(decision, refutation=made)


def _bounded(decision: Decision, plan: Plan, clock: Callable[[], float], end: float) -> Decision:
    """Return a decision with a certificate of a plan's bound, or the remark that there is none."""
    from orbimpc_ros.mpc.proof.prove import WORD, certificates_for, held_in_time

    assert decision.case is not None
    known = *decision.case, plan, plan.proof.lower_bound
    made = held_in_time(lambda late: certificates_for(*known, late), clock, end)
    if made is None:
        return replace(decision, reason=joined(decision.reason, WORD))
    plan = replace(plan, proof=replace(plan.proof, checked=True))
    return replace(decision, plan=plan, status=plan.status, certificate=made)
