# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The tangent at an optimum: a plan's headings made stationary to rounding, with their multipliers.

What methods publish is accurate to about 1e-9; a tangent's bound lacks what its point is off by,
to first order. Newton's method on the conditions of optimality takes both down to rounding. Where
the cost with the multipliers of the moduli as bends is convex, that proves the plan optimal.

Mathematics: docs/mathematics.md, 4.4, and docs/proofs.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.model.dynamics import drift
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.certificate import Leaf

ROUNDS, STEPS = 12, 6  # changes of what is active, and Newton steps for each
NEGLIGIBLE = 1e-13  # a multiplier, of the forces at work
SHORT = 1e-9  # a heading that has no direction
STIFF = (0.0, 1.0, 1e2, 1e4, 1e6)  # in curvatures of the cost, of what an arrival misses


@dataclass(frozen=True)
class HeadingProblem:
    """The cost 1/2 sum_jk H_jk z_j.z_k + sum_k q_k.z_k + sum_k l_k |z_k|, and what holds of z.

    Attributes:
        hessian: H, shape (N, N).
        q: shape (N, d).
        length: l, shape (N,).
        floor: least modulus.
        arrival: A with A z = left, shape (m, N).
        left: shape (m, d).
        decided: what z_1 is a multiple of, or is, shape (d,); None where it is free.
        coasting: whether the multiple is free, in [0, 1].
    """

    hessian: Array
    q: Array
    length: Array
    floor: float
    arrival: Array
    left: Array
    decided: Array | None
    coasting: bool


def setting(problem: Problem, state: State, goals: Array) -> HeadingProblem:
    """Return what a problem comes to where its cost sees thrust axes alone."""
    condensed, n = Condensed(problem), problem.dimension
    q, _ = condensed.affine(state, goals)
    arrival, left = arrival_of(problem, state, goals)
    decided, coasting = None, False
    if problem.rotation_order == 2:
        coasting = state.coasted is not None
        given = state.rotation + problem.step * state.rotation_rate
        decided = coordinates(given if state.coasted is None else state.coasted)
    floor = problem.floor.clearance(n)
    length = length_weights(problem)[1:]
    return HeadingProblem(condensed.hessian, q, length, floor, arrival, left, decided, coasting)


def arrival_of(problem: Problem, state: State, goals: Array) -> tuple[Array, Array]:
    """Return what each heading adds to s_N and p_N, shape (m, N), and what they are to come to.

    m is 0 where a plan does not have to arrive, else 1, or 2 with inertia; the latter is (m, n).
    """
    if problem.terminal != 'constraint':
        return np.zeros((0, problem.horizon)), np.zeros((0, problem.dimension))
    maps, first = problem.maps, state.rotation[:, 0]
    rows = [maps.reach[-1]]
    left = [goals[-1] - drift(problem, state)[-1]]
    if problem.inertial:
        rows.append(maps.pushed[-1])
        left.append(-maps.carried[-1] * state.velocity - maps.hastened[-1] * state.disturbance)
    every = np.array(rows)
    return every[:, 1:], np.array(left) - np.outer(every[:, 0], first)


