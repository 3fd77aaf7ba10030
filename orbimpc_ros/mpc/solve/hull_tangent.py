# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What proves a plan over the hull of thrust axes, read off the plan, whoever found it.

The multipliers of disks, lengths and an arrival are taken from the slopes at the plan. The tangent
where their Lagrangian is least proves what these prove: what they are off by costs its square.

Mathematics: docs/mathematics.md, 4.8, and docs/proofs.md.
"""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.condensed import Condensed, knowns, suits_dense_code
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.tree import ProofTree, one
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.unconstrained import thrust_axis

NEAR = 1e-6  # of a modulus to 1, or of a thrust fraction to its ends
SHORT = 1e-6  # a heading that has no direction
ENOUGH = 1e-9  # relative: of what a method proved, what its tangent may lack
TINY = 1e-300


class HullTangent:
    """Tangents of a problem of the plane without other limits than disks and an arrival.

    Args:
        problem: in natural units.
    """

    def __init__(self, problem: Problem) -> None:
        self._condensed = Condensed(problem)
        self._maps = thrust_axis(problem, self._condensed)
        self._lengths = length_weights(problem)[1:]
        self._given = problem.rotation_order - 1
        rows = problem.maps.arrival[:, 1:]
        self._arrival = rows if problem.terminal == 'constraint' else rows[:0]
        self._yielding = np.zeros(problem.horizon)  # of each step to a force
        self._yielding[self._given :] = np.diag(self._maps.inverse)
        self._pulls = np.linalg.pinv(self._arrival[:, self._given :].T)

    @staticmethod
    def applies(problem: Problem) -> bool:
        """Return whether tangents alone prove optima of a problem."""
        return (
            problem.dimension == 2
            and not (problem.floor.exists or problem.max_rate or problem.max_acceleration)
            and not (problem.obstacles or problem.approach.exists or problem.has_cones)
            and problem.horizon >= 2 * max(problem.rotation_order, problem.translation_order)
            and suits_dense_code(problem)
        )

    def at(self, request: Request, x: Array, bound: float) -> ProofTree | None:
        """Return the tangent that proves a plan's bound; None where it would prove less.

        Args:
            request: what was solved.
            x: the plan's coordinates, shape (N, 2).
            bound: that the method proved.
        """
        q, constant = self._condensed.affine(request.state, request.goals)
        slopes: Array = self._condensed.hessian @ x + q
        slopes = slopes + self._arrival.T @ self._fitted(slopes, x)
        point, slopes, pull = self._lowest(request, x[0], q, self._forces(slopes, x))
        least = np.minimum(self._lengths - _sizes(slopes), 0.0)
        if self._given:
            coasted = request.state.coasted
            first = x[0] if coasted is None else coasted[:, 0]
            least[0] = slopes[0] @ first + self._lengths[0] * math.sqrt(first @ first)
            if coasted is not None:
                least[0] = min(0.0, least[0])
        rising = 0.5 * self._condensed.hessian @ point + q - slopes
        proved = constant + float(np.vdot(point, rising) + least.sum())
        if not proved >= bound - ENOUGH * abs(bound):
            return None
        pulls = {'pull': pull} if len(pull) else {}
        return one(point, np.zeros(len(x)), **pulls)

    def _lowest(
        self, request: Request, first: Array, q: Array, forces: Array
    ) -> tuple[Array, Array, Array]:
        """Return where the Lagrangian is least, the slopes there, and what pulls at the arrival.

        Args:
            request: what was solved.
            first: R_1 e1 of the plan, shape (2,).
            q: linear terms of the cost, shape (N, 2).
            forces: what disks and lengths exert, shape (N, 2).
        """
        coasted, decided = request.state.coasted, first if self._given else np.zeros(2)
        known = np.vstack([knowns(request.state, request.goals), decided])
        point = self._maps.minimiser @ known
        point[self._given :] -= self._maps.inverse @ forces[self._given :]
        slopes, pull = self._slopes(point, q, forces)
        if self._given and coasted is not None:
            point += self._slid(slopes[0], coasted[:, 0], first) * self._maps.minimiser[:, -1:]
            slopes, pull = self._slopes(point, q, forces)
        return point, slopes, pull

    def _fitted(self, slopes: Array, x: Array) -> Array:
        """Return the multipliers of an arrival that fit a plan's slopes best, shape (m, 2)."""
        rows = self._arrival
        if not len(rows):
            return np.zeros((0, 2))
        sizes = _sizes(x)
        units = x / np.maximum(sizes, SHORT)[:, None]
        on_rim = sizes >= 1.0 - NEAR
        across = np.eye(2) - units[:, :, None] * units[:, None, :]
        free = np.where((on_rim | (self._lengths > 0.0))[:, None, None], across, np.eye(2))
        free[sizes < SHORT] *= (self._lengths == 0.0)[sizes < SHORT, None, None]
        free[: self._given] = 0.0
        for _ in range(2):
            system = np.einsum('kic,jk->kijc', free, rows).reshape(2 * len(x), -1)
            right = -np.einsum('kic,kc->ki', free, slopes).ravel()
            found = np.linalg.lstsq(system, right, rcond=None)[0].reshape(len(rows), 2)
            inward = np.einsum('kc,kc->k', slopes + rows.T @ found, units) > 0.0
            if not (on_rim & inward).any():
                break
            free[on_rim & inward] = np.eye(2)  # a disk pushes inwards alone
        return np.asarray(found)

    def _forces(self, slopes: Array, x: Array) -> Array:
        """Return what disks and lengths exert at a plan with slopes, shape (N, 2).

        A disk holds what would leave it without.
        """
        outward = -np.einsum('kc,kc->k', slopes, x) * self._yielding
        held = _sizes(x) >= 1.0 - np.maximum(outward, NEAR)
        share = np.minimum(1.0, self._lengths / np.maximum(_sizes(slopes), TINY))
        forces: Array = -np.where(held, 1.0, share)[:, None] * slopes
        return forces

    def _slopes(self, point: Array, q: Array, forces: Array) -> tuple[Array, Array]:
        """Return the slopes where the Lagrangian is least, and what pulls at the arrival there."""
        slopes, free = self._condensed.hessian @ point + q, slice(self._given, None)
        pull = -self._pulls @ (slopes + forces)[free]
        return slopes + self._arrival.T @ pull, pull

    def _slid(self, slope: Array, coasted: Array, first: Array) -> Array:
        """Return how far R_1 is from where it is best on the way of a coasting body, shape (2,)."""
        fraction = float(coasted @ first)
        if not NEAR < fraction < 1.0 - NEAR:
            return round(fraction) * coasted - first
        curvature = 2.0 * self._maps.least[-1, -1]
        return -(slope @ coasted + self._lengths[0]) / curvature * coasted


def _sizes(vectors: Array) -> Array:
    return np.sqrt(np.einsum('kc,kc->k', vectors, vectors))
