# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From a plan to the certificate of its bound: the tree that the search left, or that of another.

Nothing of this has to be believed: see :mod:`orbimpc_ros.mpc.proof.verify`.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput, Infeasible, OrbimpcError, SolverFailure
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.reach import clear_of_hazards
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.proof import document
from orbimpc_ros.mpc.proof.document import Certificate, Refutation
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.reading import Refused, parsed
from orbimpc_ros.mpc.proof.tree import in_users_units
from orbimpc_ros.mpc.solve.request import Enough, Request

TOLERANCE = 1e-9  # relative gap at which a search for a proof ends without it
AMPLE = 2e-8  # relative: by so much more is searched for, since relaxations are solved in floats
WORD = 'not proved: the word of the method'
OutOfTime = Callable[[], bool]
Made = TypeVar('Made', Certificate, Refutation)


class Unproved(OrbimpcError):
    """There is no certificate: for problems of a kind, or for a bound."""


def patient() -> bool:
    """Return that there is time left, always."""
    return False


def held(make: Callable[[], Iterable[Made]]) -> Made | None:
    """Return the first of some certificates that holds, in exact arithmetic; None without one."""
    try:
        return next((each for each in make() if holds(each)), None)
    except (Unproved, Refused, BadInput):  # of what is no model there; without Clarabel
        return None


def held_in_time(
    make: Callable[[OutOfTime], Iterable[Made]], clock: Callable[[], float], end: float
) -> Made | None:
    """Return the first of some certificates that holds; None without one in time.

    To go through one takes no longer than to make it, where each leaf is gone through, too: half of
    the time is for either. Beyond that it takes what a single leaf does at most.

    Args:
        make: makes them, until it is out of time.
        clock: of the end [s].
        end: by when one is wanted [s]; infinite for whenever it is there.
    """
    now = clock()
    if now >= end:
        return None
    half = now + 0.5 * (end - now)
    return held(lambda: make(lambda: clock() >= half))


def certificate_of(
    problem: Problem, state: State, goals: Array, bound: float, out_of_time: OutOfTime = patient
) -> Certificate:
    """Return what proves a lower bound, by a search that ends where as much is proved.

    Args:
        problem: what was solved.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        bound: to prove, as published.
        out_of_time: polled by the search; True makes it give up.

    Raises:
        Unproved: none was found.
    """
    from orbimpc_ros.mpc.solve.registry import method_among, method_for  # which need proofs

    units, bound = Units.of(problem), max(0.0, bound)
    searched = clear_of_hazards(problem, state) if state.hazards else state
    coasting, made = state.coasted is not None, method_among if searched.hazards else method_for
    enough = Enough(bound=bound * (1.0 + AMPLE) / units.cost)
    scaled = units.state(searched), units.lengths(goals)
    try:
        method = made(units.problem, TOLERANCE, coasting=coasting and problem.rotation_order == 2)
        found = method.solve(Request(*scaled, None, out_of_time, True, enough))
    except (Infeasible, SolverFailure) as error:
        raise Unproved(f'no certificate: {error}') from None
    tree = found.proof
    if tree is None:
        raise Unproved(f'no certificate: {found.nodes} relaxations prove nothing')
    return Certificate(problem, state, goals, bound, in_users_units(tree, units))


def certificates_for(
    problem: Problem,
    state: State,
    goals: Array,
    plan: Plan,
    bound: float,
    out_of_time: OutOfTime = patient,
) -> Iterator[Certificate]:
    """Yield what may prove a bound: what the plan's method left of it, then another search.

    Args:
        problem: what was solved.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        plan: of the method.
        bound: to prove.
        out_of_time: as for :func:`certificate_of`.

    Raises:
        Unproved: as :func:`certificate_of` does.
    """
    left = kept(problem, state, goals, replace(plan.proof, lower_bound=max(0.0, bound)))
    if left is not None:
        yield left
    yield certificate_of(problem, state, goals, bound, out_of_time)


def certificate_for(
    problem: Problem,
    state: State,
    goals: Array,
    plan: Plan,
    bound: float,
    out_of_time: OutOfTime = patient,
) -> Certificate:
    """Return the first of :func:`certificates_for` that proves as much, or else the last."""
    made = None
    for made in certificates_for(problem, state, goals, plan, bound, out_of_time):
        if holds(made):
            break
    assert made is not None
    return made


def holds(made: Certificate | Refutation) -> bool:
    """Return whether a certificate holds, read as anyone would read it."""
    try:
        return document.verified(parsed(made.text().encode())).holds
    except Refused:
        return False
