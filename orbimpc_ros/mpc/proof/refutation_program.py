# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""By how much every trajectory of a part misses what is asked of it, from a convex program.

What is asked of positions, to arrive, to be beside bodies, above the goal, or near it, may be
missed by as much as v, counted in steps; what is known of each R_k e1 holds. Where the least v is
above zero nothing is feasible, and the multipliers of what was asked, in any units, say so.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.dynamics import drift
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.certificate import Leaf
from orbimpc_ros.mpc.proof.verifier.limits import GlideSlope, Tether
from orbimpc_ros.mpc.proof.verifier.regions import Region, Sector
from orbimpc_ros.mpc.proof.verifier.stated import StatedProblem

ACCURACY = 1e-9  # of solutions, in steps
MISSED = 1e-8  # steps: what is missed by less may be met
NEGLIGIBLE = 1e-9  # of the largest multiplier
NARROW = 0.99 * math.pi  # [rad] up to which a sector is a cone
OUTWARD = 1.0 + 1e-12  # so that what is on the rim of its cone is not outside by rounding
Rows = tuple[Array, Array]  # A and b of A v + s = b, s in a cone


class Motion(NamedTuple):
    """How R_1 e1..R_N e1 move a vehicle, in lengths as they are.

    Attributes:
        free: s_1..s_N of a vehicle that they do not move, shape (N, n) [m].
        reach: what each adds to each, shape (N, N) [m].
        goals: g_1..g_N, shape (N, n) [m].
        arrival: what each adds to s_N and p_N, and what these then come to: see
            :func:`arrival_of`.
        unit: of lengths [m].
        step: of times [s].
    """

    free: Array
    reach: Array
    goals: Array
    arrival: Rows
    unit: float
    step: float

    @classmethod
    def of(cls, problem: Problem, state: State, goals: Array) -> Motion:
        """Return how a problem has it."""
        still = np.zeros((problem.horizon + 1, problem.dimension))
        still[0] = state.rotation[:, 0]
        free = dynamics.translation_rollout(problem, state, still)[0][1:]
        arrival, reach = arrival_of(problem, state, goals), problem.maps.reach[:, 1:]
        return cls(free, reach, goals, arrival, problem.length_unit, problem.step)

    def begun(self, k: int) -> Motion:
        """Return the motion of the first k steps, which do not have to arrive anywhere."""
        nowhere = np.zeros((0, k)), np.zeros((0, self.free.shape[1]))
        return self._replace(
            free=self.free[:k], reach=self.reach[:k, :k], goals=self.goals[:k], arrival=nowhere
        )


class Missed(NamedTuple):
    """What the program of a part comes to.

    Attributes:
        x: R_1 e1..R_N e1, shape (N, n).
        leaf: the multipliers of what is missed.
        feasible: whether a trajectory of the program misses nothing.
    """

    x: Array
    leaf: Leaf
    feasible: bool


