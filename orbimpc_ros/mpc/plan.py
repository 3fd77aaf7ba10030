# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A plan: the trajectory found, its proof of quality, and the command for its first step.

Mathematics: docs/mathematics.md, 6.1, 7.2 and 7.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, Sealed
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp, log, matrix, project_all
from orbimpc_ros.mpc.model.dynamics import Trajectory, flown
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.reach import entry_speed
from orbimpc_ros.mpc.proof.tree import ProofTree

TINY = 1e-12  # smaller vectors have no direction
WITHIN = 1.0 - 1e-9  # share of the widest turn, so that rounding does not exceed it
NEGLIGIBLE = 1e-5  # of the cost unit: gaps are relative to this if the objective is smaller


@dataclass(frozen=True)
class Proof:
    """What is proved about a plan's distance from the optimum.

    Attributes:
        lower_bound: the search's bound on the cost of all trajectories of the problem; -inf if
            nothing was proved.
        nodes: number of relaxations solved.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        cost_unit: the natural size of costs of the problem; 1e-5 of it are negligible.
        reason: why no more was proved; empty if the gap is the only reason.
        checked: whether the verifier has proved the bound from the tree.
        tree: proves the bound, in the problem's own units; None if there is none.
    """

    lower_bound: float
    nodes: int
    gap_tolerance: float
    cost_unit: float
    reason: str = ''
    checked: bool = False
    tree: ProofTree | None = field(default=None, compare=False, repr=False)


