r"""The true floor fraction <= |R_k e1| <= 1: stationary points, and the proof that one is global.

With z_k = R_k e1 and t_k the modulus it sits on, a stationary point satisfies

.. math::
    \sum_j H_{kj} z_j + q_k + \ell h z\, z_k/|z_k| + \mu_k z_k + a_k \nu = 0,
    \qquad |z_k| = t_k \ (\mu_k \ne 0), \qquad \sum_k a_k z_k = b,

mu_k >= 0 at the rim, mu_k <= 0 at the floor. It is the *global* optimum if the Lagrangian is convex
in z, that is if H + diag(Theta) is positive semidefinite on the null space of a: one eigenvalue of
an N x N matrix. Without a length weight Theta = mu. With one, part of each length is bounded below
by its chord in |z|^2, which is convex, as far as the sign of mu allows (see :func:`_curvatures`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc import dynamics
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.rotations import HEADING_UNDEFINED

MAX_ITERATIONS = 60
RESIDUAL = 1e-10
LONGEST_STEP = 0.4  # no heading moves farther in one Newton step
MAX_HALVINGS = 12
LARGEST_MULTIPLIER = 1e6
ON_BOUND = 1e-3  # a start this close to the rim or the floor is taken to sit on it


@dataclass
class _Point:
    """A primal-dual iterate, and on which bound each heading sits: floor -1, rim 1, neither 0."""

    z: Array
    mu: Array
    nu: Array
    side: np.ndarray


@dataclass(frozen=True)
class Stationary:
    """A stationary point of the annulus problem and the bound that it proves.

    Attributes:
        headings: z_1..z_N, shape (N, n).
        cost: the objective there.
        lower_bound: no trajectory costs less; equal to ``cost`` up to rounding where the
            Lagrangian is convex, the more below it the less convex it is.
    """

    headings: Array
    cost: float
    lower_bound: float


class Annulus:
    """The annulus problem of rotation order 1 and translation order 1.

    Args:
        problem: what to solve; of its constraints only the floor and the terminal one are seen.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        n_steps, n = problem.horizon, problem.dimension
        self._condensed = Condensed(problem)
        self._hessian = self._condensed.hessian
        self._length = np.full(n_steps, problem.weights.length * problem.step * problem.forward)
        self._length[-1] = 0.0
        arrival = np.zeros((n_steps, 0))
        if problem.terminal == 'constraint':
            arrival = dynamics.position_map(problem)[-1:, 1:].T
        self._free = _null_space(arrival)
        self._expanded = np.kron(self._hessian, np.eye(n))
        self._rows = np.kron(arrival, np.eye(n))
        self._floor = problem.floor.fraction

    def bind(self, state: State, goals: Array) -> None:
        """Take a state and goals g_1..g_N, shape (N, n)."""
        problem = self._problem
        self._linear, self._constant = self._condensed.affine(state, goals)
        reached = problem.step * problem.forward * state.rotation[:, 0]
        left = goals[-1] - state.position - reached
        self._left = left if self._rows.shape[1] else np.zeros(0)

    def cost(self, z: Array) -> float:
        """Return the objective of headings z_1..z_N, shape (N, n)."""
        quadratic = np.sum(z * (0.5 * self._hessian @ z + self._linear))
        return float(quadratic + self._length @ _moduli(z) + self._constant)

    def stationary(self, start: Array) -> Stationary | None:
        """Return the stationary point that an active-set Newton method reaches, or None.

        Args:
            start: headings, shape (N, n); taken to the annulus first.
        """
        point = self._placed(start)
        for _ in range(MAX_ITERATIONS):
            try:
                self._step(point)
            except np.linalg.LinAlgError:
                return None
            if np.abs(point.nu).max(initial=0.0) > LARGEST_MULTIPLIER:
                return None  # all headings in line with the arrival: the bounds leave no way out
            if self._catch(point) or self._error(point) > RESIDUAL:
                continue
            if self._release(point):
                continue
            cost = self.cost(point.z)
            return Stationary(point.z, cost, cost - self._doubt(point))
        return None

    def _placed(self, start: Array) -> _Point:
        """Return a start on the annulus, each heading near a bound put on it."""
        z = np.array(start, dtype=float)
        moduli = _moduli(z)
        z[moduli < HEADING_UNDEFINED] = np.eye(z.shape[1])[0]
        moduli = _moduli(z)
        side = np.where(moduli >= 1.0 - ON_BOUND, 1, 0)
        side[moduli <= self._floor + ON_BOUND] = -1
        if self._floor == 1.0:
            side[:] = 1
        z *= (np.clip(moduli, self._floor, 1.0) / moduli)[:, None]
        return _Point(z, np.zeros(len(z)), np.zeros(self._rows.shape[1]), side)

    def _step(self, point: _Point) -> None:
        """Move by a damped Newton step on the manifold of the bounds that headings sit on.

        Sequential quadratic programming in null-space form: the Hessian of the Lagrangian is made
        positive definite there by reflecting negative eigenvalues, so that the step descends; near
        a minimum it is Newton's. Multipliers are the least-squares ones.
        """
        z, (steps, n) = point.z, point.z.shape
        active = np.flatnonzero(point.side)
        normals = np.zeros((steps * n, len(active) + self._rows.shape[1]))
        for column, k in enumerate(active):
            normals[k * n : (k + 1) * n, column] = z[k]
        normals[:, len(active) :] = self._rows
        modulus, arrival = self._off(point)
        gap = -np.concatenate([0.5 * modulus[active], arrival])
        lagrangian = self._lagrangian_hessian(point)
        gradient = (self._gradient(z)).ravel()
        q, r = np.linalg.qr(normals, mode='complete')
        count = normals.shape[1]
        along, across = q[:, :count], q[:, count:]
        move = along @ np.linalg.lstsq(r[:count].T, gap, rcond=None)[0]
        values, vectors = np.linalg.eigh(across.T @ lagrangian @ across)
        safe = np.maximum(np.abs(values), 1e-8 * max(1.0, np.abs(values).max(initial=0.0)))
        pull = across.T @ (gradient + lagrangian @ move)
        move = move - across @ (vectors @ ((vectors.T @ pull) / safe))
        multipliers = np.linalg.lstsq(
            r[:count], -along.T @ (gradient + lagrangian @ move), rcond=None
        )[0]
        self._advance(point, move.reshape(steps, n), multipliers[len(active) :])
        point.mu[:] = 0.0
        point.mu[active] = multipliers[: len(active)]
        point.nu = multipliers[len(active) :]

    def _advance(self, point: _Point, move: Array, nu: Array) -> None:
        """Take the longest share of a step that lowers an exact penalty, back on the bounds."""
        weight = 2.0 * np.abs(nu).max(initial=0.0) + 1.0
        before = self._merit(point.z, weight)
        share = min(1.0, LONGEST_STEP / max(_moduli(move).max(), 1e-300))
        for _ in range(MAX_HALVINGS):
            z = self._on_bounds(point.z + share * move, point.side)
            if self._merit(z, weight) <= before + 1e-13 * abs(before):
                break
            share *= 0.5
        point.z = z

    def _merit(self, z: Array, weight: float) -> float:
        missed = np.abs(self._rows.T @ z.ravel() - self._left).sum()
        return self.cost(z) + weight * float(missed)

    def _on_bounds(self, z: Array, side: np.ndarray) -> Array:
        moduli = np.maximum(_moduli(z), HEADING_UNDEFINED)
        scale = np.where(side == 0, 1.0, np.sqrt(self._target(side)) / moduli)
        return z * scale[:, None]

    def _gradient(self, z: Array) -> Array:
        return self._hessian @ z + self._linear + (self._length / _moduli(z))[:, None] * z

    def _lagrangian_hessian(self, point: _Point) -> Array:
        z, (steps, n) = point.z, point.z.shape
        moduli = _moduli(z)
        matrix = self._expanded.copy()
        blocks = matrix.reshape(steps, n, steps, n)
        each = np.arange(steps)
        outer = z[:, :, None] * z[:, None, :]
        blocks[each, :, each, :] += (point.mu + self._length / moduli)[:, None, None] * np.eye(n)
        blocks[each, :, each, :] -= (self._length / moduli**3)[:, None, None] * outer
        return matrix

    def _catch(self, point: _Point) -> bool:
        """Put free headings that left the annulus back on the bound they crossed."""
        moduli = _moduli(point.z)
        free = point.side == 0
        out, under = free & (moduli > 1.0), free & (moduli < self._floor)
        point.side[out], point.side[under] = 1, -1
        crossed = out | under
        target = np.where(out, 1.0, self._floor)
        point.z[crossed] *= (target / moduli)[crossed, None]
        return bool(crossed.any())

    def _release(self, point: _Point) -> bool:
        """Let go of the heading that pulls away from its bound the most, if one does."""
        if self._floor == 1.0:
            return False
        pull = point.mu * point.side
        worst = int(np.argmin(pull))
        if pull[worst] >= -RESIDUAL:
            return False
        point.side[worst], point.mu[worst] = 0, 0.0
        return True

    def _target(self, side: np.ndarray) -> Array:
        """Return the squared modulus that each heading sits on (1 where it is free)."""
        return np.where(side < 0, self._floor**2, 1.0)

    def _residual(self, point: _Point) -> Array:
        arrival = (self._rows @ point.nu).reshape(point.z.shape)
        return self._gradient(point.z) + point.mu[:, None] * point.z + arrival

    def _off(self, point: _Point) -> tuple[Array, Array]:
        """Return how far active moduli (squared) and the arrival are off."""
        modulus = (_moduli(point.z) ** 2 - self._target(point.side)) * (point.side != 0)
        return modulus, self._rows.T @ point.z.ravel() - self._left

    def _error(self, point: _Point) -> float:
        modulus, arrival = self._off(point)
        scale = 1.0 + np.abs(self._linear).max()
        stray = np.abs(self._residual(point)).max() / scale
        return float(max(stray, np.abs(modulus).max(), np.abs(arrival).max(initial=0.0)))

    def _doubt(self, point: _Point) -> float:
        """Return by how much the true optimum may undercut this point at most.

        L(z') >= L(z) + dL . (z' - z) + lambda_min / 2 |z' - z|^2 with |z_k' - z_k| <= 2.
        """
        curved = self._hessian + np.diag(self._curvatures(point))
        least = np.linalg.eigvalsh(self._free.T @ curved @ self._free)[0] if self._free.size else 0
        modulus, arrival = self._off(point)
        return float(
            2.0 * len(point.z) * max(0.0, -least)
            + 2.0 * _moduli(self._residual(point)).sum()
            + 0.5 * np.abs(point.mu) @ np.abs(modulus)
            + np.abs(point.nu) @ np.abs(arrival)
        )

    def _curvatures(self, point: _Point) -> Array:
        r"""Return Theta, the most that moduli and lengths add to the Lagrangian's curvature.

        The length l |z| is bounded below by (1 - alpha) l d.z + alpha l (|z|^2 + f)/(1 + f), with d
        the direction of z and f the floor: a share alpha of the chord that agrees with sqrt at both
        ends. The larger alpha, the larger Theta = eta - (1 - alpha) l / |z| with the total pull
        eta = mu + l / |z|; but the multiplier left for the modulus,
        Theta - 2 alpha l / (1 + f), must keep its sign.
        """
        length, moduli, f = self._length, _moduli(point.z), self._floor
        eta = point.mu + length / moduli
        if f == 1.0:
            return eta  # the modulus is an equation, its multiplier free: alpha = 1
        chord, slope = 2.0 * length / (1.0 + f), length / moduli
        spread = np.where(point.side == 0, 0.0, slope - chord)
        with np.errstate(divide='ignore', invalid='ignore'):
            share = np.where(spread != 0.0, np.clip(-point.mu / spread, 0.0, 1.0), 0.0)
        return eta - (1.0 - share) * slope


def _moduli(z: Array) -> Array:
    return np.sqrt(np.einsum('kc,kc->k', z, z))


def _null_space(rows: Array) -> Array:
    """Return an orthonormal basis of the vectors orthogonal to the columns, shape (N, N - m)."""
    if rows.shape[1] == 0:
        return np.eye(len(rows))
    q, _ = np.linalg.qr(rows, mode='complete')
    return q[:, rows.shape[1] :]
