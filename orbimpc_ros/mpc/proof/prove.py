# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates that hold: of the bound of a plan, and of refutations, within a time.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.mpc.plan import Proof
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof import document
from orbimpc_ros.mpc.proof.document import Certificate, Refutation
from orbimpc_ros.mpc.proof.reading import Refused, parsed

WORD = 'not proved: the word of the method'
OutOfTime = Callable[[], bool]
Made = TypeVar('Made', Certificate, Refutation)


class Unproved(OrbimpcError):
    """There is no certificate: for problems of a kind, or for a bound."""


def patient() -> bool:
    """Return that there is time left, always."""
    return False


def held(make: Callable[[], Made]) -> Made | None:
    """Return the certificate that is made, if it holds in exact arithmetic; None without one."""
    try:
        made = make()
        return made if holds(made) else None
    except (Unproved, Refused, BadInput):  # of what is no model there; without Clarabel
        return None


def held_in_time(
    make: Callable[[OutOfTime], Made], clock: Callable[[], float], end: float
) -> Made | None:
    """Return the certificate that is made, if it holds; None without one in time.

    To go through one takes no longer than to make it, where each leaf is gone through, too: half of
    the time is for either. Beyond that it takes what a single leaf does at most.

    Args:
        make: makes it, until it is out of time.
        clock: of the end [s].
        end: by when one is wanted [s]; infinite for whenever it is there.
    """
    now = clock()
    if now >= end:
        return None
    half = now + 0.5 * (end - now)
    return held(lambda: make(lambda: clock() >= half))


def certificate_of(problem: Problem, state: State, goals: Array, proof: Proof) -> Certificate:
    """Return the certificate of a plan's bound: the tree that its search left.

    Args:
        problem: what was solved.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        proof: of the plan.

    Raises:
        Unproved: the search left none.
    """
    if proof.tree is None:
        raise Unproved('no certificate: the search left no proof of its bound')
    return Certificate(problem, state, goals, max(0.0, proof.lower_bound), proof.tree)


def holds(made: Certificate | Refutation) -> bool:
    """Return whether a certificate holds, read as anyone would read it."""
    try:
        return document.verified(parsed(made.text().encode())).holds
    except Refused:
        return False
