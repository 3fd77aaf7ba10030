# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Optima by another solver: convex programs formulated independently, step by step.

The programs share no code with the solver that they are an oracle for. Polyhedral floors and boxes
are disjunctions; a program fixes one branch of them: each in turn, or the one of a given plan.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np

from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State

LATE = {'euler': 0.0, 'exact': 0.5, 'held': 1.0}  # weight of the new heading in a step
Cell = tuple[np.ndarray, float]  # normal . value >= offset


class Choice(NamedTuple):
    """A disjunction: at its steps, one of several half-spaces holds, of headings or positions."""

    name: str
    on: str
    steps: tuple[int, ...]
    cells: list[Cell]

    def best(self, plan: Plan) -> Cell:
        """Return the half-space that a plan satisfies with the largest margin."""
        values = plan.rotations[:, :, 0] if self.on == 'heading' else plan.positions
        points = values[list(self.steps)]
        return max(self.cells, key=lambda cell: (points @ cell[0]).min() - cell[1])


def choices(problem: Problem) -> list[Choice]:
    n, found = problem.dimension, []
    if problem.floor.exists and problem.floor.shape != 'circle':
        faces = [(normal, problem.floor.fraction) for normal in problem.floor.normals(n)]
        steps = range(1, problem.horizon + 1)
        found += [Choice('floor', 'heading', (k,), faces) for k in steps]
    for i, box in enumerate(problem.boxes):
        sides = [(-axis, -low) for axis, low in zip(np.eye(n), box.minimum, strict=True)]
        sides += [(axis, high) for axis, high in zip(np.eye(n), box.maximum, strict=True)]
        shared = int(problem.no_corner_cutting and problem.horizon > 1)
        for k in range(1, problem.horizon + 1 - shared):
            found.append(
                Choice(f'obstacle {i}', 'position', tuple(range(k, k + 1 + shared)), sides)
            )
    return found


