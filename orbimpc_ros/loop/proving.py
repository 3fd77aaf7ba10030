# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proofs of a decision, in exact arithmetic, looked for after its command was sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.loop.planner import Decision, joined


def proved(
    decision: Decision, clock: Callable[[], float], end: float, *, catches: bool = False
) -> Decision:
    """Return the decision with proofs of what it states, as far as there are any in time.

    That is that nothing is feasible, and that nothing is caught before a time.

    Args:
        decision: to be proved.
        clock: by which proofs end.
        end: on that clock [s].
        catches: whether to refute earlier catches, too.
    """
    if decision.infeasible is None and not (catches and decision.catch):
        return decision
    # Imported by the first decision that needs it: a tenth of a second that starts are spared.
    from orbimpc_ros.mpc.proof.prove import WORD, held_in_time
    from orbimpc_ros.mpc.proof.refute import catches_refuted, refutation_of

    nothing, catch = decision.infeasible, decision.catch
    if nothing is not None:
        made = held_in_time(lambda late: refutation_of(nothing, late), clock, end)
        if made is None:
            decision = replace(decision, reason=joined(decision.reason, WORD))
        return replace(decision, refutation=made)
    assert catch is not None
    count = steps_before(catch.bound, catch.sought.problem.step)
    if not count:
        return decision
    made = held_in_time(lambda late: catches_refuted(catch.sought, count, late), clock, end)
    return replace(decision, refutation=made)
