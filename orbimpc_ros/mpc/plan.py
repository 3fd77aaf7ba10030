# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A plan: the trajectory found, how good it is proved to be, and the command for its first step.

Mathematics: docs/mathematics.md, 6.1, 7.2 and 7.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp, log, project_all
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.proof.tree import ProofTree

TINY = 1e-12  # a size that has no direction
WITHIN = 1.0 - 1e-9  # of the widest turn, which rounding is not to exceed
NEGLIGIBLE = 1e-5  # of the cost unit: what gaps are relative to where objectives are smaller


@dataclass(frozen=True)
class Proof:
    """What is known of a plan's distance from the optimum.

    Attributes:
        lower_bound: no trajectory of the problem costs less, as the search has it; -inf where
            nothing was proved.
        nodes: relaxations solved on the way.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        cost_unit: the natural size of costs of the problem; 1e-5 of it are negligible.
        reason: why no more was proved, where there is more to say than the gap.
        checked: whether the bound is no more than what the verifier makes of the tree.
        tree: which proves the bound, in the problem's own units; None where there is none.
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
class Plan(ByContent):
    """A trajectory over N steps with its certificate. All arrays are read-only.

    Attributes:
        objective: cost of this trajectory, evaluated from its own numbers.
        proof: what it is held against.
        projection: ``nearest`` or ``thrust_aligned``: how ``projected`` was made.
        positions: s_0..s_N, shape (N + 1, n) [m].
        velocities: p_0..p_N, shape (N + 1, n) [m/s].
        rotations: R_0..R_N in conv SO(n), shape (N + 1, n, n).
        inputs: u_0..u_{N-1}, shape (N, n, n).
        projected: rotations made of R_0..R_N, shape (N + 1, n, n).
        held: for which k R_k e1 = 0 left the heading undefined, so the previous one was held,
            shape (N + 1,).
    """

    objective: float
    proof: Proof
    projection: str
    positions: Array
    velocities: Array
    rotations: Array
    inputs: Array
    projected: Array
    held: np.ndarray

    def __post_init__(self) -> None:
        moved = self.positions, self.velocities, self.rotations, self.inputs
        for array in (*moved, self.projected, self.held):
            array.setflags(write=False)

    @cached_property
    def horizon(self) -> int:
        """Return N."""
        return len(self.inputs)

    @cached_property
    def lower_bound(self) -> float:
        """Return a cost that no trajectory of the problem undercuts; -inf if none was looked for.

        A bound that was not verified is none: no term of the cost is negative.
        """
        claimed = self.proof.lower_bound
        return claimed if self.proof.checked else min(0.0, claimed)

    @property
    def nodes(self) -> int:
        """Return how many relaxations were solved."""
        return self.proof.nodes

    @property
    def gap(self) -> float:
        """Return (objective - lower bound) / max(|objective|, 1e-5 cost units)."""
        return self._gap_to(self.lower_bound)

    @cached_property
    def status(self) -> Status:
        """Return whether it is proved optimal, within the gap tolerance, or merely feasible.

        A bound that was not verified proves nothing.
        """
        proved = self.is_closed and self.proof.checked
        return Status.OPTIMAL if proved else Status.FEASIBLE

    @cached_property
    def is_closed(self) -> bool:
        """Return whether the bound is within the gap tolerance, verified or not."""
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
    flown = trajectory_of(problem, state, goals, x)
    rotations = flown.rotations
    projected = np.empty_like(rotations)
    held = np.zeros(len(rotations), dtype=bool)
    projected[0] = state.attitude
    known = 1
    if problem.rotation_order == 2 and state.coasted is not None:
        projected[1], known = state.coasted, 2  # whatever the thrust, the body turns there
    before = projected[known - 1]
    projected[known:], held[known:] = project_all(rotations[known:], before, projection)
    return Plan(
        objective=flown.cost,
        proof=proof,
        projection=projection,
        positions=flown.positions,
        velocities=flown.velocities,
        rotations=rotations,
        inputs=flown.inputs,
        projected=projected,
        held=held,
    )


def later(values: Array, at: Array) -> Array:
    """Return values between their entries, on the chords, and the last one beyond them.

    Args:
        values: entries 0..M - 1, shape (M, d).
        at: places among them, counted in entries, at least 0; shape (K,).
    """
    below = np.minimum(at.astype(int), len(values) - 1)
    share = (at - below)[:, None]
    above = np.minimum(below + 1, len(values) - 1)
    return np.asarray(values[below] + share * (values[above] - values[below]))


def shifted(problem: Problem, state: State, plan: Plan, knots: Array | None = None) -> Array | None:
    """Return the rest of the previous plan, its last rotation held: coordinates, shape (N, d).

    Between two steps of the previous plan R e1 turns evenly, as its length changes evenly: on the
    chord a vehicle would slow down. In the plane, what turns by no more than an angle follows it as
    well as it can, from where it is. None where the shift does not fit: at rotation order 2 the
    first rotation is given.

    Args:
        problem: what is to be solved now.
        state: from where.
        plan: the previous one.
        knots: the ends of the steps of now in steps of the previous plan, shape (N,); by default
            that is one step old.
    """
    if problem.rotation_order == 2:
        return None
    x = coordinates(plan.rotations)
    at = 1.0 + np.arange(1, problem.horizon + 1) if knots is None else knots
    moved = _as_long(problem, x, later(x, at), at)
    if problem.dimension == 2 and problem.turns_are_angles:
        moved = _followed(problem, state, moved)
    return moved


def _as_long(problem: Problem, x: Array, moved: Array, at: Array) -> Array:
    """Return rotations on chords, shape (K, d), with |R e1| as long as in between the ends.

    In space the orbitope leaves no room for that at full speed: there it is kept up to the floor.
    """
    n = problem.dimension
    sizes = later(np.linalg.norm(x[:, :n], axis=1, keepdims=True), at)
    found = np.linalg.norm(moved[:, :n], axis=1, keepdims=True)
    if n == 3:
        sizes = np.maximum(found, np.minimum(sizes, problem.floor.radius))
    return np.asarray(moved * np.where(found > 0.0, sizes / np.maximum(found, TINY), 1.0))


def _followed(problem: Problem, state: State, x: Array) -> Array:
    """Return headings, shape (K, 2), turned no farther than the vehicle turns, and as long."""
    widest, followed = WITHIN * problem.widest_turn, np.zeros_like(x)
    angle = math.atan2(state.attitude[1, 0], state.attitude[0, 0])
    for k, (along, aside) in enumerate(x.tolist()):
        wanted = math.remainder(math.atan2(aside, along) - angle, 2.0 * math.pi)
        angle += min(max(wanted, -widest), widest)
        followed[k] = math.cos(angle), math.sin(angle)
    return followed * np.linalg.norm(x, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Command(ByContent):
    """What the vehicle does next: turn at a rate during the step, take over a speed at its end.

    Attributes:
        speed_fraction: share of full speed (translation order 1) or thrust (order 2), in [0, 1].
        body_rate: angular velocity in the body frame, shape (1,) or (3,) [rad/s].
        rotation: attitude commanded for the end of the step, shape (n, n).
    """

    speed_fraction: float
    body_rate: Array
    rotation: Array

    def __post_init__(self) -> None:
        self.body_rate.setflags(write=False)
        self.rotation.setflags(write=False)


def stop(rotation: Array) -> Command:
    """Return the safe command: no speed, no turning, the present attitude, shape (n, n)."""
    return Command(0.0, np.zeros(1 if len(rotation) == 2 else 3), np.array(rotation))


def command_of(problem: Problem, state: State, plan: Plan, step: int = 0) -> Command:
    """Return the command for a step of ``plan``, the first by default.

    Rotation order 1: body rate log(Q_k^T Q_{k+1})/h. Order 2: the present body rate already carries
    Q_k to Q_{k+1} in this step, so the rate taken over at its end is log(Q_{k+1}^T Q_{k+2})/h. The
    rate never exceeds ``max_rate``. In the plane a floor makes sure that plans do not either; where
    they do (without a floor by a wide angle of a short chord, in space by a roll) the rate is cut,
    and the commanded rotation is the one then reached. Without a floor the vehicle then gets as
    much of the planned speed or thrust as is along the axis reached: at full speed it would miss
    the turn, and could circle its goal for ever. It is not slowed faster than it may be, though.

    Args:
        problem: gives step and limits.
        state: the state that the plan starts from.
        plan: a checked plan.
        step: k, in 0..N-1.
    """
    floor = problem.least_speed
    # What rounding leaves a plan short of its floor, no vehicle is told.
    fraction = min(1.0, max(floor, float(plan.speed_fraction[step + 1])))
    first = step + problem.rotation_order - 1
    start, end = plan.projected[first], plan.projected[min(first + 1, plan.horizon)]
    rate = log(start.T @ end) / problem.step
    size = math.sqrt(rate @ rate)
    if problem.max_rate > 0.0 and size > problem.max_rate:
        rate = rate * (problem.max_rate / size)
        planned, end = end, start @ exp(rate * problem.step)
        if problem.rotation_order == 1 and not problem.floor.exists:
            along = fraction * min(1.0, max(0.0, float(planned[:, 0] @ end[:, 0])))
            before = entry_speed(problem, state) if step == 0 else float(plan.speed_fraction[step])
            fraction = max(along, min(fraction, before - problem.speed_change))
    return Command(fraction, rate, np.array(end))
