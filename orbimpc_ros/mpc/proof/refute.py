# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From the claim that nothing is feasible, or catches a goal, to its certificate.

Nothing of a method is used: all trajectories are split, depth first, by the sides of bodies and by
directions, until what is asked of each part is missed. Nothing of this has to be believed: see
:mod:`orbimpc_ros.mpc.proof.verify`.

By how much each trajectory of a part misses it is known from a convex program. What is asked of
positions, to arrive, to be beside bodies, above the goal, or near it, may be missed by as much as
v, counted in steps; the hulls of stage sets hold. Where the least v is above zero nothing is
feasible, and the multipliers of what was asked say so.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.bound import leaf_bound, work_of
from orbimpc_ros.mpc.proof.document import (
    OutOfTime,
    Posed,
    Refutation,
    Unproved,
    patient,
    refuted_by,
)
from orbimpc_ros.mpc.proof.flight import DECIDED, controls_of, flown_by
from orbimpc_ros.mpc.proof.rows import Places, about, side_of
from orbimpc_ros.mpc.proof.sets import nearest_floor
from orbimpc_ros.mpc.proof.splits import GONE, HELD, ICOSAHEDRON, Cut, Region, begin, part_of
from orbimpc_ros.mpc.proof.stated import FREE, SEGMENT, Stated, Statement
from orbimpc_ros.mpc.proof.tree import (
    ARCS,
    ARRAYS,
    CUT,
    EMPTY,
    FACES,
    OPTIONAL,
    PATCHES,
    POINTS,
    QUARTERS,
    SIDES,
    ProofTree,
    one,
)
from orbimpc_ros.mpc.proof.verify import region_of

NARROWEST = 1e-6  # [rad] of a sector that is split
SATISFIED = 1e-9  # of a step's length: a body that is entered by less is not split
LEAST = 1e-9  # of a curvature
MARGIN = 0.15  # of a sector, to either end
AROUND = 4  # arcs of all directions
DEEPEST = 200  # nodes above a leaf
ACCURACY = 1e-9  # of solutions, in steps
MISSED = 1e-8  # steps: what is missed by less may be met
NEGLIGIBLE = 1e-9  # of the largest multiplier
OUTWARD = 1.0 + 1e-12  # so that what is on the rim of its cone is not outside by rounding
Rows = tuple[Array, Array]  # A and b of A x + s = b, s in a cone
Side = tuple[int, int]  # at which depth a side of a body is known, of which choice


def refutation_of(sought: Sought, out_of_time: OutOfTime = patient) -> Refutation:
    """Return what proves that nothing is feasible.

    Args:
        sought: in what.
        out_of_time: polled before each part of all trajectories; True gives up.

    Raises:
        Unproved: none was found.
    """
    return _refuting(sought, 1, out_of_time)


def catches_refuted(sought: Sought, count: int, out_of_time: OutOfTime = patient) -> Refutation:
    """Return what proves that the goal is not caught at the ends of the first steps.

    Args:
        sought: in what, with the radius of a catch.
        count: of steps.
        out_of_time: as for :func:`refutation_of`.

    Raises:
        Unproved: for one of them none was found.
    """
    return _refuting(sought, count, out_of_time)


def _refuting(sought: Sought, count: int, out_of_time: OutOfTime) -> Refutation:
    """Return what refutes all that there is, or catches at the first steps.

    Raises:
        Unproved: for one of them none was found.
    """
    made, trees = Refutation(sought, ()), list[ProofTree]()
    for posed in refuted_by(made.document(), count):
        tree = RefutationSearch(posed, out_of_time).tree()
        if tree is None:
            catch = f'a catch at step {posed.problem.horizon}'
            what = catch if posed.radius >= 0.0 else 'all that there is'
            raise Unproved(f'no certificate: no refutation of {what} was found')
        trees.append(tree)
    return replace(made, trees=tuple(trees))


