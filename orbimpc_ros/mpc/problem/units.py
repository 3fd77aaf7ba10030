# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Natural units, and scalings of the weights: the paper's sums, or integrals over time.

In natural units a problem's step, full speed and costs are all of the order of one.

The unit of length is the longest step from rest, that of time the step, that of cost the largest
curvature of the objective. Rotations are dimensionless, so a solution of the scaled problem solves
the original one; only costs and bounds differ in scale. Solvers with absolute tolerances then work
as well at 1000 m/s as at 1 m/s.

The paper's objective sums over steps, so the same weights give other plans at another step or
speed. With integrals over the horizon, in units of the distance flown in a unit of time,

.. math::
    q \int \|s - g\|^2 dt + r \int \|R^{(o)}\|_F^2 dt + \ell \int \|R e_1\| dt + m \|s_N - g_N\|^2
    + a \|R_N - R_g\|_F^2,

their meaning is independent of both: problems that differ only in step and full speed are the same
problem in natural units, and a finer step only resolves it better.

Mathematics: docs/mathematics.md, 1.4 and 1.6.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.proof.tree import ProofTree

SCALINGS = ('paper', 'time')
TIMES = 20  # units of time in a horizon: the default weights smooth headings over a fortieth of it


@dataclass(frozen=True)
class Units:
    """The units in which a problem is solved.

    Attributes:
        problem: the problem in these units.
        length: [m].
        time: [s].
        cost: in units of the objective.
    """

    problem: Problem
    length: float
    time: float
    cost: float

    @classmethod
    def of(cls, problem: Problem) -> Units:
        """Return the natural units of a problem."""
        scaled = _in_units(problem, problem.length_unit, problem.step)
        cost = _curvature(scaled)
        weights = Weights(*(each * (1.0 / cost) for each in astuple(scaled.weights)))
        scaled = replace(scaled, weights=weights, arrival_weight=scaled.arrival_weight / cost)
        return cls(scaled, problem.length_unit, problem.step, cost)

    def state(self, state: State) -> State:
        """Return a state in these units."""
        if self.length == self.time == 1.0:
            return state
        inverse = 1.0 / self.length, 1.0 / self.time
        pushing = self.time ** (2 if self.problem.inertial else 1) / self.length
        return replace(
            state,
            position=state.position * inverse[0],
            velocity=state.velocity * (self.time / self.length),
            rotation_rate=state.rotation_rate * self.time,
            disturbance=state.disturbance * pushing,
            hazards=tuple(each.scaled(*inverse) for each in state.hazards),
        )

    def lengths(self, values: Array) -> Array:
        """Return lengths [m] in these units."""
        return values if self.length == 1.0 else values / self.length

    def posed(self, tree: ProofTree) -> ProofTree:
        """Return a tree in these units converted to the units of the posed problem."""
        cost, force = self.cost, self.cost / self.length
        return tree._replace(
            shor=tree.shor * cost,
            press=tree.press * force,
            pull=tree.pull * (force * np.array([1.0, self.time])[: tree.pull.shape[1], None]),
            slide=tree.slide * force,
            tether=tree.tether * cost,
            share=tree.share * cost,
        )


def _in_units(problem: Problem, length: float, time: float) -> Problem:
    """Return a problem with lengths and times in other units, and with the same costs."""
    w, area = problem.weights, length * length
    weights = Weights(
        position=w.position * area,
        # The inputs are first or second derivatives of dimensionless numbers.
        input=w.input / time ** (2 * problem.rotation_order),
        length=w.length * problem.step * problem.forward,
        terminal=w.terminal * area,
        attitude=w.attitude,
    )
    return replace(
        problem,
        step=1.0,
        forward=1.0,
        weights=weights,
        arrival_weight=problem.arrival_weight * area,
        max_rate=min(math.pi, problem.max_rate * time),
        max_acceleration=problem.max_acceleration * time * time / length,
        obstacles=tuple(box.scaled(1.0 / length) for box in problem.obstacles),
    )


def _curvature(problem: Problem) -> float:
    """Return the scale of a problem's costs: its largest curvature or slope; 1 if it has none."""
    curved = float(np.abs(np.diag(Condensed(problem).hessian)).max())
    return max(curved, problem.weights.length) or 1.0


def weighed(problem: Problem, scaling: str) -> Problem:
    """Return a problem with its weights converted to those of the paper's sums.

    Args:
        problem: with the weights to convert.
        scaling: ``paper``, weights of sums already; ``time``, dimensionless ones on integrals over
            the horizon of squared distance, squared inputs and share of full speed or thrust, and
            on squared final distances. The unit of time is a twentieth of the horizon, that of
            length the distance flown in it from rest.

    Raises:
        BadInput: no such scaling.
    """
    if scaling not in SCALINGS:
        raise BadInput.choice('weights.scaling', scaling, SCALINGS)
    return problem if scaling == 'paper' else replace(problem, weights=_summed(problem))


def _summed(problem: Problem) -> Weights:
    given, time = problem.weights, problem.horizon * problem.step / TIMES
    speed = problem.forward * time if problem.inertial else problem.forward
    area, share = (speed * time) ** 2, problem.step / time
    return Weights(
        position=given.position * share / area,
        input=given.input * share * time ** (2 * problem.rotation_order),
        length=given.length / (problem.forward * time),  # the sum adds h z |R e1| per step
        terminal=given.terminal / area,
        attitude=given.attitude,
    )