class Stationary:
    """Headings on their way to a stationary point, with what holds them there.

    Args:
        asked: cost and constraints.
        z: headings near a stationary point, shape (N, d).
        near: moduli as near as that to 1, the floor, or 0 where lengths count, begin there.
    """

    def __init__(self, asked: HeadingProblem, z: Array, near: float) -> None:
        self._asked, self._z, self._near = asked, z.copy(), near
        self._theta, self._nu = np.zeros(len(z)), np.zeros(asked.left.shape)
        size = np.linalg.norm(z, axis=1)
        self._side = np.where(size >= 1.0 - near, 1, 0)
        if asked.floor:
            self._side[size <= asked.floor + near] = -1
        self._base, self._basis = self._freedom()
        self._scale = float(np.abs(asked.q).max() + np.abs(asked.hessian).max()) or 1.0

    def _freedom(self) -> tuple[Array, Array]:
        """Return x and B of all headings x + B v: a length may rest one, a state decide another."""
        asked, z = self._asked, self._z
        resting = (asked.length > 0.0) & (np.linalg.norm(z, axis=1) < self._near)
        z[resting] = 0.0
        base, basis = np.zeros(z.size), np.eye(z.size)[:, ~np.repeat(resting, z.shape[1])]
        if asked.decided is None:
            return base, basis
        d, self._side[0] = z.shape[1], 0
        share = float(z[0] @ asked.decided) if asked.coasting else 1.0
        along = np.zeros(z.size)
        along[:d] = asked.decided
        basis = basis[:, ~basis[:d].any(axis=0)]
        if asked.coasting and SHORT < share < 1.0 - SHORT:
            return base, np.column_stack([along, basis])
        return min(1.0, max(0.0, share)) * along, basis

    def settled(self) -> Leaf:
        """Return the tangent at the stationary point, with the multipliers there."""
        for _ in range(ROUNDS):
            for _ in range(STEPS):
                self._step()
            if not self._changed():
                break
        return self._leaf()

    def _step(self) -> None:
        """Take a step of Newton's method on all conditions, the active moduli's included."""
        asked, z = self._asked, self._z
        (count, d), own = z.shape, np.flatnonzero(self._side)
        rows = np.zeros((len(own), count, d))
        rows[np.arange(len(own)), own] = z[own]
        radius = np.where(self._side[own] > 0, 1.0, asked.floor)
        missed = [
            0.5 * (np.sum(z[own] ** 2, axis=1) - radius**2),
            (asked.arrival @ z - asked.left).ravel(),
        ]
        held = np.vstack([rows.reshape(-1, z.size), np.kron(asked.arrival, np.eye(d))])
        held = held @ self._basis
        bent, force = self._conditions()
        free = self._basis.T @ bent @ self._basis
        system = np.block([[free, held.T], [held, np.zeros((len(held), len(held)))]])
        right = -np.concatenate([self._basis.T @ force, *missed])
        step = np.linalg.lstsq(system, right, rcond=1e-15)[0]
        moved, pulled = np.split(step, [free.shape[0]])
        self._z = z + (self._basis @ moved).reshape(z.shape)
        self._theta[own] += pulled[: len(own)]
        self._nu = self._nu + pulled[len(own) :].reshape(self._nu.shape)

    def _conditions(self) -> tuple[Array, Array]:
        """Return the Lagrangian's Hessian, shape (N d, N d), and gradient, shape (N d,)."""
        asked, z = self._asked, self._z
        d = z.shape[1]
        size = np.maximum(np.linalg.norm(z, axis=1, keepdims=True), SHORT)
        unit = z / size
        bent = np.kron(asked.hessian + np.diag(self._theta), np.eye(d))
        for k, length in enumerate(asked.length):
            place = slice(k * d, (k + 1) * d)
            bent[place, place] += length * (np.eye(d) - np.outer(unit[k], unit[k])) / size[k]
        force = asked.hessian @ z + asked.q + asked.length[:, None] * unit
        force += self._theta[:, None] * z + asked.arrival.T @ self._nu
        return bent, force.ravel()

    def _changed(self) -> bool:
        """Let go of moduli whose multipliers have the wrong sign, hold those beyond; say if any."""
        asked, least = self._asked, NEGLIGIBLE * self._scale
        side, size = self._side.copy(), np.linalg.norm(self._z, axis=1)
        if asked.floor < 1.0:  # else each modulus is both on the rim and on the floor
            side[self._theta * side < -least] = 0
        loose = (side == 0) & (self._side == 0)
        if asked.decided is not None:
            loose[0] = False
        side[loose & (size > 1.0 + 1e-12)] = 1
        if asked.floor:
            side[loose & (size < asked.floor - 1e-12)] = -1
        changed = bool((side != self._side).any())
        self._side = side
        self._theta[side == 0] = 0.0
        return changed

    def _leaf(self) -> Leaf:
        asked, bends = self._asked, self._theta.copy()
        lengthy = (asked.length > 0.0) & (self._side != 0)
        for k in np.flatnonzero(lengthy).tolist():
            bends[k] = _most_bent(bends[k], asked.length[k], asked.floor, self._side[k])
        if not asked.floor:
            bends = np.maximum(bends, 0.0)
        stiffness = _stiffness(asked, bends) if len(asked.left) and bends.min() < 0.0 else 0.0
        return Leaf(self._z, bends, self._nu.ravel(), stiffness)


def _most_bent(theta: float, length: float, floor: float, side: int) -> float:
    """Return the largest bend with which the tangent at a bound is as good as with its multiplier.

    Part of the length then pulls as the bend does, instead of being in the tangent's way: s l less
    t s^2 / 2 is to be least at the bound that the heading is on.
    """
    if floor == 1.0:
        return theta + length
    if side > 0:
        return max(theta, min(theta + length, 2.0 * theta / (1.0 - floor)))
    return max(theta, min(theta + length / floor, -2.0 * theta * floor / (1.0 - floor)))


def _stiffness(asked: HeadingProblem, bends: Array) -> float:
    """Return what makes the cost convex where headings that arrive say that it is."""
    bent = asked.hessian + np.diag(bends)
    square, top = asked.arrival.T @ asked.arrival, float(np.abs(asked.hessian).max())
    unit = top / (float(np.abs(square).max()) or 1.0)
    for factor in STIFF:
        if np.linalg.eigvalsh(bent + factor * unit * square)[0] > -1e-12 * top:
            return factor * unit
    return STIFF[-1] * unit