UNPROVED = Proof(-np.inf, 0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Plan(Trajectory, ByContent):
    """A trajectory over N steps with its certificate. All arrays are read-only.

    Attributes:
        x: rotation coordinates of R_0..R_N, shape (N + 1, d).
        projected: R_0..R_N projected to rotations, shape (N + 1, n, n); for R_k e1 = 0, whose
            heading is undefined, the previous one.
        projection: ``nearest`` or ``thrust_aligned``: how ``projected`` was made.
        proof: its lower bound and how it was found.
    """

    x: Array
    projected: Array
    projection: str
    proof: Proof

    @cached_property
    def horizon(self) -> int:
        """Return N."""
        return len(self.rotations) - 1

    @cached_property
    def lower_bound(self) -> float:
        """Return a lower bound on the cost of all trajectories; -inf if none was computed.

        An unverified bound counts as at most 0, which is a bound since no term is negative.
        """
        claimed = self.proof.lower_bound
        return claimed if self.proof.checked else min(0.0, claimed)

    @property
    def gap(self) -> float:
        """Return (objective - lower bound) / max(|objective|, 1e-5 cost units)."""
        return self._gap_to(self.lower_bound)

    @cached_property
    def status(self) -> Status:
        """Return ``OPTIMAL`` if that is proved within the gap tolerance, ``FEASIBLE`` otherwise.

        An unverified bound proves nothing.
        """
        proved = self.is_closed and self.proof.checked
        return Status.OPTIMAL if proved else Status.FEASIBLE

    @cached_property
    def is_closed(self) -> bool:
        """Return True if the bound is within the gap tolerance, verified or not."""
        return bool(self._gap_to(self.proof.lower_bound) <= self.proof.gap_tolerance)

    def _gap_to(self, bound: float) -> float:
        least = max(NEGLIGIBLE * self.proof.cost_unit, abs(self.objective), np.finfo(float).tiny)
        return (self.objective - bound) / least

    @cached_property
    def speed_fraction(self) -> Array:
        """Return |R_k e1|, shape (N + 1,)."""
        sizes: Array = np.linalg.norm(self.rotations[:, :, 0], axis=1)
        sizes.setflags(write=False)
        return sizes

    @property
    def projection_distance(self) -> Array:
        """Return the Frobenius distance from each R_k to its rotation, shape (N + 1,)."""
        return np.linalg.norm(self.rotations - self.projected, axis=(1, 2))


def assemble(
    problem: Problem, state: State, goals: Array, x: Array, *, projection: str, proof: Proof
) -> Plan:
    """Return the plan of rotation coordinates x_1..x_N, shape (N, d), found by a solver.

    Everything else follows from the dynamics, so that the plan is consistent by construction.
    """
    rotations, x = matrix(x), np.concatenate([coordinates(state.rotation)[None], x])
    decided = [state.attitude]
    if problem.rotation_order == 2 and state.coasted is not None:
        decided.append(state.coasted)  # the body turns there whatever the thrust
    turned = project_all(rotations[len(decided) - 1 :], decided[-1], projection)
    made, projected = flown(problem, state, goals, rotations), np.concatenate([decided, turned])
    for array in (made.positions, made.velocities, made.rotations, x, projected):
        array.setflags(write=False)
    return Plan(**vars(made), x=x, projected=projected, projection=projection, proof=proof)


def interpolated(at: Array, knots: Array, values: Array) -> Array:
    """Return values, (M, d), at knots, (M,), interpolated at points, (K,); held outside: (K, d)."""
    return np.column_stack([np.interp(at, knots, column) for column in values.T])


def shifted(problem: Problem, state: State, plan: Plan, knots: Array | None = None) -> Array | None:
    """Return the remaining steps of the previous plan, the last rotation held, shape (N, d).

    Between steps of the previous plan |R e1| is interpolated linearly: on the chord a vehicle would
    slow down. In the plane, where turns are limited as angles, headings follow the shifted ones as
    closely as the vehicle can turn from its attitude. None if the shift does not fit: at rotation
    order 2 the first rotation is given. ``knots``, shape (N,), are the ends of the new steps in
    steps of the previous plan, which by default is one step old.
    """
    if problem.rotation_order == 2:
        return None
    x, limited = plan.x, problem.dimension == 2 and problem.turns_are_angles
    at = 1.0 + np.arange(1, problem.horizon + 1) if knots is None else knots
    moved = _as_long(problem, x, interpolated(at, np.arange(0.0, len(x)), x), at)
    return followed(problem, state, moved) if limited else moved


def _as_long(problem: Problem, x: Array, moved: Array, at: Array) -> Array:
    """Scale rotations on chords, shape (K, d), to |R e1| interpolated between the ends.

    In space they may then leave the orbitope, so they are only scaled up to the floor's radius.
    """
    n, lengths = problem.dimension, np.linalg.norm(x[:, : problem.dimension], axis=1)
    sizes = np.interp(at, np.arange(len(x)), lengths)[:, None]
    on_chord = np.linalg.norm(moved[:, :n], axis=1, keepdims=True)
    if n == 3:
        sizes = np.maximum(on_chord, np.minimum(sizes, problem.floor.radius))
    return np.asarray(moved * np.where(on_chord > 0.0, sizes / np.maximum(on_chord, TINY), 1.0))


def followed(problem: Problem, state: State, x: Array) -> Array:
    """Return headings as a vehicle in the plane follows them at its turn limit, shape (K, 2).

    With a floor they keep their lengths; otherwise it flies their components, as in (7.2a).
    """
    widest, headings = WITHIN * problem.widest_turn, np.zeros_like(x)
    angle = math.atan2(state.attitude[1, 0], state.attitude[0, 0])
    for k, (along, aside) in enumerate(x.tolist()):
        size = math.hypot(along, aside)
        wanted = math.remainder(math.atan2(aside, along) - angle, 2.0 * math.pi) if size else 0.0
        turn = min(max(wanted, -widest), widest)
        angle += turn
        share = size if problem.turns_are_angles else size * max(0.0, math.cos(wanted - turn))
        headings[k] = share * math.cos(angle), share * math.sin(angle)
    return headings


@dataclass(frozen=True, eq=False)
class Command(Sealed):
    """The next command: a body rate to turn at during the step, and a speed from its end on.

    Attributes:
        speed_fraction: share of full speed (translation order 1) or thrust (order 2), in [0, 1].
        body_rate: angular velocity in the body frame, shape (1,) or (3,) [rad/s].
        rotation: attitude commanded for the end of the step, shape (n, n).
    """

    speed_fraction: float
    body_rate: Array
    rotation: Array


def stop(rotation: Array) -> Command:
    """Return the safe command: no speed, no turning, the present attitude, shape (n, n)."""
    return Command(0.0, np.zeros(1 if len(rotation) == 2 else 3), np.array(rotation))


def command_of(problem: Problem, state: State, plan: Plan) -> Command:
    """Return the command for the first step of a checked plan (7.2a).

    At rotation order 2 the present body rate already carries Q_0 to Q_1: commanded is the rate from
    then on. It never exceeds ``max_rate``. In the plane a floor ensures this for plans, too; else
    (without a floor if a short chord spans a wide angle, in space because of rolls) the rate is
    cut, and the commanded rotation is the one then reached. Without a floor the speed or thrust is
    then the planned one's component along that axis: at full speed the vehicle would miss the turn,
    and could circle its goal for ever. Its change of speed remains limited, though.
    """
    first = problem.rotation_order - 1
    start, end = plan.projected[first], plan.projected[min(first + 1, plan.horizon)]
    # Rounding may leave a plan just below its floor; commands must not be.
    fraction = min(1.0, max(problem.least_speed, float(plan.speed_fraction[1])))
    rate = log(start.T @ end) / problem.step
    size = math.sqrt(rate @ rate)
    if problem.max_rate > 0.0 and size > problem.max_rate:
        rate = rate * (problem.max_rate / size)
        planned, end = end, start @ exp(rate * problem.step)
        if problem.rotation_order == 1 and not problem.floor.exists:
            along = fraction * min(1.0, max(0.0, float(planned[:, 0] @ end[:, 0])))
            slowest = entry_speed(problem, state) - problem.speed_change
            fraction = max(along, min(fraction, slowest))
    return Command(fraction, rate, np.array(end))


def joined(*reasons: str) -> str:
    """Return reasons in one line, without empty ones."""
    return '; '.join(filter(None, reasons))