class RefutationSearch:
    """Depth first over sides of bodies and directions, until each part misses what is asked of it.

    Args:
        posed: the problem, as the verifier reads it.
        out_of_time: polled before each part.
    """

    most = 2000  # leaves

    def __init__(self, posed: Posed, out_of_time: OutOfTime) -> None:
        problem, self._out_of_time = posed.problem, out_of_time
        stated = self._stated = Statement(problem).of(*posed[1:])
        self._unit, self._count = problem.length_unit, problem.horizon
        self._program = MissedProgram(stated, self._unit, problem.step)
        self._curvatures = np.maximum(np.sum(self._program.steered[0, 1:] ** 2, 1), LEAST)
        choices = (2 + len(stated.bodies.of)) * self._count
        self._region = region_of(DEEPEST, choices, stated.n, float)
        self._work = work_of(problem, stated.width, float)
        self._nodes, self._at, self._leaves = list[list[int]](), list[float](), list[ProofTree]()

    def tree(self) -> ProofTree | None:
        """Return splits and leaves that refute all; None where that takes too many.

        Raises:
            Unproved: it takes too long.
        """
        self._add(1)
        stated, known = self._stated, (self._region.part[0], self._region.span[0])
        if begin(stated, self._program.nowhere, *known) == HELD:
            self._poll()
            beyond = self._program.beyond
            held = beyond is not None and self._refutes(0, 0, beyond)
            if not held and not self._refuted(0, 0, ()):
                return None
        return self._made()

    def _poll(self) -> None:
        if self._out_of_time():
            raise Unproved('no certificate: no refutation was found in time')

    def _add(self, count: int) -> int:
        """Add nodes that nothing is left of; return the number of the first."""
        self._nodes += [[EMPTY, 0, 0, 0, -1] for _ in range(count)]
        self._at += count * [0.0]
        return len(self._nodes) - count

    def _refutes(self, place: int, depth: int, leaf: ProofTree) -> bool:
        """Return whether a leaf proves that nothing is at a node, which then keeps it."""
        value, sound = leaf_bound(self._stated, self._region, depth, leaf, 0, True, self._work)
        if len(self._leaves) == self.most or not (sound and value > 0.0):
            return False
        self._nodes[place][4] = len(self._leaves)
        self._leaves.append(leaf)
        return True

    def _refuted(self, place: int, depth: int, sides: tuple[Side, ...]) -> bool:
        """Return whether nothing is at a node, which then is the root of what proves it."""
        if depth:
            self._poll()
        missed = self._program.answer(self._region, depth, sides)
        if missed is None:
            return False
        if not missed.feasible and self._refutes(place, depth, missed.leaf):
            return True
        cut = self._beside(depth, missed.x) if missed.feasible else None
        cut = cut or self._turned(depth)
        return cut is not None and self._split(place, depth, sides, cut)

    def _split(self, place: int, depth: int, sides: tuple[Side, ...], cut: Cut) -> bool:
        """Return whether nothing is in any part of a node that is split."""
        if depth + 1 == DEEPEST:
            return False
        first = self._add(cut.parts)
        self._nodes[place] = [cut.kind, cut.choice, first, cut.parts, -1]
        self._at[place] = cut.at
        if cut.choice >= 2 * self._count:
            sides = (*sides, (depth + 1, cut.choice))
        known = self._stated, self._program.nowhere, np.array(self._nodes[place]), cut.at
        for i in range(cut.parts):
            part = part_of(*known, i, depth + 1, self._region)
            if part == GONE:
                continue
            if part != HELD or not self._refuted(first + i, depth + 1, sides):
                return False
        return True

    # --- where to split

    def _beside(self, depth: int, x: Array) -> Cut | None:
        """Return the split beside the body that a trajectory enters whose sides promise most."""
        short, ways = self._program.places.entered(x)
        promises = np.where(short > SATISFIED * self._unit, short, 0.0) ** 2 / self._curvatures
        for i in np.argsort(-promises, axis=None).tolist():
            j, k = divmod(i, self._count)
            if promises[j, k] <= 0.0:
                return None
            choice = 2 * self._count + i
            if self._stated.bodies.extents[j, -1] > 0.0:
                cut = self._directed(depth, choice, ways[j, k])
            elif self._region.part[depth, choice] < 0:
                cut = Cut(SIDES, choice, 2 * self._stated.n)
            else:
                cut = None
            if cut is not None:
                return cut
        return None

    def _turned(self, depth: int) -> Cut | None:
        """Return the split of the heading of which hulls hold most beside what they are of."""
        gains = [self._gain(depth, k) for k in range(self._count)]
        k = int(np.argmax(gains))
        if not gains[k] > 0.0:
            return None
        if len(self._stated.sets.faces):
            return Cut(FACES, k, len(self._stated.sets.faces))
        return self._directed(depth, k, None)

    def _gain(self, depth: int, k: int) -> float:
        """Return by how much more the hull of directions holds, as R_k e1 leads [m]."""
        stated, known = self._stated, self._region.part[depth, k] >= 0
        if (k == 0 and stated.decided != FREE) or not (known or stated.sets.least > 0.0):
            return 0.0
        if known and len(stated.sets.faces):
            return 0.0
        low, high = self._region.span[depth, k]
        deep = 2.0
        if known and stated.n == 2:
            deep = 1.0 - math.cos(min(0.5 * (high - low), math.pi))
            deep *= high - low > NARROWEST
        elif known:
            deep = 1.0 - about(self._region.corners[depth, k], np.zeros(3))[0]
            deep *= deep > NARROWEST**2
        return float(abs(self._program.reach[k]) * deep)

    def _directed(self, depth: int, choice: int, way: Array | None) -> Cut | None:
        """Return the split of directions, in the plane at one of them, or in the middle."""
        part, (low, high) = self._region.part[depth, choice], self._region.span[depth, choice]
        if self._stated.n == 3:
            known = part >= 0
            return Cut(QUARTERS, choice, 4) if known else Cut(PATCHES, choice, ICOSAHEDRON)
        angle = 0.0 if way is None else math.atan2(way[1], way[0])
        if part < 0:
            return Cut(ARCS, choice, AROUND, angle)
        if high - low < NARROWEST:
            return None
        middle, margin = 0.5 * (low + high), MARGIN * (high - low)
        angle += 2.0 * math.pi * round((middle - angle) / (2.0 * math.pi))
        at = middle if way is None else min(high - margin, max(low + margin, angle))
        return Cut(CUT, choice, 2, at)

    # --- the tree

    def _made(self) -> ProofTree:
        """Return the tree of all nodes, and of what their leaves have."""
        leaves = self._leaves or [self._program.nowhere]
        stacked: dict[str, Any] = {}
        of_leaves = [n for n in ARRAYS + OPTIONAL if n not in ('nodes', 'at', 'press_end')]
        for name in of_leaves:
            every = [getattr(each, name) for each in leaves]
            shape = max((each.shape for each in every if each.size), default=every[0].shape)
            absent = name in OPTIONAL and any(shape)
            stacked[name] = np.concatenate(
                [each if each.size or not absent else np.zeros(shape) for each in every]
            )
        sizes = np.cumsum([len(each.press) for each in leaves])
        nodes = np.array(self._nodes, np.int64)
        return ProofTree(nodes, np.array(self._at), press_end=sizes, **stacked)


