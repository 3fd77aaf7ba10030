# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Round floors where no tree is searched: in space, or with an arrival.

In space the cost has to see R e1 alone; the other columns are then free, and are carried along by
the shortest turns from one thrust axis to the next. Headings are taken in turn to where the cost is
least on the shell; with an arrival a z = b, of its augmented Lagrangian. Shor multipliers, of where
that leads to or the best ones, prove a bound; what they leave open, the general search settles.

Mathematics: docs/mathematics.md, 4.6.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import carried
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.best_first import NEGLIGIBLE
from orbimpc_ros.mpc.model.condensed import Condensed, regular
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.model.dynamics import adrift
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.tree import one
from orbimpc_ros.mpc.search.relax import GOING, KEY, Quadratic
from orbimpc_ros.mpc.search.ring import INNER, OUTER, OUTLINE, TURN
from orbimpc_ros.mpc.search.shor import KINDS, certify, climb
from orbimpc_ros.mpc.solve.general import General
from orbimpc_ros.mpc.solve.request import Found, Guess, Request

SETTLED = 90.0  # tolerances at which a search may stop
BRANCHES = 8000  # polls of the general search, where nobody waits for it
OUT_OF_REACH = 1e-9  # share of the way to an arrival
SWEEPS, ROUNDS = 20, 60  # of headings in turn; and of multipliers of an arrival
NEAR = 1e-9  # an arrival missed by no more is met
STILL = 1e-11  # a sweep, or an arrival missed by no more, needs no other
SOFT, STIFF = 1.0, 1e4  # of arrivals, in curvatures of the cost: to sweep, and to prove
ON, NEWTON = 1e-4, 8  # a heading this close to a bound sits on it; steps from there
SLOW, STIFFER = 0.9, 1.5  # where more than this share of a miss is left, sweeps become stiffer


@compiled
def sweep(quad, fraction, z, sweeps):
    """Take headings in turn to where the cost is least on the shell; return the last sweep's way.

    Args:
        quad: the cost.
        fraction: the least modulus.
        z: headings, shape (N, n), updated.
        sweeps: how many at most.
    """
    count, n = z.shape
    slope, moved = np.empty(n), 0.0
    for _ in range(sweeps):
        moved = 0.0
        for k in range(count):
            square, h = 0.0, quad.hessian[k, k]
            for c in range(n):
                slope[c] = quad.q[k, c]
                for j in range(count):
                    slope[c] += quad.hessian[k, j] * z[j, c]
                slope[c] -= h * z[k, c]
                square += slope[c] * slope[c]
            size = np.sqrt(square)
            if size == 0.0:
                slope[0], size = -1.0, 1.0
            onto = min(1.0, max(fraction, (size - quad.lengths[k]) / h))
            for c in range(n):
                there = -onto * slope[c] / size
                moved = max(moved, abs(there - z[k, c]))
                z[k, c] = there
        if moved <= STILL:
            break
    return moved


