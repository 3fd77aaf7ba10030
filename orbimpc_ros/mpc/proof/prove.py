# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From a plan to the certificate of its bound, whatever the method that found it.

A bound that is known is easier to prove than to find: one tangent at the plan proves most; where it
does not, the floor is split depth first, and a part is done as soon as it is seen to cost no less
than the bound. Nothing of this has to be believed: see :mod:`orbimpc_ros.mpc.proof.verifier`.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.proof import spatial
from orbimpc_ros.mpc.proof.certificate import (
    Certificate,
    Leaf,
    Refutation,
    Tree,
    in_users_units,
)
from orbimpc_ros.mpc.proof.faces import FaceProof
from orbimpc_ros.mpc.proof.fewer_limits import with_provable_limits
from orbimpc_ros.mpc.proof.grounds import Grounds
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.part_program import PartProgram
from orbimpc_ros.mpc.proof.sectors import SectorProof
from orbimpc_ros.mpc.proof.split_words import split_words
from orbimpc_ros.mpc.proof.stationary import Stationary, setting
from orbimpc_ros.mpc.proof.verifier import RELATIVE, Refused, parsed, posed_by, verified
from orbimpc_ros.mpc.proof.verifier.stated import StatedProblem
from orbimpc_ros.mpc.proof.walls import WallProof
from orbimpc_ros.mpc.solve.request import Enough, Request

NEAR = (1e-6, 1e-4, 1e-3)  # of a plan's moduli to their bounds: methods differ in accuracy
FEW = 500  # nodes of a search by faces or sectors up to which its own tree is the certificate
SHARE = 0.5  # of what a bound may exceed what is proved
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
        return next((each for each in make() if _holds(each)), None)
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
    problem: Problem,
    state: State,
    goals: Array,
    rotations: Array,
    bound: float,
    out_of_time: OutOfTime = patient,
) -> Certificate:
    """Return what proves a lower bound, given a plan near the optimum.

    Args:
        problem: what was solved.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        rotations: the plan's R_1..R_N, shape (N, n, n).
        bound: to prove, as published.
        out_of_time: polled before each part of all trajectories; True gives up.

    Raises:
        Unproved: problems of this kind have no certificates yet, or none was found.
    """
    bound, x = _posed(bound), coordinates(rotations)[:, : _width(problem)]
    certificate, target = Certificate(problem, state, goals, bound, Leaf(x)), _enough(bound)
    posed = _as_read(certificate)
    if _is_searched(problem):
        return _searched(certificate, target, out_of_time)
    problem, state = with_provable_limits(problem, state)
    units = Units.of(problem)
    if problem.rotation_order == 1 and _is_limited(problem, state):
        return _beside_walls(certificate, posed, units, target, out_of_time)
    scaled = units.problem, units.state(state), units.lengths(goals)
    if _width(problem) == 9:
        tangents = iter(spatial.tangents(*scaled, x))
    else:
        tangents = (Stationary(setting(*scaled), x, near).settled() for near in NEAR)
    best = 0.0
    for leaf in tangents:
        made = replace(certificate, tree=in_users_units(leaf, units))
        best = max(best, _proved(made))
        if best >= target:
            return made
    if _width(problem) == 9 and problem.rotation_order == 1:  # no accurate plan: its own program
        return _beside_walls(certificate, posed, units, target, out_of_time)
    if not _splits(problem):
        raise Unproved(
            f'no certificate: one tangent proves {best!r}, and there is nothing to split'
        )
    tree, origins = _split(scaled, x, target / units.cost, out_of_time)
    return replace(certificate, tree=in_users_units(tree, units), origins=origins)


def _is_searched(problem: Problem) -> bool:
    """Return whether speeds, or ways round to a cone, are split: as one search alone does."""
    paced, polygonal = problem.max_acceleration > 0.0, problem.floor.shape == 'polygon'
    limited = paced or (problem.max_rate and problem.approach.exists)
    if not (limited and _is_parted(problem)) or (paced and polygonal):
        return False
    from orbimpc_ros.mpc.solve.sector_bnb import SectorSearch  # takes machine code

    return SectorSearch.solves(problem)


def _searched(certificate: Certificate, target: float, out_of_time: OutOfTime) -> Certificate:
    """Return what the search proves that knows changes of speed, and ways round to a cone.

    Raises:
        Unproved: it does not prove as much, or the format has no words for it.
    """
    from orbimpc_ros.mpc.solve.sector_bnb import SectorSearch

    problem, state = certificate.problem, certificate.state
    units = Units.of(problem)
    search = SectorSearch(units.problem, 0.0)
    found = search.solve(
        Request(
            units.state(state),
            units.lengths(certificate.goals),
            out_of_time=out_of_time,
            enough=Enough(bound=target / units.cost),
        )
    )
    if found.lower_bound * units.cost < target:
        proved = found.lower_bound * units.cost
        raise Unproved(f'no certificate: {found.nodes} sectors prove {proved!r}')
    known = found.grounds
    said = isinstance(known, Grounds) and split_words(problem, state, known, target, units.cost)
    if not said:  # or there was no time for them
        raise Unproved('no certificate: there are no words for how a search split it')
    tree, origins = said
    return replace(certificate, tree=tree, origins=origins)


