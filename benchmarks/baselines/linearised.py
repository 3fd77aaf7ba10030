# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Linearised MPC: the heading angle as a state, one quadratic program a tick.

About the previous plan, moved one step on, the thrust axes are

.. math:: z_k = \sigma_k e(\theta_k) \approx \sigma_k e(\bar\theta_k)
          + \bar\sigma_k (\theta_k - \bar\theta_k)\, e'(\bar\theta_k),

so that the objective becomes quadratic in speed fractions and headings, the floor and full speed
become bounds on the first, and the rate limit becomes linear in the second. Of a ball that moves, a
plan stays on the side of the tangent that faces the previous plan then, or pays for what it does
not.
"""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from benchmarks.baselines.program import Program, balls_of, coasting, least_fraction
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State

# How far a heading may move from the one that it is linearised about [rad]. Of 0.15, 0.3 .. 0.8,
# pi/2 and pi this one catches the most ropes of the study with its defaults: the others lose 3 to
# 98 % of them, the larger ones because a sideways step looks like speed for nothing.
TRUST = 0.5
TOUCH = 1e3  # cost of a step's length inside of a ball


class Linearised(Program):
    """One Gauss-Newton step on the angles and speeds of the plan at each tick.

    Args:
        problem: what to plan; the floor's polygon is taken at the linearised headings.
        trust: how far a heading may move from the one that it is linearised about [rad].
    """

    def __init__(self, problem: Problem, trust: float = TRUST) -> None:
        super().__init__(problem)
        self._trust = trust
        self._condensed = Condensed(problem)
        self._settings = clarabel.DefaultSettings()
        self._settings.verbose = False

    def axes(self, state: State, goals: Array) -> Array:
        """Return the axes that the linearised problem's optimum stands for."""
        before = self.shifted(state)
        speeds = np.linalg.norm(before, axis=1)
        along = before / speeds[:, None]
        moved = self._optimum(state, goals, speeds, along)[: 2 * self.problem.horizon]
        steps = self.problem.horizon
        angles = np.arctan2(along[:, 1], along[:, 0]) + moved[steps:]
        return moved[:steps, None] * np.column_stack([np.cos(angles), np.sin(angles)])

    def _optimum(self, state: State, goals: Array, speeds: Array, along: Array) -> Array:
        """Return the best speed fractions, changes of heading, and depths, shape (2 N or more,)."""
        linear, _ = self._condensed.affine(state, goals)
        across = speeds[:, None] * np.column_stack([-along[:, 1], along[:, 0]])
        # z = J (speeds, changes), coordinate by coordinate.
        jacobians = [np.hstack([np.diag(along[:, i]), np.diag(across[:, i])]) for i in (0, 1)]
        quadratic = sum(j.T @ self._condensed.hessian @ j for j in jacobians)
        gradient = sum(j.T @ linear[:, i] for i, j in enumerate(jacobians))
        rows, offsets = self._limits(state, along)
        if state.hazards:
            shapes = np.array(jacobians)
            beyond, short = tangents(self.problem, state, speeds[:, None] * along, shapes)
            quadratic = np.pad(quadratic, (0, len(short)))
            price = TOUCH / self.problem.length_unit
            gradient = np.append(gradient, np.full(len(short), price))
            rows, offsets = _eased(rows, offsets, -beyond, -short)
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix(np.triu(quadratic)),
            gradient,
            sparse.csc_matrix(rows),
            offsets,
            [clarabel.NonnegativeConeT(len(offsets))],
            self._settings,
        )
        return np.array(solver.solve().x)

    def _limits(self, state: State, along: Array) -> tuple[Array, Array]:
        """Return A and b of A (speeds, changes) <= b."""
        steps, each = self.problem.horizon, np.eye(2 * self.problem.horizon)
        high = np.concatenate([np.ones(steps), np.full(steps, self._trust)])
        low = np.concatenate([least_fraction(self.problem, along), np.full(steps, -self._trust)])
        rows, offsets = [each, -each], [high, -low]
        if self.problem.max_rate > 0.0:
            turn = np.hstack([np.zeros((steps, steps)), np.eye(steps) - np.eye(steps, k=-1)])
            turned = _turns(np.vstack([state.attitude[:, 0], along]))
            most = self.problem.step * self.problem.max_rate
            rows += [turn, -turn]
            offsets += [most - turned, most + turned]
        return np.vstack(rows), np.concatenate(offsets)


def _eased(rows: Array, offsets: Array, more: Array, least: Array) -> tuple[Array, Array]:
    """Return A and b of A (x, e) <= b with more rows, each eased by a variable e >= 0 of its own.

    Args:
        rows: that hold as they are, shape (K, M).
        offsets: of them, shape (K,).
        more: that are eased, shape (E, M).
        least: offsets of those, shape (E,).
    """
    eased = len(more)
    none, each = np.zeros((len(rows), eased)), np.eye(eased)
    sides = np.vstack([rows, more, np.zeros(more.shape)]), np.vstack([none, -each, -each])
    return np.hstack(sides), np.concatenate([offsets, least, np.zeros(eased)])


def tangents(problem: Problem, state: State, axes: Array, jacobians: Array) -> tuple[Array, Array]:
    """Return A and b of A x >= b, one row a step and ball: beyond its tangent.

    Args:
        problem: what is planned.
        state: with the balls.
        axes: of the plan that the tangents face, shape (N, 2).
        jacobians: of axes by x, coordinate by coordinate, shape (2, N, M).

    Raises:
        BadInput: something else than a ball.
    """
    reach = problem.maps.reach
    drifted = coasting(problem, state)
    centres, radii = balls_of(problem, state)
    away = drifted + reach[:, 1:] @ axes - centres  # (J, N, 2)
    facing = away / np.maximum(np.linalg.norm(away, axis=2, keepdims=True), 1e-9)
    moved = np.einsum('kl,clm->kcm', reach[:, 1:], jacobians)
    rows = np.einsum('jkc,kcm->jkm', facing, moved)
    short = radii[:, None] - np.einsum('jkc,jkc->jk', facing, drifted - centres)
    return rows.reshape(-1, rows.shape[2]), short.ravel()


def _turns(directions: Array) -> Array:
    """Return the angles from unit vector to unit vector, shape (N + 1, 2), as (N,) [rad]."""
    a, b = directions[:-1], directions[1:]
    return np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], np.sum(a * b, axis=1))
