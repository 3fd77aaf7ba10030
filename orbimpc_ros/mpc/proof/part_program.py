# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The tangent of a part of all trajectories: beside bodies, within cones, from a convex program.

A solver says which multipliers are worth most, to some digits. They are rounded to what is exact
there, zero or on the rim of their cone, and the tangent then touches where it is best for them: so
its bound lacks the square of what they are off by.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import lmi_parts
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.certificate import Leaf
from orbimpc_ros.mpc.proof.complementary import Pair, factor, stepped
from orbimpc_ros.mpc.proof.complementary import held as holding
from orbimpc_ros.mpc.proof.spatial import quadratic, top, touching_freely
from orbimpc_ros.mpc.proof.stationary import arrival_of
from orbimpc_ros.mpc.proof.verifier.regions import Region
from orbimpc_ros.mpc.proof.verifier.stated import StatedProblem

ACCURACY = 1e-10  # of solutions
BEYOND_RIM = 1.0 + 1e-15  # so that what is on the rim of its cone is not outside by rounding
ROWS, COLUMNS = np.tril_indices(4)  # an upper triangle column by column, but for the order

Rows = tuple[Array, Array]  # A and b of A v + s = b, s in a cone


class Held(NamedTuple):
    """Multipliers of what a part is subject to, in natural units.

    Attributes:
        pull: of the arrival, shape (m n,).
        shares: of the speeds and cones of each R_k e1: what they hold of its slope, shape (N, n).
        presses: of what is known of positions, shape (rows,).
        slides: of the cone above the goal, shape (N, n).
        tethers: of how far R e1 moves in a step, shape (N, n).
        factors: over SO(3), F_k of the multipliers F_k F_k' of S(R_k) >= 0, shapes (4, r_k).
    """

    pull: Array
    shares: Array
    presses: Array
    slides: Array
    tethers: Array
    factors: tuple[Array, ...] = ()


class Answer(NamedTuple):
    """What the program of a part comes to.

    Attributes:
        x: rotation coordinates, shape (N, d).
        held: what holds them there; where nothing is feasible, what says so.
        feasible: whether anything is, as far as the solver can tell.
    """

    x: Array
    held: Held
    feasible: bool


