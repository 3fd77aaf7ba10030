# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Active constraints of a plan and their shadow prices.

At an optimum the gradient of the cost is a combination of the gradients of active slacks (Karush,
Kuhn, Tucker),

.. math::  \nabla f = \sum_i \lambda_i \nabla c_i, \qquad \lambda_i \ge 0 \text{ where } c_i \ge 0,

as functions of the rotations R_1..R_N, with all else eliminated by the dynamics. A multiplier is a
price: relaxing its constraint by a small eps reduces the optimal cost by price * eps.

A slack is a function c >= 0 that is zero where its constraint is active. Gradients are over the
coordinates of R_1..R_N.

Mathematics: docs/mathematics.md, 6.3.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import approach_margin, cone_margins, speed_margin, turn_margin
from orbimpc_ros.mpc.geometry.rotations import coordinates, lmi, lmi_parts
from orbimpc_ros.mpc.model.dynamics import KINK, length_weights, on_axes
from orbimpc_ros.mpc.model.dynamics import gradients as gradients_of_cost
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.solve.regions import Regions
from orbimpc_ros.mpc.solve.request import Request

ROUNDING = 1e-6  # share of the cost's gradient that is negligible
TINY = 1e-12
ACTIVE = 1e-5  # constraints with less slack count as active: solvers leave less
AXES = 'xyz'
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Slack:
    """The slack of an active constraint.

    Attributes:
        name: of its constraint.
        step: k in 1..N.
        gradient: over the coordinates of R_1..R_N, shape (N, d).
        unit: change of the slack per unit of relaxation, which turns the multiplier into a price.
        signed: whether the multiplier may be negative, as that of an equality.
    """

    name: str
    step: int
    gradient: Array
    unit: float = 1.0
    signed: bool = False


