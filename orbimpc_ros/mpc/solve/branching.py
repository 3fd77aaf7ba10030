# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Which choice a node is branched on, and by how much its children's bounds are raised at least.

With the parent's multipliers held, the dual function along the multiplier t >= 0 of a new row
a.x >= beta is

    D(t) = D(0) + t (beta - a.x) - t^2/2 a.H^-1 a,

a parabola in the parent's solution x and the condensed Hessian H of the rotations, so the child
costs at least D(0) + max(0, beta - a.x)^2 / (2 a.H^-1 a). That prunes most children unsolved.

Mathematics: docs/mathematics.md, 4.9 and 5.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import Cell
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.disjunction import Disjunction
from orbimpc_ros.mpc.solve.posed import Choice, Missed, Posed

WORST_CONDITION = 1e12
Gains = tuple[Array, np.ndarray, Array]


class Branch(NamedTuple):
    """A node's parts.

    Attributes:
        split: the choice that they differ in.
        cells: what each of them chooses.
        bounds: no trajectory of each costs less, shape (cells,).
        rows: which row of each of them raises its bound, shape (cells,).
        steps: by what multiplier of it, shape (cells,).
    """

    split: int
    cells: Sequence[Cell]
    bounds: Array
    rows: np.ndarray
    steps: Array


class Branching:
    """How the nodes of one request are branched on.

    Args:
        posed: what is searched.
        curvature: a.H^-1 a of each alternative's rows, shapes (rows,).
        exchangeable: whether steps can be put in order of their faces.
    """

    def __init__(self, posed: Posed, curvature: Sequence[Array], exchangeable: bool) -> None:
        self._posed, self._curvature, self._exchangeable = posed, curvature, exchangeable

    def children(
        self, choice: Choice, missed: Missed, bound: float, dual_value: float
    ) -> Branch | None:
        """Return a part per cell of the choice that raises the bound the most; None if none can.

        Args:
            choice: of the node.
            missed: what its solution misses.
            bound: of the node.
            dual_value: that belongs to the solution: the parabola of a child's bound begins there.
        """
        if self._exchangeable:
            return self._in_order(choice, bound)
        options: dict[int, Sequence[Cell]] = {}
        for j in missed:
            cell = choice[j]
            if cell is not None and not cell.parts():
                continue
            options[j] = self._posed.cells(j, cell)
            if not options[j]:  # none of them can be reached
                return unraised(j, (), bound)
        if not options:  # a chosen face is missed: the solve was not accurate enough
            return None
        gains = {j: self._gains(j, cells, missed[j][1]) for j, cells in options.items()}
        promises = {j: (self._promise(j, gains[j], missed[j][0]), missed[j][0]) for j in options}
        chosen = max(options, key=promises.__getitem__)
        gained, rows, steps = gains[chosen]
        bounds = np.maximum(bound, dual_value + gained)
        return Branch(chosen, options[chosen], bounds, rows, steps)

    def _in_order(self, choice: Choice, bound: float) -> Branch | None:
        """Branch on the first open step, on faces not before that of the step before it.

        Where steps are exchangeable, every trajectory has the cost of one whose faces are sorted;
        of the last step, which the cost does not see at all, one face stands for the others.
        """
        if None not in choice:
            return None
        j = choice.index(None)
        cells = self._posed.disjunctions[j].cells
        before = choice[j - 1] if j else None
        least = 0 if before is None else cells.index(before)
        last = j == len(choice) - 1
        return unraised(j, cells[:1] if last else cells[least:], bound)

    def _promise(self, j: int, gains: Gains, by: float) -> float:
        """Return by how much the children of a choice missed by ``by`` may raise the bound.

        Of the parts of a round floor's patch the nearer one often holds already, and tells
        nothing: what is missed of the floor is what finer patches will ask for. What the state
        alone decides comes first: no other choice mends it.
        """
        if np.isinf(self._curvature[j]).all():
            return np.inf
        if self._posed.alternatives[j].radius:
            return float(by * by / (2.0 * self._curvature[j].min()))
        return float(gains[0].min())

    def _gains(self, j: int, cells: Sequence[Cell], values: Array) -> Gains:
        """Return by how much each cell raises the bound at least, by which row, how far along."""
        short = np.maximum(self._posed.alternatives[j].shortfall(cells, values), 0.0)
        steps = short / self._curvature[j]
        gains = 0.5 * short * steps
        rows = gains.argmax(axis=1)
        each = np.arange(len(rows)), rows
        return gains[each], rows, steps[each]


def unraised(j: int, cells: Sequence[Cell], bound: float) -> Branch:
    """Return parts that are known no better than what they are parts of."""
    count = len(cells)
    return Branch(j, cells, np.full(count, bound), np.zeros(count, int), np.zeros(count))


def steps_are_exchangeable(problem: Problem) -> bool:
    """Return whether cost and constraints see nothing of z_1..z_{N-1} but their sum and lengths."""
    return (
        problem.floor.shape == 'polygon'
        and (problem.rotation_order, problem.translation_order) == (1, 1)
        and problem.discretisation == 'euler'  # whose last step pushes nothing
        and problem.weights.input == problem.weights.position == problem.max_rate == 0.0
        and problem.weights.attitude == 0.0
        and not problem.approach.exists
        and not problem.obstacles
    )


def inverse_hessian(hessian: Array) -> Array:
    """Return H^-1, shape (N, N); infinite where H is singular."""
    if not np.linalg.cond(hessian) <= WORST_CONDITION:  # of no curvature it is not a number
        return np.full(hessian.shape, np.inf)
    return np.asarray(np.linalg.inv(hessian))


def inverse_curvatures(
    problem: Problem, disjunctions: Sequence[Disjunction], inverse: Array
) -> list[Array]:
    """Return a.H^-1 a of each disjunction's rows, one per step, shapes (len(steps),).

    Normals have length one. Infinite (no gain) where H is singular.
    """
    if not np.isfinite(inverse).all():
        return [np.full(len(d.steps), np.inf) for d in disjunctions]
    rows = problem.maps.reach[:, 1:]
    along = np.einsum('ki,ij,kj->k', rows, inverse, rows)
    every = {'heading': np.diag(inverse), 'position': np.where(along > 0.0, along, np.inf)}
    return [every[d.on][np.array(d.steps) - 1] for d in disjunctions]