class PartProgram:
    """A quadratic of R_1..R_N, and of bounds t_k of |R_k e1|, over what is convex.

    Args:
        problem: in natural units, of rotation order 1.
        state: where plans start.
        goals: shape (N, n).
        posed: the same as the verifier reads it, in the user's units.
        unit: of lengths [m].
    """

    def __init__(
        self, problem: Problem, state: State, goals: Array, posed: StatedProblem, unit: float
    ) -> None:
        count, n = problem.horizon, problem.dimension
        self._above, self._tied, self._unit = posed.limits.slope, posed.limits.tether, unit
        self._hessians, self._q = quadratic(problem, state, goals, posed.width)
        self._length, self._reach = length_weights(problem)[1:], problem.maps.reach[:, 1:]
        still = np.zeros((count + 1, n))
        still[0] = state.rotation[:, 0]
        self._free = dynamics.translation_rollout(problem, state, still)[0][1:]
        self._goals, self._arrival = goals, arrival_of(problem, state, goals)
        self._columns = np.arange(count * posed.width).reshape(count, -1)
        owned = [(k, cone) for k, own in enumerate(posed.limits.cones) for cone in own]
        self._owners = np.array([k for k, _ in owned], int)
        self._axes = np.array([cone.axis for _, cone in owned], float).reshape(-1, n)
        self._widths = np.array([cone.least / cone.axis.unit for _, cone in owned], float)
        slowest = np.maximum(float(posed.floor.slowest), np.array(posed.limits.least, float))
        self._slowest = np.where(self._length > 0.0, float(posed.floor.slowest), slowest)
        # Over SO(3), where nothing else is asked of R_k e1, the orbitope holds it.
        self._directed = posed.width != 9 or bool(owned or self._length.any() or slowest.any())
        self._fixed = self._arriving(), self._pointing(), self._round(), self._turning()

    @cached_property
    def curvatures(self) -> Array:
        """Return by how much positions give way to what presses them, shape (N,)."""
        return np.einsum('ki,ij,kj->k', self._reach, np.linalg.pinv(self._hessians[0]), self._reach)

    def axes(self, x: Array) -> Array:
        """Return R_1 e1..R_N e1, shape (N, n), of rotation coordinates."""
        return x[:, : self._free.shape[1]]

    # --- the program

    @cached_property
    def _bent(self) -> Array:
        """Return the Hessian of all variables: coordinates step by step, then t_1..t_N."""
        bent = self._blank(self._columns.size + len(self._columns))
        for columns, h in zip(self._columns.T, self._hessians, strict=True):
            bent[np.ix_(columns, columns)] = h
        return bent

    def _blank(self, rows: int) -> Array:
        return np.zeros((rows, self._columns.size + len(self._columns)))

    def _arriving(self) -> Rows:
        shares, left = self._arrival
        a, n = self._blank(left.size), self._free.shape[1]
        for i in range(n):
            a[i::n, self._columns[:, i]] = shares
        return a, left.ravel()

    def _pointing(self) -> Rows:
        """Return t_k <= 1, t_k >= the least speed, and what cones ask for, in this order."""
        count, first = len(self._columns), self._columns.size
        speeds, cones = self._blank(2 * count), self._blank(len(self._owners))
        speeds[:, first:] = np.vstack([np.eye(count), -np.eye(count)])
        for row, k, axis, width in zip(cones, self._owners, self._axes, self._widths, strict=True):
            row[self._columns[k, : len(axis)]], row[first + k] = -axis, width
        b = np.concatenate([np.ones(count), -self._slowest, np.zeros(len(cones))])
        return np.vstack([speeds, cones]), b

    def _round(self) -> Rows:
        """Return (t_k, R_k e1), (cos d_3 + eased, sin d_1, sin d_2) above goals, and ties."""
        (count, n), first = self._free.shape, self._columns.size
        disks, above = self._blank(count * (n + 1)), self._blank(0)
        for k in range(count):
            disks[k * (n + 1), first + k] = -1.0
            if self._directed:
                disks[k * (n + 1) + 1 + np.arange(n), self._columns[k, :n]] = -1.0
        b = np.zeros((count, 3))
        if self._above:
            above, scales = self._blank(3 * count), self._slope
            for j, i in enumerate((2, 0, 1)):
                above[j::3, self._columns[:, i]] = -scales[i] * self._reach
                b[:, j] = scales[i] * (self._free - self._goals)[:, i]
            b[:, 0] += np.array(self._above.eased, float) / self._unit
        ties, lengths = self._tying()
        b = np.concatenate([np.zeros(len(disks)), b.ravel()[: len(above)], lengths])
        return np.vstack([disks, above, ties]), b

    def _tying(self) -> Rows:
        """Return (c, R_{k+1} e1 - R_k e1), where turns are limited."""
        if self._tied is None:
            return self._blank(0), np.zeros(0)
        count, n = self._free.shape
        a, b = self._blank(count * (n + 1)), np.zeros((count, n + 1))
        b[:, 0], b[0, 1:] = float(self._tied.length), -np.array(self._tied.begin, float)
        for k in range(count):
            rows = k * (n + 1) + 1 + np.arange(n)
            a[rows, self._columns[k, :n]] = -1.0
            if k:
                a[rows, self._columns[k - 1, :n]] = 1.0
        return a, b.ravel()

    @property
    def _slope(self) -> Array:
        """Return what the cone above the goal scales x, y and z by."""
        assert self._above is not None
        cosine, sine = float(self._above.cosine), float(self._above.sine)
        return np.array([sine, sine, cosine])

    def _turning(self) -> Rows:
        count, width = self._columns.shape
        if width != 9:
            return self._blank(0), np.zeros(0)
        constant, linear = lmi_parts()
        scale = np.where(ROWS == COLUMNS, 1.0, np.sqrt(2.0))
        entries, a = 4 * COLUMNS + ROWS, self._blank(10 * count)
        for k in range(count):
            a[10 * k : 10 * k + 10, self._columns[k]] = -scale[:, None] * linear[entries]
        return a, np.tile(scale * constant[entries], count)

    def _beside(self, region: Region) -> Rows:
        a, b = self._blank(len(region.rows)), np.empty(len(region.rows))
        for line, (i, (place, normal, least)) in zip(a, enumerate(region.rows), strict=True):
            towards, reach = np.array(normal, float), np.array(place.reach, float) / self._unit
            line[self._columns[:, : len(towards)]] = -np.outer(reach, towards)
            b[i] = (towards @ np.array(place.free, float) - float(least)) / self._unit
        return a, b

    def answer(self, region: Region) -> Answer:
        """Return what the program comes to in a region."""
        from scipy import sparse

        from orbimpc_ros.mpc.solve.conic import run, solver_for  # takes Clarabel

        arriving, pointing, cones, turning = self._fixed
        groups = arriving, pointing, self._beside(region), cones, turning
        sizes = [len(b) for _, b in groups]
        count, n = self._free.shape
        round_ones = [n + 1] * count + ([3] * count if self._above else [])
        round_ones += [n + 1] * count if self._tied else []
        dims = {'zero': sizes[0], 'nonneg': sizes[1] + sizes[2], 'soc': round_ones}
        data = {
            'P': sparse.csc_matrix(self._bent),
            'c': np.concatenate([self._q.ravel(), self._length]),
            'A': sparse.csc_matrix(np.vstack([a for a, _ in groups])),
            'b': np.concatenate([b for _, b in groups]),
            'dims': SimpleNamespace(**dims, psd=[4] * (sizes[4] // 10)),
        }
        found: Any = run(solver_for(data, ACCURACY), None)
        feasible = 'Infeasible' not in str(found.status)
        ends = list(itertools.accumulate(sizes))[:-1]
        z, s = np.asarray(found.z), np.asarray(found.s)
        if not feasible:  # a ray, of any length
            z, s = z / np.abs(z).max(), np.zeros_like(s)
        duals, slacks = np.split(z, ends), np.split(s, ends)
        x = np.asarray(found.x)[: self._columns.size].reshape(self._columns.shape)
        return Answer(x, self._held(duals, slacks), feasible)

    # --- its multipliers

    def _held(self, duals: list[Array], slacks: list[Array]) -> Held:
        """Return multipliers without those of what holds with room to spare."""
        count, n = self._free.shape
        disks, ties = count * (n + 1), (count * (n + 1) if self._tied else 0)
        presses = np.where(duals[2] > slacks[2], duals[2], 0.0)
        shares = self._shares(
            (duals[1], slacks[1]),
            tuple(each[3][:disks].reshape(count, n + 1) for each in (duals, slacks)),
        )
        slides: Array = np.zeros((count, n))
        if self._above:
            above = (each[3][disks : len(each[3]) - ties] for each in (duals, slacks))
            slides = self._slides(*(each.reshape(count, 3) for each in above))
        tethers: Array = np.zeros((count, n))
        if self._tied:
            tied = (each[3][len(each[3]) - ties :] for each in (duals, slacks))
            tethers = _tethers(*(each.reshape(count, n + 1) for each in tied))
        pairs = zip(*(_matrices(each[4]) for each in (duals, slacks)), strict=True)
        factors = tuple(itertools.starmap(factor, pairs))
        return Held(duals[0], shares, presses, slides, tethers, factors)

    def _shares(self, flat: tuple[Array, Array], disks: tuple[Array, ...]) -> Array:
        """Return what speeds and cones hold of the slope of each R_k e1, shape (N, n)."""
        count = len(self._columns)
        active = flat[0] > flat[1]
        axial, room = disks[0][:, 1:], disks[1][:, 0] - np.linalg.norm(disks[1][:, 1:], axis=1)
        shares = np.where((np.linalg.norm(axial, axis=1) > room)[:, None], axial, 0.0)
        leaning = np.where(active, flat[0], 0.0)[2 * count :]
        np.add.at(shares, self._owners, leaning[:, None] * self._axes)
        for k in np.flatnonzero(~(active[:count] | active[count : 2 * count])):
            down = self._downhill(int(k), shares[k])  # there the length outweighs it, to the digit
            shares[k] -= (shares[k] @ down + self._length[k]) * down
        return shares

    def _downhill(self, k: int, slope: Array) -> Array:
        """Return the steepest way down in the cones of a step, a unit vector; or nowhere."""
        size = float(np.linalg.norm(slope))
        found = [-slope / size if size else slope]
        for j in np.flatnonzero(self._owners == k):
            axis = self._axes[j] / np.linalg.norm(self._axes[j])
            least, along = self._widths[j] / np.linalg.norm(self._axes[j]), float(slope @ axis)
            aside = along * axis - slope
            across = float(np.linalg.norm(aside))
            if -along < least * size and across:
                found.append(least * axis + np.sqrt(max(0.0, 1.0 - least**2)) * aside / across)
        return max(found, key=lambda way: float(slope @ way))

    def _slides(self, duals: Array, slacks: Array) -> Array:
        """Return what slides along the cone above the goal, shape (N, 3)."""
        _, sine, cosine = self._slope
        aside = -sine * duals[:, 1:]
        size = np.linalg.norm(aside, axis=1)
        rim = cosine / sine * size * BEYOND_RIM
        down = np.maximum(cosine * duals[:, 0], rim)
        down = np.where(slacks[:, 0] > down - rim, rim, down)  # not at its tip
        spare = slacks[:, 0] - np.linalg.norm(slacks[:, 1:], axis=1) > duals[:, 0]
        found = np.column_stack([aside, -down])
        return np.where(spare[:, None], 0.0, found)

    def leaf(self, region: Region, answer: Answer) -> Leaf:
        """Return the best tangent for the multipliers of an answer, rounded to what is exact."""
        held = answer.held
        turned = holding(held.factors) if held.factors else np.zeros_like(self._q)
        loaded = self._q + self._pushed(region, held) - turned - self._wide(held.shares)
        point, pull = touching_freely(self._hessians, loaded, self._arrival)
        return self._made(point, held._replace(pull=pull), turned)

    def polished(self, region: Region, answer: Answer) -> Answer:
        """Return an answer over SO(3) with more digits: a step of Newton's method on."""
        held, count = answer.held, answer.x.size
        pressed = held.presses > 0.0
        a, b = (
            np.concatenate([fixed, each[pressed]])
            for fixed, each in zip(self._fixed[0], self._beside(region), strict=True)
        )
        sliding = self._pushed(region, held._replace(presses=0.0 * held.presses))
        loaded = self._q + sliding - self._wide(held.shares)
        pair = Pair(answer.x, held.factors, np.append(held.pull, held.presses[pressed]))
        bent = self._bent[:count, :count]
        x, factors, multipliers = stepped(bent, loaded, (a[:, :count], b), pair)
        presses = held.presses.copy()
        presses[pressed] = np.maximum(multipliers[held.pull.size :], 0.0)
        pull = multipliers[: held.pull.size]
        held = held._replace(pull=pull, presses=presses, factors=factors)
        return Answer(x, held, answer.feasible)

    def refutation(self, region: Region, held: Held, size: float) -> Leaf:
        """Return a tangent that multipliers lift the more the larger they are."""
        pull, shares, presses, slides, tethers = (size * np.asarray(each) for each in held[:5])
        held = Held(pull, shares, presses, slides, tethers)
        slopes = self._q + self._pulled(held.pull) + self._pushed(region, held)
        return self._made(np.zeros_like(self._q), held, slopes - self._wide(held.shares))

    def _made(self, point: Array, held: Held, turned: Array) -> Leaf:
        made = Leaf(
            point,
            pull=held.pull,
            presses=held.presses,
            slides=held.slides if self._above else None,
            tethers=held.tethers if self._tied else None,
        )
        if point.shape[1] != 9:
            return made
        return replace(made, tops=np.array([top(y) for y in turned]), shares=held.shares)

    def _pushed(self, region: Region, held: Held) -> Array:
        """Return what presses, slides and tethers add to slopes, shape (N, d)."""
        towed = held.tethers.copy()
        towed[:-1] -= held.tethers[1:]
        for y, (place, normal, _) in zip(held.presses, region.rows, strict=True):
            reach = np.array(place.reach, float) / self._unit
            towed -= y * np.outer(reach, np.array(normal, float))
        return self._wide(self._reach.T @ held.slides + towed)

    def _pulled(self, pull: Array) -> Array:
        shares, left = self._arrival
        return self._wide(shares.T @ pull.reshape(left.shape))

    def _wide(self, axial: Array) -> Array:
        """Return slopes of R_k e1, shape (N, n), as slopes of all coordinates."""
        found = np.zeros(self._columns.shape)
        found[:, : axial.shape[1]] = axial
        return found


def _tethers(duals: Array, slacks: Array) -> Array:
    """Return multipliers of R_{k+1} e1 - R_k e1, shape (N, n), zero where it has room to spare."""
    spare = slacks[:, 0] - np.linalg.norm(slacks[:, 1:], axis=1) > duals[:, 0]
    return np.where(spare[:, None], 0.0, -duals[:, 1:])


def _matrices(triangles: Array) -> Array:
    """Return symmetric matrices, shape (K, 4, 4), of their triangles, one after another."""
    found = np.zeros((len(triangles) // 10, 4, 4))
    halves = triangles.reshape(-1, 10) / np.where(ROWS == COLUMNS, 1.0, np.sqrt(2.0))
    found[:, ROWS, COLUMNS] = found[:, COLUMNS, ROWS] = halves
    return found
