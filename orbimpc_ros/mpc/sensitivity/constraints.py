# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Active constraints of a plan and their shadow prices: the reasons why it is not better.

At an optimum the gradient of the cost is a combination of the gradients of the slacks that have
run out (Karush, Kuhn, Tucker),

.. math::  \nabla f = \sum_i \lambda_i \nabla c_i, \qquad \lambda_i \ge 0 \text{ where } c_i \ge 0,

as functions of the rotations R_1..R_N, all else eliminated by the dynamics. The multiplier is a
price: relaxing the constraint by a small eps makes the optimum cheaper by price * eps.

Mathematics: docs/mathematics.md, 6.3.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.model.dynamics import KINK, length_weights
from orbimpc_ros.mpc.model.dynamics import gradients as gradients_of_cost
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.sensitivity.slacks import Slack, slacks_of

ROUNDING = 1e-6  # share of the cost's gradient that counts as nothing
TINY = 1e-12


@dataclass(frozen=True)
class Binding:
    """A constraint without slack whose relaxation would pay.

    Attributes:
        name: ``hull``, ``floor``, ``max_rate``, ``max_acceleration``, ``tilt``, ``glide_slope``,
            ``approach``, ``obstacle 0`` (its number), ``hazard 0``, ``thrust`` (a coasting body's
            cannot be negative), ``terminal x`` or ``terminal velocity x`` (or y, z).
        step: k in 1..N: of R_k, of s_k, or of the change from R_{k-1} to R_k.
        price: what the cost falls by per unit of relaxation: of speed fraction for ``hull``,
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
    """Why a plan is not better.

    Attributes:
        binding: the constraints that cost something, dearest first.
        unexplained: share of the cost's gradient that they do not account for. Near zero at an
            optimum; otherwise the plan could be improved, and the prices say little.
    """

    binding: tuple[Binding, ...]
    unexplained: float


def explained(problem: Problem, state: State, goals: Array, plan: Plan) -> Explanation:
    """Return the constraints that bind at an optimal plan, with their prices.

    Args:
        problem: what was solved.
        state: from where.
        goals: g_1..g_N, shape (N, n) [m].
        plan: the optimum.
    """
    slacks = list(slacks_of(problem, state, goals, plan))
    terms = gradients_of_cost(problem, state, goals, plan)
    nothing = ROUNDING * max(plan.objective, Units.of(problem).cost)  # at the goal all vanish
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
    """Return the multipliers that come nearest to ``pull``, non-negative unless signed.

    Whose multiplier comes out negative does not hold the plan back: it is left out, the worst
    first. That is exact wherever constraints do not stand in for each other.
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
    """Return gradients, shape (..., N, d), without the directions in which no step can be made.

    Where R_k e1 = 0 the length term has a kink, which holds R_k e1 in its place. At rotation order
    2 the state decides R_1, but for the thrust along a coasting body.
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
    """Return for which of R_1..R_N the length term has no gradient, shape (N,)."""
    return (plan.speed_fraction[1:] < KINK) & (length_weights(problem)[1:] > 0.0)