def slacks_of(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[Slack]:
    """Yield the slacks of all active constraints of a plan.

    Args:
        problem: that was solved.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        plan: a plan that meets all constraints.
    """
    yield from _hull(plan)
    yield from _rates(problem, state, plan)
    if problem.max_acceleration:
        yield from _changes(problem, state, plan)
    yield from _slow(problem, plan)
    if problem.obstacles or state.hazards:
        yield from _beside(problem, state, goals, plan)
    if problem.has_cones:
        yield from _cones(problem, state, goals, plan)
    if problem.approach.exists:
        yield from _approach(problem, state, plan)
    yield from _arrival(problem, plan)
    if problem.rotation_order == 2 and state.coasted is not None:
        yield from _thrust(state.coasted, plan)


def _hull(plan: Plan) -> Iterator[Slack]:
    """Yield 1 - |x_k| for n = 2, and for n = 3 the eigenvalues of the LMI that are zero."""
    for k, x in enumerate(coordinates(plan.rotations[1:]), start=1):
        if len(x) == 2:
            size = math.sqrt(x @ x)
            if size > 1.0 - ACTIVE:
                yield Slack('hull', k, _at(plan, k, -x / size))
            continue
        values, vectors = np.linalg.eigh(lmi(x))
        yield from _face(plan, k, vectors[:, values < ACTIVE])


def _face(plan: Plan, k: int, kernel: Array) -> Iterator[Slack]:
    """Yield gradients of <Y, LMI> for a basis of symmetric Y on the LMI's kernel, shape (4, r).

    The multiplier is a positive semidefinite Y; its trace is the price of scaling the hull. This is
    not enforced for r > 1: unique multipliers satisfy it.
    """
    _, linear = lmi_parts()
    count = kernel.shape[1]
    for i in range(count):
        for j in range(i, count):
            both = np.outer(kernel[:, i], kernel[:, j])
            gradient = linear.T @ (0.5 * (both + both.T)).ravel()
            yield Slack('hull', k, _at(plan, k, gradient), float(i == j), signed=count > 1)


def _rates(problem: Problem, state: State, plan: Plan) -> Iterator[Slack]:
    """Yield slacks of ``max_rate``: of chords |(R_k - R_{k-1}) e1|, or with a floor of angles.

    The gradient of an angle is orthogonal to each heading, of the size of its inverse length, and
    directed against the turn at its beginning, along it at its end.
    """
    headings = plan.rotations[:, :, 0].copy()
    wider = problem.step * math.cos(0.5 * problem.step * problem.max_rate)
    if problem.turns_are_angles:
        headings[0], wider = state.attitude[:, 0], problem.step
    for k in 1 + np.flatnonzero(turn_margin(problem, state, plan.rotations) < ACTIVE):
        gradient = np.zeros((plan.horizon + 1, headings.shape[1]))
        before, after = headings[k - 1], headings[k]
        if problem.turns_are_angles:
            gradient[k] = -_across(after, before)
            gradient[k - 1] = -_across(before, after)
        else:
            gradient[k] = -(after - before) / np.linalg.norm(after - before)
            gradient[k - 1] = -gradient[k]
        yield Slack('max_rate', int(k), on_axes(gradient[1:]), wider)


def _changes(problem: Problem, state: State, plan: Plan) -> Iterator[Slack]:
    """Yield slacks h a / z - ||R_k e1| - |R_{k-1} e1||, priced per unit of the acceleration a."""
    headings, unit = plan.rotations[:, :, 0], problem.step / problem.forward
    speeds = plan.speed_fraction
    for k in 1 + np.flatnonzero(speed_margin(problem, state, plan.rotations) < ACTIVE):
        before = entry_speed(problem, state) if k == 1 else speeds[k - 1]
        sign = 1.0 if speeds[k] > before else -1.0
        gradient = np.zeros((plan.horizon + 1, headings.shape[1]))
        gradient[k] = -sign * headings[k] / max(speeds[k], ACTIVE)
        gradient[k - 1] = sign * headings[k - 1] / max(speeds[k - 1], ACTIVE)
        yield Slack('max_acceleration', int(k), on_axes(gradient[1:]), unit)


def _across(heading: Array, other: Array) -> Array:
    """Return the gradient in a heading of its angle to another one, shape (n,)."""
    unit = heading / np.linalg.norm(heading)
    across = (other @ unit) * unit - other
    return across / (np.linalg.norm(across) * np.linalg.norm(heading))


def _slow(problem: Problem, plan: Plan) -> Iterator[Slack]:
    """Yield the floor's half-space in which each heading on the floor has the largest margin."""
    floor, headings = problem.floor, plan.rotations[1:, :, 0]
    for k in np.flatnonzero(floor.margin(headings) < ACTIVE).tolist():
        yield Slack('floor', k + 1, _at(plan, k + 1, floor.tangent(headings[k])))


def _beside(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[Slack]:
    """Yield the planes between vehicle and bodies, at the control points that touch them."""
    traffic, nothing = traffic_of(problem, state), ACTIVE * problem.length_unit
    names = [f'obstacle {i}' for i in range(len(problem.boxes))]
    names += [name for name in (traffic.names if traffic else ()) for _ in range(2)]
    headings, stiff = plan.rotations[1:, :, 0], np.full((problem.horizon, problem.horizon), np.inf)
    regions = Regions(problem, stiff)
    regions.bind(Request(state, goals))
    near = regions.beside(headings, nothing)
    controls, count = problem.translation.degree + 1, problem.horizon
    for choice, held in regions.tangents(headings, near, {}).items():
        body, step = divmod(choice, count)
        still = body - 2 < len(problem.boxes)
        if still and problem.no_corner_cutting and step == 0 < count - 1:
            continue  # its end is the beginning of the next step
        for row in held:
            if row.normal @ (row.shares @ headings) - row.offset < nothing:
                gradient = on_axes(np.outer(row.shares, row.normal))
                begins = still and (row.place - count) % controls == 0
                yield Slack(names[body - 2], step + (not begins), gradient)


def _cones(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[Slack]:
    """Yield slacks of the tilt limit and the glide slope, priced per unit of their angles."""
    tilt, slope = cone_margins(problem, state, goals, plan)
    if problem.tilt:
        for k in 1 + np.flatnonzero(tilt < ACTIVE):
            yield _in_cone('tilt', plan, int(k), problem.tilt, UP, ACTIVE)
    if problem.glide_slope:
        for k in 1 + np.flatnonzero(slope < ACTIVE * problem.length_unit):
            yield _gliding(problem, plan.positions[k] - goals[k - 1], int(k))


def _approach(problem: Problem, state: State, plan: Plan) -> Iterator[Slack]:
    approach = problem.approach
    if approach_margin(problem, state, plan.rotations[-1, :, 0]) < ACTIVE:
        cone = approach.cone, approach.axis(state), problem.least_heading
        yield _in_cone('approach', plan, plan.horizon, *cone)


def _in_cone(name: str, plan: Plan, k: int, angle: float, axis: Array, least: float) -> Slack:
    """Return the slack z_k . axis - cos(angle) max(|z_k|, least), priced per unit of the angle."""
    heading = plan.rotations[k, :, 0]
    size = float(np.linalg.norm(heading))
    gradient = axis - (math.cos(angle) * heading / size if size > least else 0.0)
    return Slack(name, k, _at(plan, k, gradient), math.sin(angle) * max(size, least))


def _gliding(problem: Problem, away: Array, k: int) -> Slack:
    """Return the slack of the glide slope; its gradient at the tip, a kink, is taken as upwards."""
    sine, cosine = math.sin(problem.glide_slope), math.cos(problem.glide_slope)
    aside = float(np.hypot(away[0], away[1]))
    outward = away[:2] / max(aside, ACTIVE * problem.length_unit)
    gradient = np.outer(problem.maps.reach[k - 1, 1:], np.array([*(-sine * outward), cosine]))
    return Slack('glide_slope', k, on_axes(gradient), cosine * aside + sine * float(away[2]))


def _arrival(problem: Problem, plan: Plan) -> Iterator[Slack]:
    """Yield s_N - g_N and p_N, axis by axis."""
    if problem.terminal != 'constraint':
        return
    flown = problem.maps
    maps = {'terminal': flown.reach[-1, 1:]}
    if problem.inertial:
        maps['terminal velocity'] = flown.pushed[-1, 1:]
    for name, moved in maps.items():
        for axis, unit in zip(AXES, np.eye(problem.dimension), strict=False):
            gradient = on_axes(np.outer(moved, unit))
            yield Slack(f'{name} {axis}', plan.horizon, gradient, signed=True)


def _thrust(coasted: Array, plan: Plan) -> Iterator[Slack]:
    """Yield the fraction rho >= 0 in R_1 = rho * (the rotation that the body rate leads to)."""
    if plan.speed_fraction[1] < ACTIVE:
        way = coordinates(coasted)
        yield Slack('thrust', 1, _at(plan, 1, way / (way @ way)))


def _at(plan: Plan, k: int, gradient: Array) -> Array:
    """Return a gradient in R_k, given its first entries, as one in R_1..R_N."""
    full = np.zeros_like(coordinates(plan.rotations[1:]))
    full[k - 1, : len(gradient)] = gradient
    return full


@dataclass(frozen=True)
class Binding:
    """An active constraint whose relaxation would reduce the cost.

    Attributes:
        name: ``hull``, ``floor``, ``max_rate``, ``max_acceleration``, ``tilt``, ``glide_slope``,
            ``approach``, ``obstacle 0`` (its index), ``hazard 0``, ``thrust`` (that of a coasting
            body is >= 0), ``terminal x`` or ``terminal velocity x`` (or y, z).
        step: k in 1..N, for R_k, s_k, or the change from R_{k-1} to R_k.
        price: decrease of the cost per unit of relaxation: of speed fraction for ``hull``,
            ``floor`` and ``thrust``, of rad/s for ``max_rate``, of m/s^2 for ``max_acceleration``,
            of rad for ``tilt``, ``glide_slope`` and ``approach``, of m or m/s for the others.
    """

    name: str
    step: int
    price: float

    def __str__(self) -> str:
        return f'{self.name}@{self.step}'


@dataclass(frozen=True)
class Explanation:
    """The active constraints of a plan with their prices.

    Attributes:
        binding: the constraints with a positive price, in decreasing order.
        unexplained: share of the cost's gradient that they do not account for. It is near zero at
            an optimum; otherwise the plan could be improved, and the prices mean little.
    """

    binding: tuple[Binding, ...]
    unexplained: float


def explained(problem: Problem, state: State, goals: Array, plan: Plan) -> Explanation:
    """Return the binding constraints of an optimal plan with their prices.

    Args:
        problem: that was solved.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        plan: the optimum.
    """
    slacks = list(slacks_of(problem, state, goals, plan))
    terms = gradients_of_cost(problem, state, goals, coordinates(plan.rotations[1:]))
    nothing = ROUNDING * max(plan.objective, Units.of(problem).cost)  # at the goal gradients vanish
    scale = max(sum(map(np.linalg.norm, terms)), nothing, TINY)
    gradients = np.array([sum(terms), *(slack.gradient for slack in slacks)])
    gradients = _movable(problem, state, plan, gradients).reshape(len(gradients), -1)
    pull, columns = gradients[0], gradients[1:].T
    multipliers = _multipliers(columns, pull, [slack.signed for slack in slacks], ROUNDING * scale)
    left = float(np.linalg.norm(columns @ multipliers - pull))
    return Explanation(_charged(slacks, multipliers, ROUNDING * scale), left / scale)


def _charged(slacks: Sequence[Slack], multipliers: Array, nothing: float) -> tuple[Binding, ...]:
    bills: defaultdict[tuple[str, int], float] = defaultdict(float)
    for slack, multiplier in zip(slacks, multipliers, strict=True):
        bills[slack.name, slack.step] += slack.unit * float(multiplier)
    found = [Binding(name, step, abs(price)) for (name, step), price in bills.items()]
    return tuple(sorted((b for b in found if b.price > nothing), key=lambda b: -b.price))


def _multipliers(columns: Array, pull: Array, signed: Sequence[bool], nothing: float) -> Array:
    """Return the least-squares multipliers for ``pull``, non-negative unless signed.

    Constraints with negative multipliers are dropped, the most negative one first, since they do
    not hold the plan back. That is exact unless constraints are interchangeable.
    """
    kept = np.ones(len(signed), dtype=bool)
    while kept.any():
        found = np.zeros(len(signed))
        found[kept] = np.linalg.lstsq(columns[:, kept], pull, rcond=None)[0]
        worst = int(np.argmin(np.where(signed, np.inf, found)))
        if signed[worst] or found[worst] >= -nothing:
            return found
        kept[worst] = False
    return np.zeros(len(signed))


def _movable(problem: Problem, state: State, plan: Plan, gradients: Array) -> Array:
    """Project gradients, shape (..., N, d), onto the directions in which the plan can change.

    The kink of the length term at R_k e1 = 0 holds R_k e1 in place. At rotation order 2 the state
    decides R_1, except for the thrust along a coasting body.
    """
    moved, kinks = gradients.copy(), _kinks(problem, plan)
    moved[..., kinks, : problem.dimension] = 0.0
    if problem.rotation_order == 2:
        moved[..., 0, :] = 0.0
        if state.coasted is not None and not kinks[0]:
            way = coordinates(state.coasted)
            along = gradients[..., 0, :] @ way / (way @ way)
            moved[..., 0, :] = along[..., None] * way
    return moved


def _kinks(problem: Problem, plan: Plan) -> np.ndarray:
    """Return True for those of R_1..R_N at which the length term has no gradient, shape (N,)."""
    return (plan.speed_fraction[1:] < KINK) & (length_weights(problem)[1:] > 0.0)
