# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Active constraints of a plan and their shadow prices.

At an optimum the gradient of the cost is a combination of the gradients of active slacks (Karush,
Kuhn, Tucker),

.. math::  \nabla f = \sum_i \lambda_i \nabla c_i, \qquad \lambda_i \ge 0 \text{ where } c_i \ge 0,

as functions of the rotations R_1..R_N, with all else eliminated by the dynamics. A multiplier is a
price: relaxing its constraint by a small eps reduces the optimal cost by price * eps.

A slack is a function c >= 0 that is zero where its constraint is active.

Mathematics: docs/mathematics.md, 6.3.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import step_margins
from orbimpc_ros.mpc.geometry.rotations import coordinates, lmi, lmi_parts
from orbimpc_ros.mpc.model.dynamics import KINK, length_weights, on_axes
from orbimpc_ros.mpc.model.dynamics import gradients as gradients_of_cost
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Box, Problem, State
from orbimpc_ros.mpc.problem.problem import SLOWEST
from orbimpc_ros.mpc.problem.reach import decided
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.solve.regions import Regions
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Units

ROUNDING = 1e-6  # share of the cost's gradient that is negligible
TINY = 1e-12
ACTIVE = 1e-5  # constraints with less slack count as active: solvers leave less
AXES = 'xyz'
NUDGE = 1e-6  # difference of headings, and relative one of limits, for gradients and units


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