# --- the least that is missed


class Held(NamedTuple):
    """What holds of z_k = R_k e1 and the bound t_k of its size: normal . z - share t >= least."""

    k: int
    normal: Array
    share: float
    least: float


class Missed(NamedTuple):
    """What the program of a part comes to.

    Attributes:
        x: R_1 e1..R_N e1, shape (N, n).
        leaf: the multipliers of what is missed, as the tree of a single leaf.
        feasible: whether a trajectory of the program misses nothing.
    """

    x: Array
    leaf: ProofTree
    feasible: bool


class MissedProgram:
    """The least that is missed by R_1 e1..R_N e1, and bounds t_k of |R_k e1|.

    Args:
        stated: the problem, as the verifier reads it.
        unit: of lengths [m].
        step: of times [s].
    """

    def __init__(self, stated: Stated, unit: float, step: float) -> None:
        self._stated, self._unit, self._step = stated, unit, step
        count, n = stated.root.span.shape[1], stated.n
        still = np.zeros((len(stated.start), count))
        self.flown = flown_by(stated.motion, stated.start[:, :n], np.zeros((count, n)))
        self.steered = flown_by(stated.motion, still, np.eye(count))
        reach = controls_of(stated.motion, self.steered)
        self.places = Places(stated.bodies, controls_of(stated.motion, self.flown), reach)
        self._z = np.arange(count * n).reshape(count, n)
        self._t, self._v = count * n + np.arange(count), count * (n + 1)
        self._free = int(stated.decided != FREE)  # the first heading that is not decided
        self._tied = range(stated.ends.begun if stated.ends.chord >= 0.0 else count, count)
        self._decided, self._round = self._first(), self._cones()

    @property
    def nowhere(self) -> ProofTree:
        """Return a leaf without multipliers."""
        return self._leaf()

    @property
    def beyond(self) -> ProofTree | None:
        """Return what may refute a catch of a goal that no headings lead to; None without one."""
        off = self.flown[0, -1] - self._stated.ends.goals[-1, :-1]
        away = float(np.linalg.norm(off))
        if self._stated.ends.radius < 0.0 or away == 0.0:
            return None
        return self._leaf(meet=off / (away * self._unit))

    @property
    def reach(self) -> Array:
        """Return what each R_k e1 adds to s_N, shape (N,) [m]."""
        return self.steered[0, -1]

    def _leaf(self, **multipliers: Array) -> ProofTree:
        count = len(self._t)
        return one(np.zeros((count, self._stated.width)), np.zeros(count), **multipliers)

    # --- what holds at all nodes

    def _blank(self, rows: int) -> Array:
        return np.zeros((rows, self._v + 1))

    def _first(self) -> Rows:
        """Return that a body rate decides R_1 e1, or that it is t_1 along what is coasted."""
        stated, n = self._stated, self._stated.n
        if stated.decided == FREE:
            return self._blank(0), np.zeros(0)
        a, known = self._blank(n), stated.start[DECIDED, :n]
        a[:, self._z[0]] = np.eye(n)
        if stated.decided != SEGMENT:
            return a, known
        a[:, self._t[0]] = -known / np.linalg.norm(known)
        return a, np.zeros(n)

    def _cones(self) -> list[Rows]:
        """Return (t_k, z_k), chords, (v, s_N - g_N), (v, p_N), (v + radius, s_N - g_N), slopes."""
        ends, unit = self._stated.ends, self._unit
        off = self.flown[0, 1:] - ends.goals[:, :-1]
        groups = [self._disk(k) for k in range(self._free, len(self._t))]
        groups += [self._chord(k) for k in self._tied]
        arrivals = (off[-1], 1.0 / unit), (self.flown[1, -1], self._step / unit)
        for i, (left, scale) in enumerate(arrivals[: ends.arrives]):
            groups.append(self._within(scale * self.steered[i, -1], scale * left, 0.0))
        if ends.radius >= 0.0:
            groups.append(self._within(self.reach / unit, off[-1] / unit, ends.radius / unit))
        if ends.sine > 0.0:
            groups += [self._above(k, off[k]) for k in range(len(off))]
        return groups

    def _disk(self, k: int) -> Rows:
        a = self._blank(self._stated.n + 1)
        a[0, self._t[k]] = -1.0
        a[1:, self._z[k]] = -np.eye(self._stated.n)
        return a, np.zeros(len(a))

    def _chord(self, k: int) -> Rows:
        n, tied = self._stated.n, self._stated.start[-1]
        a = self._blank(n + 1)
        a[1:, self._z[k]] = -np.eye(n)
        if k:
            a[1:, self._z[k - 1]] = np.eye(n)
        return a, np.append(self._stated.ends.chord, np.zeros(n) if k else -tied[:n])

    def _within(self, shares: Array, off: Array, radius: float) -> Rows:
        """Return that off, and what headings add to it, is no longer than a radius and v."""
        n = len(off)
        a = self._blank(n + 1)
        a[0, self._v] = -1.0
        for i in range(n):
            a[1 + i, self._z[:, i]] = -shares
        return a, np.append(radius, off)

    def _above(self, k: int, off: Array) -> Rows:
        """Return (cos d_3 + eased + v, sin d_1, sin d_2) of the cone above the goal."""
        ends, unit = self._stated.ends, self._unit
        a, b = self._blank(3), np.empty(3)
        for row, (i, scale) in enumerate(((2, ends.cosine), (0, ends.sine), (1, ends.sine))):
            a[row, self._z[:, i]] = -scale * self.steered[0, k + 1] / unit
            b[row] = scale * off[i] / unit
        a[0, self._v] = -1.0
        b[0] += ends.goals[k, -1] / unit
        return a, b

    # --- what holds at a node

    def _paced(self, region: Region, depth: int) -> Rows:
        """Return bounds of speeds, and that v is no less than -1."""
        count, sets, span = len(self._t), self._stated.sets, region.span[depth]
        a = self._blank(2 * count + 1)
        a[:count, self._t], a[count:-1, self._t] = np.eye(count), -np.eye(count)
        a[-1, self._v] = -1.0
        slowest, fastest = span[count : 2 * count].T.copy()
        for k in range(self._free, count):
            if sets.polygon > 0 and region.part[depth, k] >= 0:
                slowest[k] = max(slowest[k], nearest_floor(*span[k], sets.least, sets))
        for k, cone in zip(sets.cone_step, sets.cones, strict=True):
            slowest[k] = max(slowest[k], cone[self._stated.n + 2])
        return a, np.concatenate([fastest, -np.minimum(slowest, fastest), np.ones(1)])

    def _headed(self, region: Region, depth: int) -> list[Held]:
        """Return what holds of single headings that are not decided."""
        sets, n, found = self._stated.sets, self._stated.n, list[Held]()
        for k in range(self._free, len(self._t)):
            part, (low, high) = region.part[depth, k], region.span[depth, k]
            normal, middle = np.zeros(n), 0.5 * (low + high)
            if part >= 0 and n == 2 and high - low < sets.full - sets.narrow:
                normal = np.array([math.cos(middle), math.sin(middle)])
                found.append(Held(k, normal, math.cos(0.5 * (high - low)), 0.0))
            elif part >= 0 and len(sets.faces):
                found.append(Held(k, sets.faces[part], 0.0, sets.least))
            elif part >= 0 and n == 3:
                found.append(Held(k, normal, about(region.corners[depth, k], normal)[0], 0.0))
            own = sets.cones[sets.cone_step == k]
            found += [Held(k, cone[:n], cone[n], 0.0) for cone in own]
        return found

    def _leaning(self, held: list[Held]) -> Rows:
        a, b = self._blank(len(held)), np.empty(len(held))
        for i, each in enumerate(held):
            a[i, self._z[each.k]], a[i, self._t[each.k]] = -each.normal, each.share
            b[i] = -each.least
        return a, b

    def _beside(self, region: Region, depth: int, sides: tuple[Side, ...]) -> tuple[Rows, Any]:
        """Return that rows of positions are missed by no more than v, and the numbers of these."""
        stated, places, count, n = self._stated, self.places, len(self._t), self._stated.n
        a, b, rows, normal = list[Array](), list[float](), list[int](), np.zeros(n)
        for d, choice in sides:
            known = region.part[d], region.span[d], region.corners[d]
            out, off, terms = side_of(stated.sets, stated.bodies, choice, *known, normal)
            j, k = choice // count - 2, choice % count
            for at in np.flatnonzero(places.rows[j, k]) if terms >= 0.0 else ():
                row = self._blank(1)[0]
                row[self._z] = -np.outer(places.reach[j, k, at], normal) / self._unit
                row[self._v] = -1.0
                a.append(row)
                b.append((normal @ places.free[j, k, at] - (out - off)) / self._unit)
                above = POINTS * count * len(stated.bodies.of) * (depth - d)
                rows.append(POINTS * (choice - 2 * count) + int(at) + above)
        return (np.array(a).reshape(-1, self._v + 1), np.array(b)), np.array(rows, np.int64)

    # --- its answer

    def answer(self, region: Region, depth: int, sides: tuple[Side, ...]) -> Missed | None:
        """Return what is missed at a node at least; None where Clarabel panics.

        Args:
            region: what is known of choices from the root to the node.
            depth: of the node.
            sides: which sides of bodies are known there.
        """
        from scipy import sparse

        from orbimpc_ros.mpc.solve.conic import run, solver_for  # takes Clarabel

        beside, rows = self._beside(region, depth, sides)
        held = self._headed(region, depth)
        groups = [self._decided, beside, self._leaning(held), self._paced(region, depth)]
        sizes = [len(b) for _, b in groups]
        soc = [len(b) for _, b in self._round]
        groups += self._round
        cost = np.zeros(self._v + 1)
        cost[self._v] = 1.0
        data: dict[str, Any] = {
            'P': sparse.csc_matrix((len(cost), len(cost))),
            'c': cost,
            'A': sparse.csc_matrix(np.vstack([a for a, _ in groups])),
            'b': np.concatenate([b for _, b in groups]),
            'dims': SimpleNamespace(zero=sizes[0], nonneg=sum(sizes[1:]), soc=soc, psd=[]),
        }
        found: Any = run(solver_for(data, ACCURACY), None)
        if found is None:
            return None
        x, z = np.nan_to_num(found.x), np.nan_to_num(found.z)
        nowhere = 'PrimalInfeasible' in str(found.status)  # multipliers are a ray, of any length
        most = np.abs(z).max() if nowhere else 1.0
        _, presses, leaning, _, *rounds = np.split(z / max(most, 1e-300), np.cumsum(sizes + soc))
        known = self._multipliers(held, leaning, rounds)
        presses = np.maximum(presses, 0.0) / self._unit
        kept = presses > NEGLIGIBLE * presses.max(initial=0.0)
        leaf = self._leaf(**known)._replace(
            press=presses[kept], press_row=rows[kept], press_end=np.array([kept.sum()])
        )
        return Missed(x[self._z], leaf, not (nowhere or float(x[self._v]) > MISSED))

    def _multipliers(
        self, held: list[Held], leaning: Array, rounds: list[Array]
    ) -> dict[str, Array]:
        """Return multipliers as trees have them, of those of the program."""
        ends, (count, n), found = self._stated.ends, self._z.shape, dict[str, Array]()
        waiting = iter(rounds)
        disks = [next(waiting) for _ in range(self._free, count)]
        if self._tied:
            tether = np.zeros((count, n))
            for k in self._tied:
                tether[k] = -next(waiting)[1:]
            found['tether'] = tether
        scales = -1.0 / self._unit, -self._step / self._unit
        if ends.arrives:
            found['pull'] = np.array([s * next(waiting)[1:] for s in scales[: ends.arrives]])
        if ends.radius >= 0.0:
            found['meet'] = -next(waiting)[1:] / self._unit
        if ends.sine > 0.0:
            found['slide'] = self._slides(np.array([next(waiting) for _ in range(count)]))
        share = self._shares(held, leaning, disks)
        return {**found, 'share': share} if share.any() else found

    def _shares(self, held: list[Held], leaning: Array, disks: list[Array]) -> Array:
        """Return what the last of what holds of a step takes of its slope, where there is more.

        So that none counts on a speed that another does not, what is a cone takes as much of the
        multiplier of |z| <= t as has its own t cancelled. Over rotations all is the axis's.
        """
        shares = np.zeros(self._z.shape)
        seen, whole = set[int](), self._stated.width == 9
        if whole and disks:
            shares[self._free :] = [each[1:] for each in disks]
        for each, weight in zip(held, leaning, strict=True):
            size, way = disks[each.k - self._free][0], disks[each.k - self._free][1:]
            if whole:
                shares[each.k] += weight * each.normal
            elif each.k in seen:
                pull = way / size if size > 0.0 and each.share > 0.0 else np.zeros(len(way))
                shares[each.k] = weight * (each.normal + each.share * pull)
            seen.add(each.k)
        return shares

    def _slides(self, duals: Array) -> Array:
        """Return what slides along the cone above the goal, shape (N, 3)."""
        ends = self._stated.ends
        down = np.maximum(duals[:, 0], OUTWARD * np.hypot(duals[:, 1], duals[:, 2]))
        found = np.column_stack([-ends.sine * duals[:, 1:], -ends.cosine * down]) / self._unit
        return np.where(down[:, None] > NEGLIGIBLE * down.max(initial=0.0), found, 0.0)
