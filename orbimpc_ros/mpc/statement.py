"""The relaxed problem as CVXPY states it, term by term as the paper has it, R_k in conv SO(n)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cvxpy as cp
import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import input_weight, position_weights
from orbimpc_ros.mpc.disjunction import Slot
from orbimpc_ros.mpc.dynamics import input_map
from orbimpc_ros.mpc.orbitopes import constraints, coordinate_count, coordinates
from orbimpc_ros.mpc.problem import Problem, State


class Statement:
    """The convex program of a problem in CVXPY, parametrised by state and goals.

    Variables are the rotation coordinates x_k of R_k and the misses e_k = s_k - g_k. With those,
    state and goals stand on right-hand sides only, and the cost is a constant quadratic form.

    Each slot is one linear row over R_k e1 or e_k that a search may fill with a half-space; here
    its coefficients are placeholders that keep a place in the compiled matrix.

    Args:
        problem: what to solve.
        slots: what half-spaces will be put on.
        coasting: whether R_1 = rho * (the coasted rotation) with rho in [0, 1] free.
    """

    def __init__(self, problem: Problem, slots: Sequence[Slot], coasting: bool) -> None:
        n, steps, d = problem.dimension, problem.horizon, coordinate_count(problem.dimension)
        self.problem, self.coasting = problem, coasting
        self.x = cp.Variable((steps + 1) * d, name='R')
        self.e = cp.Variable(steps * n, name='s - g')
        self.fraction = cp.Variable(name='thrust fraction')
        self._rotations = cp.reshape(self.x, (steps + 1, d), order='C')
        self._misses = cp.reshape(self.e, (steps, n), order='C')
        self._headings = self._rotations[:, :n]
        self._first = cp.Parameter(d)
        self._second = cp.Parameter(d)
        self._velocity = cp.Parameter(n)
        self._shift = cp.Parameter((steps, n))
        self.slots = tuple(slots)
        self._offsets = cp.Parameter(len(slots)) if slots else None
        cost, epigraph = self._cost()
        self.program = cp.Problem(
            cp.Minimize(cost),
            [
                *self._rotation_constraints(),
                *self._translation_constraints(),
                *self._limits(),
                *epigraph,
                *self._slot_rows(),
            ],
        )

    def parameters(self) -> list[cp.Parameter]:
        """Return the parameters in the order of :meth:`values`, slot offsets last."""
        known = {p.id for p in self.program.parameters()}
        candidates = [self._first, self._second, self._velocity, self._shift, self._offsets]
        return [p for p in candidates if p is not None and p.id in known]

    def values(self, state: State, goals: Array) -> Array:
        """Return the parameters' values for a state and goals, without the slot offsets."""
        h, n = self.problem.step, self.problem.dimension
        shift = np.empty((self.problem.horizon, n))
        shift[0] = state.position - goals[0]
        shift[1:] = goals[:-1] - goals[1:]
        value = {
            self._first.id: coordinates(state.rotation),
            self._second.id: coordinates(state.rotation + h * state.rotation_rate),
            self._velocity.id: state.velocity,
            self._shift.id: shift.ravel(order='F'),
        }
        return np.concatenate([value[p.id] for p in self.parameters() if p.id in value])

    def compiled(self, values: Array) -> dict[str, Any]:
        """Return Clarabel's data with the parameters, slot offsets included, at ``values``."""
        at = 0
        for parameter in self.parameters():
            chunk = values[at : at + parameter.size]
            parameter.value = chunk.reshape(parameter.shape, order='F')
            at += parameter.size
        return self.program.get_problem_data(cp.CLARABEL, enforce_dpp=True)[0]

    def _rotation_constraints(self) -> list[cp.Constraint]:
        problem, x = self.problem, self._rotations
        given: list[cp.Constraint] = [x[0] == self._first]
        if problem.rotation_order == 1:
            return given + constraints(x[1:], problem.dimension)
        if self.coasting:
            placeholder = np.ones(coordinate_count(problem.dimension))
            given += [x[1] == self.fraction * placeholder, self.fraction >= 0, self.fraction <= 1]
        else:
            given.append(x[1] == self._second)
        free = constraints(x[2:], problem.dimension) if problem.horizon > 1 else []
        return given + free

    def _translation_constraints(self) -> list[cp.Constraint]:
        """e_{k+1} = e_k + h p_k + (g_k - g_{k+1}), with p_k = z R_k e1 at order 1."""
        problem, pushed = self.problem, self.problem.forward * self._headings
        if problem.translation_order == 1:
            velocity, rows = pushed, []
        else:
            velocity = cp.Variable((problem.horizon + 1, problem.dimension), name='p')
            rows = [
                velocity[0] == self._velocity,
                velocity[1:] == velocity[:-1] + problem.step * pushed[:-1],
            ]
        moved = problem.step * velocity[:-1] + self._shift
        rows.append(self._misses[0] == moved[0])
        if problem.horizon > 1:
            rows.append(self._misses[1:] == self._misses[:-1] + moved[1:])
        if problem.terminal == 'constraint':
            rows.append(self._misses[-1] == 0)
            if problem.translation_order == 2:
                rows.append(velocity[-1] == 0)
        return rows

    def _limits(self) -> list[cp.Constraint]:
        """|(R_{k+1} - R_k) e1| <= 2 sin(h omega / 2)."""
        problem = self.problem
        if problem.max_rate <= 0.0:
            return []
        chord = 2.0 * np.sin(0.5 * problem.step * problem.max_rate)
        turned = self._headings[1:] - self._headings[:-1]
        return [cp.SOC(np.full(problem.horizon, chord), turned.T)]

    def _slot_rows(self) -> list[cp.Constraint]:
        if self._offsets is None:
            return []
        n = self.problem.dimension
        ones = np.ones(n)
        picked = [
            (self._headings[s.step] if s.on == 'heading' else self._misses[s.step - 1]) @ ones
            for s in self.slots
        ]
        return [cp.hstack(picked) >= self._offsets]

    def slot_variables(self, slot: int) -> tuple[cp.Variable, range]:
        """Return the variable that a slot is a row over, and which of its entries."""
        n, wanted = self.problem.dimension, self.slots[slot]
        if wanted.on == 'heading':
            start = wanted.step * coordinate_count(n)
            return self.x, range(start, start + n)
        return self.e, range((wanted.step - 1) * n, wanted.step * n)

    def _cost(self) -> tuple[cp.Expression, Sequence[cp.Constraint]]:
        problem, w, n = self.problem, self.problem.weights, self.problem.dimension
        squares = sparse.diags(np.repeat(position_weights(problem), n)).tocsc()
        cost = cp.quad_form(self.e, squares, assume_PSD=True) + cp.quad_form(
            self.x, self._input_form(), assume_PSD=True
        )
        if w.length == 0.0 or problem.horizon == 1:
            return cost, []
        length = cp.Variable(problem.horizon - 1, name='|R e1|')
        epigraph: list[cp.Constraint] = [cp.SOC(length, self._headings[1:-1].T)]
        if problem.floor.shape != 'none':
            epigraph.append(length >= problem.floor.fraction)  # valid: the floor says the same
        return cost + w.length * problem.step * problem.forward * cp.sum(length), epigraph

    def _input_form(self) -> sparse.csc_matrix:
        n = self.problem.dimension
        differences = sparse.csc_matrix(input_map(self.problem))
        per_coordinate = differences.T @ differences
        weighted = input_weight(self.problem) * per_coordinate
        return sparse.kron(weighted, sparse.eye(coordinate_count(n))).tocsc()