def _limits(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[Slack]:
    """Yield the slacks of limits on single steps; gradients and units are central differences.

    A floor of several faces has the slope of the face whose margin is largest; where a cone has its
    tip, or a speed is zero, the differences are those of a smooth function.
    """
    headings, steps, n = plan.rotations[:, :, 0], plan.horizon, problem.dimension
    nudges = np.zeros((steps * n, steps + 1, n))
    nudges[:, 1:] = NUDGE * np.eye(steps * n).reshape(-1, steps, n)
    slacks = _slacks(problem, state, goals, headings)
    more, less = (_slacks(problem, state, goals, headings + sign * nudges) for sign in (1.0, -1.0))
    for name, each in slacks.items():
        slopes = (more[name] - less[name]) / (2.0 * NUDGE)
        nothing = ACTIVE * (problem.maps.unit if name == 'glide_slope' else 1.0)
        active = np.flatnonzero(each < nothing)
        if not len(active):
            continue
        units = np.ones(len(each))
        if name not in ('hull', 'floor'):
            tight, by = _tightened(problem, name)
            units = np.abs(each - _slacks(tight, state, goals, headings)[name]) / by
        for k in active.tolist():
            gradient = on_axes(slopes[:, k].reshape(steps, n))
            step = steps if name == 'approach' else k + 1
            yield Slack(name, step, gradient, float(units[k]))


def _slacks(problem: Problem, state: State, goals: Array, headings: Array) -> dict[str, Array]:
    """Return the margins of :func:`step_margins` for headings, shape (..., N + 1, n)."""
    moved = problem.maps.reach[:, 1:] @ headings[..., 1:, :]
    places = decided(problem, state)[0][1:] + moved
    margins = step_margins(problem, state, goals, headings, places)
    if problem.approach.exists and problem.least_speed >= SLOWEST:  # implies the flat end
        margins['approach'] = margins['approach'][..., :1]
    if problem.dimension == 2:
        margins['hull'] = 1.0 - np.linalg.norm(headings[..., 1:, :], axis=-1)
    return margins


def _tightened(problem: Problem, name: str) -> tuple[Problem, float]:
    """Return a problem with a slightly smaller limit, and by how much it is smaller."""
    if name == 'approach':
        cone = problem.approach.cone
        approach = replace(problem.approach, cone=(1.0 - NUDGE) * cone)
        return replace(problem, approach=approach), NUDGE * cone
    limit = getattr(problem, name)
    return replace(problem, **{name: (1.0 - NUDGE) * limit}), NUDGE * limit


def _hull(plan: Plan) -> Iterator[Slack]:
    """Yield <Y, LMI> for a basis of symmetric Y on the kernel of the LMI of conv SO(3).

    The multiplier is a positive semidefinite Y; its trace is the price of scaling the hull. This is
    not enforced for a kernel of more than one dimension: unique multipliers satisfy it.
    """
    _, linear = lmi_parts()
    for k, x in enumerate(plan.x[1:]):
        values, vectors = np.linalg.eigh(lmi(x))
        kernel = vectors.T[values < ACTIVE]
        for i, j in combinations_with_replacement(range(len(kernel)), 2):
            both = np.outer(kernel[i], kernel[j])
            gradient = linear.T @ (0.5 * (both + both.T)).ravel()
            alone = np.outer(np.eye(plan.horizon)[k], gradient)
            yield Slack('hull', k + 1, alone, float(i == j), signed=len(kernel) > 1)


def _beside(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[Slack]:
    """Yield the planes between vehicle and bodies, at the control points that touch them."""
    traffic, nothing = traffic_of(problem, state), ACTIVE * problem.maps.unit
    names = [f'obstacle {i}' for i, b in enumerate(problem.obstacles) if isinstance(b, Box)]
    names += [name for name in (traffic.names if traffic else ()) for _ in range(2)]
    headings, regions = plan.rotations[:, :, 0], Regions(problem)
    regions.bind(Request(state, goals))
    near = regions.beside(headings, nothing)
    controls, count = problem.translation.degree + 1, problem.horizon
    for choice, held in regions.tangents(headings, near, {}).items():
        body, step = divmod(choice, count)
        still = body - 2 < len(problem.boxes)
        if still and problem.no_corner_cutting and step == 0 < count - 1:
            continue  # its end is the beginning of the next step
        for row in held:
            if row.normal @ (row.shares @ headings[1:]) - row.offset < nothing:
                gradient = on_axes(np.outer(row.shares, row.normal))
                begins = still and (row.place - count) % controls == 0
                yield Slack(names[body - 2], step + (not begins), gradient)


def _arrival(problem: Problem, plan: Plan) -> Iterator[Slack]:
    """Yield s_N - g_N and p_N, axis by axis."""
    if problem.terminal != 'constraint':
        return
    named = zip(('terminal', 'terminal velocity'), problem.maps.arrival[:, 1:], strict=False)
    for name, moved in named:
        for axis, unit in zip(AXES, np.eye(problem.dimension), strict=False):
            gradient = on_axes(np.outer(moved, unit))
            yield Slack(f'{name} {axis}', plan.horizon, gradient, signed=True)


def _thrust(coasted: Array, plan: Plan) -> Iterator[Slack]:
    """Yield the fraction rho >= 0 in R_1 = rho * (the rotation that the body rate leads to)."""
    if plan.speed_fraction[1] < ACTIVE:
        way = coordinates(coasted)
        yield Slack('thrust', 1, np.outer(np.eye(plan.horizon)[0], way / (way @ way)))


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
    """Return the binding constraints of an optimal plan, for g_1..g_N, shape (N, n) [m]."""
    slacks = list(_limits(problem, state, goals, plan))
    if problem.dimension == 3:
        slacks += _hull(plan)
    if problem.obstacles or state.hazards:
        slacks += _beside(problem, state, goals, plan)
    slacks += _arrival(problem, plan)
    if problem.rotation_order == 2 and state.coasted is not None:
        slacks += _thrust(state.coasted, plan)
    terms = gradients_of_cost(problem, state, goals, plan.x[1:])
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
    bindings = [Binding(name, step, abs(price)) for (name, step), price in bills.items()]
    return tuple(sorted((b for b in bindings if b.price > nothing), key=lambda b: -b.price))


def _multipliers(columns: Array, pull: Array, signed: Sequence[bool], nothing: float) -> Array:
    """Return the least-squares multipliers for ``pull``, non-negative unless signed.

    Constraints with negative multipliers are dropped, the most negative one first, since they do
    not hold the plan back. That is exact unless constraints are interchangeable.
    """
    kept = np.ones(len(signed), dtype=bool)
    while kept.any():
        multipliers = np.zeros(len(signed))
        multipliers[kept] = np.linalg.lstsq(columns[:, kept], pull, rcond=None)[0]
        worst = int(np.argmin(np.where(signed, np.inf, multipliers)))
        if signed[worst] or multipliers[worst] >= -nothing:
            return multipliers
        kept[worst] = False
    return np.zeros(len(signed))


def _movable(problem: Problem, state: State, plan: Plan, gradients: Array) -> Array:
    """Project gradients, shape (..., N, d), onto the directions in which the plan can change.

    The kink of the length term at R_k e1 = 0 holds R_k e1 in place. At rotation order 2 the state
    decides R_1, except for the thrust along a coasting body.
    """
    moved = gradients.copy()
    kinks = (plan.speed_fraction[1:] < KINK) & (length_weights(problem)[1:] > 0.0)
    moved[..., kinks, : problem.dimension] = 0.0
    if problem.rotation_order == 2:
        moved[..., 0, :] = 0.0
        if state.coasted is not None and not kinks[0]:
            way = coordinates(state.coasted)
            along = gradients[..., 0, :] @ way / (way @ way)
            moved[..., 0, :] = along[..., None] * way
    return moved