class Shells:
    """Solves problems of rotation order 1 with a round floor and no limits but a terminal one.

    Args:
        problem: what to solve, in natural units.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    takes_guess, trusts_guess = True, False  # anywhere is good enough to start from

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, SETTLED * tolerance
        self._condensed, steps = Condensed(problem), problem.horizon
        self._hessian, self._inverse, excess = regular(self._condensed.hessian)
        self._spare = 2.0 * excess / steps
        self._lengths = length_weights(problem)[1:].astype(float)
        self._floor, self._arrival = float(problem.floor.fraction), np.zeros(steps)
        self._scale = 0.0
        if problem.terminal == 'constraint':
            self._arrival = problem.maps.reach[-1, 1:].copy()
            self._scale = float(np.diag(self._hessian).max() / np.square(self._arrival).max())
        self._sectors = np.tile([-0.5 * TURN, 0.5 * TURN, self._floor, 1.0], (steps, 1))
        self._shapes = np.zeros((steps, OUTLINE))
        self._shapes[:, INNER], self._shapes[:, OUTER] = self._floor, 1.0
        self._general = General(problem, self._tolerance)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem."""
        constrained = problem.terminal == 'constraint'
        arrives = constrained or problem.arrival_weight > 0.0
        decided = constrained and not problem.maps.reach[-1, 1:].any()  # the state arrives, or not
        return (
            (problem.floor.shape, problem.rotation_order) == ('circle', 1)
            and not (problem.inertial and arrives)
            and not decided
            and (problem.dimension == 2 or problem.weights.input == problem.weights.attitude == 0.0)
            and not (problem.max_rate or problem.obstacles or problem.has_cones)
            and not problem.approach.exists
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the best bound proved.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        q, self._constant = self._condensed.affine(request.state, request.goals)
        self._q, self._left = q, self._left_over(request)
        self._found = Found(None, np.inf, -np.inf, 0)
        starts = [self._disk] if request.guess is None else [self._guessed, self._disk]
        for start in (*starts, self._climbed):
            self._improve(start(request))
            if self._found.gap <= self._tolerance or request.late:
                break
        found = self._found
        if found.x is not None and self._problem.dimension == 3:
            found = replace(found, x=coordinates(carried(request.state.attitude, found.x)))
        # To set the general search up takes longer than those with a deadline can wait.
        if found.gap <= self._tolerance or request.hurried:
            return found
        return self._by_branches(request, found)

    def _left_over(self, request: Request) -> Array:
        """Return b, what sum_k a_k z_k must come to, shape (n,) [m]; zero without an arrival."""
        state, goals, problem = request.state, request.goals, self._problem
        if not self._scale:
            return np.zeros(goals.shape[1])
        reached = adrift(problem, state)[-1] + problem.maps.reach[-1, 0] * state.rotation[:, 0]
        left = np.asarray(goals[-1] - reached)
        reach = float(self._arrival.sum())
        if np.linalg.norm(left) > reach + OUT_OF_REACH * (reach or 1.0):
            raise Infeasible('the goal is out of reach')
        return left

    def _quadratic(self, stiffness: float, pull: Array) -> tuple[Quadratic, float]:
        """Return the augmented Lagrangian of an arrival, and what it lacks of the cost.

        Args:
            stiffness: of the arrival, in curvatures of the cost.
            pull: multipliers, shape (n,).
        """
        a, stiff, left = self._arrival, stiffness * self._scale, self._left
        q = self._q + np.outer(a, pull - stiff * left)
        hessian = self._hessian + stiff * np.outer(a, a)
        lacking = self._constant + 0.5 * stiff * left @ left - pull @ left
        return Quadratic(hessian, hessian, q, self._lengths, 0.0, 0), float(lacking)

    def _guessed(self, request: Request) -> Array:
        assert request.guess is not None
        # A copy: code for arrays that are read-only or strided would be compiled in a tick.
        return np.array(request.guess.x[:, : self._q.shape[1]], order='C')

    def _disk(self, _: Request) -> Array:
        """Return the headings that cost least where they may have any length."""
        quad = self._quadratic(SOFT, np.zeros_like(self._left))[0]
        return -np.linalg.solve(quad.hessian, quad.q)

    def _improve(self, z: Array) -> None:
        """Take headings to where none costs less if it alone changes; keep them if they arrive."""
        a, pull, missed, stiffness = self._arrival, np.zeros_like(self._left), np.inf, SOFT
        for _ in range(ROUNDS):
            quad, lacking = self._quadratic(stiffness, pull)
            moved, before = sweep(quad, self._floor, z, SWEEPS), missed
            miss = a @ z - self._left
            missed = float(np.abs(miss).max())
            if moved <= STILL and missed <= STILL:
                break
            pull += stiffness * self._scale * miss
            if missed > SLOW * before:
                stiffness = min(STIFF, STIFFER * stiffness)
        if self._scale:
            z, pull = self._polished(z, pull)
            missed = float(np.abs(a @ z - self._left).max())
        if missed > NEAR:
            return
        cost = 0.5 * np.vdot(z, self._hessian @ z) + np.vdot(self._q, z)
        cost += float(self._lengths @ np.linalg.norm(z, axis=1)) + self._constant
        if cost < self._found.cost:
            self._found = replace(self._found, x=z, cost=float(cost))
        node = self._node()
        quad, lacking = self._quadratic(STIFF, pull)
        enough = self._found.cost - self._tolerance * max(NEGLIGIBLE, abs(self._found.cost))
        certify(quad, self._floor, self._shapes, z, node[2:], enough - lacking)
        self._raise(node, lacking, pull)

    def _polished(self, z: Array, pull: Array) -> tuple[Array, Array]:
        """Return the stationary point next to headings, by Newton's method on its equations.

        Args:
            z: headings, shape (N, n).
            pull: multipliers of the arrival, shape (n,).

        Returns:
            The point and its multipliers; where it is not on the shell, those given.
        """
        (count, n), a, eye = z.shape, self._arrival, np.eye(z.shape[1])
        size = np.linalg.norm(z, axis=1)
        on = np.flatnonzero((size > 1.0 - ON) | (size < self._floor + ON))
        level = np.where(size > 0.5 * (1.0 + self._floor), 1.0, self._floor)[on]
        x, nu, mu = z.copy(), pull.copy(), np.zeros(count)
        total = n * count + len(on) + n
        for step in range(NEWTON):
            size = np.linalg.norm(x, axis=1)
            bent = self._lengths / size
            force = self._hessian @ x + self._q + np.outer(a, nu) + bent[:, None] * x
            if step == 0:
                mu[on] = -np.sum(force[on] * x[on], axis=1) / size[on] ** 2
            force += mu[:, None] * x
            system, right = np.zeros((total, total)), np.zeros(total)
            inner = np.kron(self._hessian + np.diag(mu + bent), eye)
            for k in range(count):
                own = slice(n * k, n * k + n)
                inner[own, own] -= bent[k] / size[k] ** 2 * np.outer(x[k], x[k])
            system[: n * count, : n * count] = inner
            for i, j in enumerate(on):
                system[n * j : n * j + n, n * count + i] = x[j]
            system[: n * count, total - n :] = np.kron(a[:, None], eye)
            system[n * count :] = system[:, n * count :].T
            right[: n * count] = force.ravel()
            right[n * count : total - n] = 0.5 * (size[on] ** 2 - level**2)
            right[total - n :] = a @ x - self._left
            moved = np.linalg.lstsq(system, right, rcond=None)[0]
            x -= moved[: n * count].reshape(count, n)
            mu[on] -= moved[n * count : total - n]
            nu -= moved[total - n :]
        size = np.linalg.norm(x, axis=1)
        within = (size > self._floor - STILL).all() and (size < 1.0 + STILL).all()
        return (x, nu) if within else (z, pull)

    def _node(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return a node as :func:`climb` takes it."""
        steps, n = self._q.shape
        known = np.array([-np.inf, 0.0, -np.inf, 0.0])
        multipliers = np.zeros((KINDS, steps)), np.zeros((steps, n)), np.zeros(steps)
        return np.zeros((steps, n)), *multipliers, known

    def _climbed(self, request: Request) -> Array:
        """Raise the bound by the best multipliers; return where their Lagrangian is least."""
        pull, node = np.zeros_like(self._left), self._node()
        enough = self._found.cost - self._tolerance * max(NEGLIGIBLE, abs(self._found.cost))
        status = GOING
        while status == GOING and not request.late:
            quad, lacking = self._quadratic(STIFF, pull)
            node[4][KEY] = -np.inf  # of other multipliers of the arrival
            known = quad, self._floor, self._sectors, self._shapes, node, 0.0, enough - lacking
            status, _ = climb(*known, 0.0)
            self._raise(node, lacking, pull)
            pull += STIFF * self._scale * (self._arrival @ node[0] - self._left)
        return node[0]

    def _raise(self, node: tuple[Array, ...], lacking: float, pull: Array) -> None:
        """Raise the bound to a node's, with its proof, if that is more."""
        _, _, point, kept, known = node
        if known[KEY] + lacking <= self._found.lower_bound:
            return
        a, more = self._arrival, {}
        if self._scale:
            missed = a @ point - self._left
            point = point - np.outer(a, missed) / (a @ a)
            more = {'pull': (pull + STIFF * self._scale * missed)[None]}
        proof = one(point, kept - self._spare, **more)
        bound = float(known[KEY] + lacking)
        self._found = replace(self._found, lower_bound=bound, proof=proof)

    def _by_branches(self, request: Request, found: Found) -> Found:
        """Return the better of what was found and where the general search leads."""
        guess = None if found.x is None else Guess(found.x, found.cost)
        asked = iter(range(BRANCHES))
        other = self._general.solve(
            request._replace(guess=guess, out_of_time=lambda: next(asked, None) is None)
        )
        best = other if other.cost < found.cost else found
        bound = other if other.lower_bound > found.lower_bound else found
        known = replace(best, lower_bound=bound.lower_bound, proof=bound.proof)
        return replace(known, nodes=found.nodes + other.nodes)