class Stated:
    """A problem as the paper writes it, in one branch of its choices, with a slack per constraint.

    State and goals are numbers, or parameters that have values when it is solved.
    """

    def __init__(self, problem: Problem, start: State, goals: np.ndarray) -> None:
        self.problem, self.choices = problem, choices(problem)
        self.ease: dict[tuple[str, int], cp.Parameter] = {}
        self._rows: list[Any] = []
        self._chords = cp.Parameter(problem.horizon, nonneg=True)
        self._r = [start.rotation + np.zeros((problem.dimension,) * 2)]
        self._r += [cp.Variable((problem.dimension,) * 2) for _ in range(problem.horizon)]
        self._s, self._p = self._rollout(start)
        self._first(start)
        self._limits(start, goals)
        self._cells = [self._choice(each) for each in self.choices]
        self._program = cp.Problem(cp.Minimize(self._cost(start, goals)), self._rows)

    def _rollout(self, start: State) -> tuple[list, list]:
        problem, w = self.problem, start.disturbance
        h, z, s, p = problem.step, problem.forward, [start.position], [start.velocity]
        late = LATE[problem.discretisation]
        for k in range(problem.horizon):
            old, new = self._r[k][:, 0], self._r[k + 1][:, 0]
            gained = h * (z * ((1.0 - late) * old + late * new) + w)
            way = gained
            if problem.translation_order == 2:
                way = h * p[-1]
                if problem.discretisation == 'exact':
                    way = way + h * h * (z * (old / 3.0 + new / 6.0) + w / 2.0)
                if problem.discretisation == 'held':
                    way = way + h * h / 2.0 * (z * new + w)
            for states, more in ((s, way), (p, gained))[: problem.translation_order]:
                after = cp.Variable(problem.dimension)  # a variable each keeps programs sparse
                self._rows.append(after == states[-1] + more)
                states.append(after)
        return s, p

    def _by(self, name: str, step: int) -> cp.Parameter:
        return self.ease.setdefault((name, step), cp.Parameter(value=0.0))

    def _first(self, start: State) -> None:
        if self.problem.rotation_order == 1:
            return
        if start.coasted is None:
            decided = start.rotation + self.problem.step * start.rotation_rate
            self._rows.append(self._r[1] == decided)
            return
        fraction = cp.Variable()
        self._rows += [self._r[1] == fraction * start.coasted]
        self._rows += [fraction >= -self._by('thrust', 1)]

    def _limits(self, start: State, goals: np.ndarray) -> None:
        problem, rows = self.problem, self._rows
        headings, n, last = [each[:, 0] for each in self._r], problem.dimension, problem.horizon
        for k in range(1, last + 1):
            self._hull(self._r[k], self._by('hull', k))
            if problem.max_rate:
                self._by('max_rate', k)
                rows.append(cp.norm(headings[k] - headings[k - 1]) <= self._chords[k - 1])
            if problem.tilt:
                rows.append(cp.norm(headings[k]) * math.cos(problem.tilt) <= headings[k][2])
            if problem.glide_slope:
                away = self._s[k] - goals[k - 1]
                rows.append(cp.norm(away[:2]) * math.tan(problem.glide_slope) <= away[2])
        if problem.approach.exists:
            ahead = problem.approach.axis(start) @ headings[-1]
            cosine = math.cos(problem.approach.cone)
            rows += [ahead >= cosine * cp.norm(headings[-1])]
            rows += [ahead >= cosine * problem.least_heading]
        for i, axis in enumerate('xyz'[:n] if problem.terminal == 'constraint' else ''):
            rows.append(self._s[-1][i] == goals[-1][i] + self._by(f'terminal {axis}', last))
            if problem.translation_order == 2:
                rows.append(self._p[-1][i] == self._by(f'terminal velocity {axis}', last))

    def _hull(self, r: cp.Expression, by: cp.Parameter) -> None:
        """conv SO(n): a disk, or the linear matrix inequality of Sanyal and others."""
        if r.shape == (2, 2):
            self._rows += [r[0, 0] == r[1, 1], r[0, 1] == -r[1, 0], cp.norm(r[:, 0]) <= 1 + by]
            return
        a, b, c = (r[i, i] for i in range(3))
        x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
        xy, xz, yz = r[1, 0] + r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2]
        matrix = [
            [1 + a + b + c, x, y, z],
            [x, 1 + a - b - c, xy, xz],
            [y, xy, 1 - a + b - c, yz],
            [z, xz, yz, 1 - a - b + c],
        ]
        self._rows.append(cp.bmat(matrix) + by * np.eye(4) >> 0)

    def _choice(self, choice: Choice) -> tuple[cp.Parameter, cp.Parameter]:
        normal, offset = cp.Parameter(self.problem.dimension), cp.Parameter()
        for k in choice.steps:
            value = self._r[k][:, 0] if choice.on == 'heading' else self._s[k]
            self._rows.append(normal @ value >= offset - self._by(choice.name, k))
        return normal, offset

    def _cost(self, start: State, goals: np.ndarray) -> Any:
        problem, w, h, r = self.problem, self.problem.weights, self.problem.step, self._r
        inputs = [(b - a) / h for a, b in itertools.pairwise(r)]
        if problem.rotation_order == 2:
            inputs = [(b - a) / h for a, b in itertools.pairwise(inputs)]
        misses = [place - goal for place, goal in zip(self._s[1:], goals, strict=True)]
        cost = w.position * sum(map(cp.sum_squares, misses))
        cost += w.input * sum(map(cp.sum_squares, inputs)) if inputs else 0.0
        cost += (w.terminal + problem.arrival_weight) * cp.sum_squares(misses[-1])
        if problem.translation_order == 2:
            cost += problem.arrival_weight * h * h * cp.sum_squares(self._p[-1])
        if w.length:
            late = LATE[problem.discretisation]
            sizes = [cp.norm(each[:, 0]) for each in r]
            flown = sum((1 - late) * a + late * b for a, b in itertools.pairwise(sizes))
            cost += w.length * h * problem.forward * flown
        return cost + (w.attitude * cp.sum_squares(r[-1] - start.wanted) if w.attitude else 0.0)

    def taking(self, cells: list[Cell]) -> Stated:
        """Fix the branch: one half-space per choice."""
        for (normal, offset), cell in zip(self._cells, cells, strict=True):
            normal.value, offset.value = cell
        return self

    def optimum(self, name: str = '', step: int = 0, by: float = 0.0, **how: Any) -> float:
        """Return the optimal cost, infinite if infeasible, with one constraint relaxed ``by``.

        ``how`` goes to CVXPY's ``solve``.
        """
        for parameter in self.ease.values():
            parameter.value = 0.0
        omega = np.full(self.problem.horizon, self.problem.max_rate)
        if name == 'max_rate':
            omega[step - 1] += by
        elif name:
            self.ease[name, step].value = by
        self._chords.value = 2.0 * np.sin(0.5 * self.problem.step * omega)
        return self._program.solve(solver=cp.CLARABEL, **how)


def convex(problem: Problem, start: State, goals: np.ndarray) -> float:
    """Return the optimal value of a problem without choices."""
    return Stated(problem, start, goals).optimum()


def enumerated(problem: Problem, start: State, goals: np.ndarray) -> float:
    """Return the least optimal value over all branches."""
    stated = Stated(problem, start, goals)
    branches = itertools.product(*(each.cells for each in stated.choices))
    return min(stated.taking(cells).optimum() for cells in branches)