class RefutationProgram:
    """The least that is missed by R_1 e1..R_N e1, and bounds t_k of |R_k e1|.

    Args:
        motion: of the vehicle.
        posed: the problem, as the verifier reads it.
    """

    def __init__(self, motion: Motion, posed: StatedProblem) -> None:
        self._motion, self._posed = motion, posed
        (count, n), self._arrivals = motion.free.shape, len(motion.arrival[0])
        self._z = np.arange(count * n).reshape(count, n)
        self._t, self._v = count * n + np.arange(count), count * (n + 1)
        self._owned = [(k, cone) for k, own in enumerate(posed.limits.cones) for cone in own]
        self._fixed = self._decided(), self._paced(), self._round()
        self._tied = count if posed.limits.tether else 0
        self._soc = [n + 1] * (count + self._tied + self._arrivals)
        self._soc += [n + 1] * (posed.radius is not None)
        self._soc += [3] * (count if posed.limits.slope else 0)

    @property
    def nothing(self) -> Leaf:
        """Return the leaf of a part that nothing is left of."""
        return Leaf(np.zeros((len(self._z), self._posed.width)))

    @property
    def beyond(self) -> Leaf | None:
        """Return what refutes a catch of a goal that no headings lead to; None if some may."""
        motion, radius = self._motion, self._posed.radius
        off = motion.free[-1] - motion.goals[-1]
        away = float(np.linalg.norm(off))
        if radius is None or away <= float(radius) + float(np.abs(motion.reach[-1]).sum()):
            return None
        return replace(self.nothing, meets=off / away)

    @property
    def curvatures(self) -> Array:
        """Return by how much positions give way to what presses them, shape (N,)."""
        return np.asarray(np.sum(self._motion.reach**2, axis=1))

    @property
    def reach(self) -> Array:
        """Return what each R_k e1 adds to s_N, as far as that counts, shape (N,) [m]."""
        return self._motion.reach[-1]

    def _blank(self, rows: int) -> Array:
        return np.zeros((rows, self._v + 1))

    def _decided(self) -> Rows:
        """Return that a body rate decides R_1 e1, or that it is a share t_1 of what is coasted."""
        posed = self._posed
        if posed.order == 1:
            return self._blank(0), np.zeros(0)
        a = self._blank(posed.n)
        a[:, self._z[0]] = np.eye(posed.n)
        if posed.state.coasted is None:
            return a, np.array(posed.state.second, float)
        a[:, self._t[0]] = -np.array(posed.state.coasted, float)
        return a, np.zeros(posed.n)

    def _paced(self) -> Rows:
        """Return bounds of speeds, the cones that axes are in, and that v is no less than -1."""
        posed, count = self._posed, len(self._t)
        speeds, cones = self._blank(2 * count), self._blank(len(self._owned))
        least = self._blank(1)
        speeds[:, self._t] = np.vstack([np.eye(count), -np.eye(count)])
        for row, (k, cone) in zip(cones, self._owned, strict=True):
            row[self._z[k]] = -np.array(cone.axis, float)
            row[self._t[k]] = cone.least / cone.axis.unit
        least[0, self._v] = -1.0
        slowest, fastest = np.array(posed.limits.speeds, float).T
        slowest = np.maximum(slowest, np.array(posed.limits.least, float))
        if posed.order == 2:
            slowest[0] = 0.0
            fastest[0] = 1.0
        b = np.concatenate([fastest, -slowest, np.zeros(len(cones)), np.ones(1)])
        return np.vstack([speeds, cones, least]), b

    def _round(self) -> Rows:
        """Return (t_k, R_k e1); (v, s_N - g_N), (v, p_N), (v + radius, s_N - g_N), and slopes."""
        posed, motion, (count, n) = self._posed, self._motion, self._z.shape
        disks = self._blank(count * (n + 1))
        for k in range(1 if posed.order == 2 else 0, count):  # what is decided has its length
            disks[k * (n + 1), self._t[k]] = -1.0
            disks[k * (n + 1) + 1 + np.arange(n), self._z[k]] = -1.0
        groups: list[Rows] = [(disks, np.zeros(len(disks)))]
        if tether := posed.limits.tether:
            groups += [self._tethered(k, tether) for k in range(count)]
        scales = 1.0 / motion.unit, motion.step / motion.unit
        for shares, left, scale in zip(*motion.arrival, scales, strict=False):
            groups.append(self._within(scale * shares, -scale * left, 0.0))
        off = (motion.free - motion.goals) / motion.unit
        if posed.radius is not None:
            reach = motion.reach[-1] / motion.unit
            groups.append(self._within(reach, off[-1], float(posed.radius) / motion.unit))
        if slope := posed.limits.slope:
            groups += [self._above(k, off[k], slope) for k in range(count)]
        return np.vstack([a for a, _ in groups]), np.concatenate([b for _, b in groups])

    def _tethered(self, k: int, tether: Tether) -> Rows:
        """Return (c, R_{k+1} e1 - R_k e1) of a step."""
        n = self._posed.n
        a = self._blank(n + 1)
        a[1:, self._z[k]] = -np.eye(n)
        if k:
            a[1:, self._z[k - 1]] = np.eye(n)
        return a, np.append(float(tether.length), [0.0 if k else -float(x) for x in tether.begin])

    def _within(self, shares: Array, off: Array, radius: float) -> Rows:
        """Return that off, and what headings add to it, is no longer than a radius and v."""
        n = len(off)
        a = self._blank(n + 1)
        a[0, self._v] = -1.0
        for i in range(n):
            a[1 + i, self._z[:, i]] = -shares
        return a, np.append(radius, off)

    def _above(self, k: int, off: Array, slope: GlideSlope) -> Rows:
        """Return (cos d_3 + eased + v, sin d_1, sin d_2) of the cone above the goal."""
        a, b = self._blank(3), np.empty(3)
        cosine, sine = float(slope.cosine), float(slope.sine)
        for row, (i, scale) in enumerate(((2, cosine), (0, sine), (1, sine))):
            a[row, self._z[:, i]] = -scale * self._motion.reach[k] / self._motion.unit
            b[row] = scale * off[i]
        a[0, self._v] = -1.0
        b[0] += float(slope.eased[k]) / self._motion.unit
        return a, b

    def _beside(self, region: Region) -> Rows:
        """Return that rows of positions are missed by no more than v."""
        motion, a, b = self._motion, self._blank(len(region.rows)), np.empty(len(region.rows))
        for i, (place, normal, least) in enumerate(region.rows):
            towards, reach = np.array(normal, float), np.array(place.reach, float)[: len(self._z)]
            a[i, self._z] = -np.outer(reach, towards) / motion.unit
            a[i, self._v] = -1.0
            b[i] = (towards @ np.array(place.free, float) - float(least)) / motion.unit
        return a, b

    def _headed(self, region: Region) -> Rows:
        """Return that directions are within their sectors, as far as these are cones."""
        narrow = _narrow(region)
        a = self._blank(len(narrow))
        for row, (k, sector) in zip(a, narrow, strict=True):
            middle, half = middle_of(sector), 0.5 * float(sector.high - sector.low)
            row[self._z[k]] = -np.cos(middle), -np.sin(middle)
            row[self._t[k]] = math.cos(half)
        return a, np.zeros(len(narrow))

    def answer(self, region: Region) -> Missed | None:
        """Return what is missed in a region at least; None where Clarabel panics."""
        from scipy import sparse

        from orbimpc_ros.mpc.solve.conic import run, solver_for  # takes Clarabel

        decided, paced, rounds = self._fixed
        groups = decided, self._beside(region), self._headed(region), paced, rounds
        sizes = [len(b) for _, b in groups]
        dims = SimpleNamespace(zero=sizes[0], nonneg=sum(sizes[1:4]), soc=self._soc, psd=[])
        cost = np.zeros(self._v + 1)
        cost[self._v] = 1.0
        data: dict[str, Any] = {
            'P': sparse.csc_matrix((len(cost), len(cost))),
            'c': cost,
            'A': sparse.csc_matrix(np.vstack([a for a, _ in groups])),
            'b': np.concatenate([b for _, b in groups]),
            'dims': dims,
        }
        found: Any = run(solver_for(data, ACCURACY), None)
        if found is None:
            return None
        x, z = np.nan_to_num(found.x), np.nan_to_num(found.z)
        nowhere = 'PrimalInfeasible' in str(found.status)  # multipliers are a ray, of any length
        each = self._posed.n + 1
        ends = np.cumsum([*sizes[:4], each * len(self._z), each * self._tied])
        parts = np.split(z / (np.abs(z).max() if nowhere else 1.0), ends)
        _, presses, _, leaning, disks, tied, rest = parts
        # What is missed is counted in steps: multipliers of what is none have their length.
        unit = self._motion.unit
        tethers = -unit * tied.reshape(-1, each)[:, 1:] if self._tied else None
        leaf = replace(
            self._leaf(presses, rest),
            shares=self._shares(region, unit * leaning, disks.reshape(-1, each)),
            tethers=tethers,
        )
        return Missed(x[self._z], leaf, not (nowhere or float(x[self._v]) > MISSED))

    def _shares(self, region: Region, leaning: Array, disks: Array) -> Array | None:
        """Return what the last cone of each step holds, beside others and its sector.

        Both ask for u . axis >= least |z|. So that neither counts on a speed that the other does
        not, a cone takes as much of the multiplier of |z| <= t as has its own t cancelled.
        """
        shares, seen = np.zeros(self._z.shape), {k for k, _ in _narrow(region)}
        for (k, cone), held in zip(self._owned, leaning[2 * len(self._t) :], strict=False):
            if k in seen:
                pull = disks[k, 1:] / disks[k, 0] if disks[k, 0] > 0.0 else np.zeros(self._posed.n)
                least = cone.least / cone.axis.unit
                shares[k] = held * (np.array(cone.axis, float) + least * pull)
            seen.add(k)
        return shares if shares.any() else None

    def _leaf(self, presses: Array, rest: Array) -> Leaf:
        """Return multipliers as certificates have them, of those of the program."""
        count, n = self._z.shape
        held, rest = np.split(rest, [self._arrivals * (n + 1)])
        scales = np.array([1.0, self._motion.step])[: self._arrivals, None]
        pull = -scales * held.reshape(-1, n + 1)[:, 1:]
        meets = slides = None
        if self._posed.radius is not None:
            meets, rest = -rest[1 : n + 1], rest[n + 1 :]
        if slope := self._posed.limits.slope:
            slides = _slides(rest.reshape(count, 3), slope)
        presses = np.where(presses > NEGLIGIBLE * presses.max(initial=0.0), presses, 0.0)
        return Leaf(
            np.zeros((count, self._posed.width)), None, pull.ravel(),
            presses=presses, slides=slides, meets=meets,
        )  # fmt: skip


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


def _narrow(region: Region) -> list[tuple[int, Sector]]:
    """Return the sectors that are cones, each with its step."""
    return [
        (k, sector)
        for k, sector in enumerate(region.sectors)
        if sector is not None and sector.high - sector.low < NARROW
    ]


def _slides(duals: Array, slope: GlideSlope) -> Array:
    """Return what slides along the cone above the goal, shape (N, 3)."""
    down = np.maximum(duals[:, 0], OUTWARD * np.hypot(duals[:, 1], duals[:, 2]))
    found = np.column_stack([-float(slope.sine) * duals[:, 1:], -float(slope.cosine) * down])
    return np.where(down[:, None] > NEGLIGIBLE * down.max(initial=0.0), found, 0.0)


def middle_of(sector: Sector) -> float:
    """Return the direction in the middle of a sector [rad]."""
    return 0.5 * float(sector.low + sector.high)