def _beside_walls(
    certificate: Certificate,
    posed: StatedProblem,
    units: Units,
    target: float,
    out_of_time: OutOfTime,
) -> Certificate:
    """Return what proves as much where there are walls, cones, or thrust limits over SO(3).

    Raises:
        Unproved: nothing was found, or it would be too large.
    """
    scaled = units.problem, units.state(certificate.state), units.lengths(certificate.goals)

    def stated(leaf: Leaf) -> dict[str, Any]:
        made = replace(certificate, tree=in_users_units(leaf, units)).document()['tree']
        return dict(made)

    program = PartProgram(*scaled, posed, units.length)
    proof = WallProof(program, posed, stated, units.length, target, out_of_time)
    tree = proof.tree()
    if tree is None:
        raise Unproved(f'no certificate: not within {proof.most} leaves, or as accurate, in time')
    return replace(certificate, tree=in_users_units(tree, units))


def _as_read(certificate: Certificate) -> StatedProblem:
    """Return the problem of a certificate as the verifier reads it.

    Raises:
        Unproved: the format cannot state it.
    """
    try:
        return posed_by(certificate.document())
    except Refused as error:
        raise Unproved(f'no certificate: {error}') from None


def certificates_for(
    problem: Problem,
    state: State,
    goals: Array,
    plan: Plan,
    bound: float,
    out_of_time: OutOfTime = patient,
) -> Iterator[Certificate]:
    """Yield what may prove a bound: what the plan's method left of it, then a proof of its own.

    A large search is left for where there is no other: a bound that is known takes a smaller one.

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
    bound = _posed(bound)
    grounds, proof = plan.proof.grounds, replace(plan.proof, lower_bound=bound)
    large = (
        isinstance(grounds, Grounds)
        and len(grounds.splits) > FEW
        and not _is_searched(problem)  # by the same search again
    )
    left = None if large else kept(problem, state, goals, proof)
    if left is not None:
        yield left
    try:
        yield certificate_of(problem, state, goals, plan.rotations[1:], bound, out_of_time)
    except Unproved:
        left = kept(problem, state, goals, proof) if large else None
        if left is None:
            raise
        yield left


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
        if _proved(made) >= _enough(bound):
            break
    assert made is not None
    return made


def _holds(made: Certificate | Refutation) -> bool:
    """Return whether a certificate holds, read as anyone would read it."""
    try:
        return verified(parsed(made.text().encode())).holds
    except Refused:
        return False


def _posed(bound: float) -> float:
    """Return a bound as it is stated: no term of the cost is negative."""
    return max(0.0, bound)


def _enough(bound: float) -> float:
    """Return what has to be proved for a bound to hold, with some of the allowance to spare."""
    return bound * (1.0 - SHARE * float(RELATIVE))


def _width(problem: Problem) -> int:
    """Return how many coordinates of a rotation the cost sees."""
    w = problem.weights
    if problem.dimension == 3 and problem.rotation_order == 1 and not (w.input or w.attitude):
        return 3
    return 2 if problem.dimension == 2 else 9


def _is_parted(problem: Problem) -> bool:
    """Return whether there is a floor whose directions can be split."""
    return problem.dimension == 2 and problem.floor.exists and problem.terminal == 'penalty'


def _is_limited(problem: Problem, state: State) -> bool:
    """Return whether there are walls, cones, limits of thrust over SO(3), or tethers."""
    directed = problem.has_cones or problem.approach.exists
    tied = (problem.max_rate or problem.max_acceleration) and not _is_parted(problem)
    thrust = problem.floor.exists or problem.weights.length
    turning = _width(problem) == 9 and thrust
    return bool(directed or problem.obstacles or state.hazards or turning or tied)


def _proved(certificate: Certificate) -> float:
    """Return what a certificate of one leaf proves; -inf where it is refused."""
    try:
        return verified(certificate.document()).proved
    except Refused:
        return -np.inf


def _splits(problem: Problem) -> bool:
    """Return whether there is a way to split a problem of the plane."""
    plain = not (problem.max_rate or problem.weights.length)
    shape = problem.floor.shape
    parted = shape == 'circle' or (shape == 'polygon' and plain)
    return parted and problem.dimension == 2 and problem.terminal == 'penalty'


def _split(
    scaled: tuple[Problem, State, Array], x: Array, target: float, out_of_time: OutOfTime
) -> tuple[Tree, Array | None]:
    """Return a tree of splits that proves as much, in natural units, and its origins.

    Raises:
        Unproved: it would be too large.
    """
    problem, state, goals = scaled
    proof: FaceProof | SectorProof
    if problem.floor.shape == 'polygon':
        proof = FaceProof(problem, state, goals, target, out_of_time)
    else:
        proof = SectorProof(problem, state, goals, x, target, out_of_time)
    tree = proof.tree()
    if tree is None:
        raise Unproved(f'no certificate: not within {proof.most} leaves, or as accurate, in time')
    return tree, proof.origins
