# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Best-first branch and bound over stage sets in the plane.

A node holds a sector for every step: a range of unwrapped headings and one of speeds. It is split
by the heading or the speed of one step; turn rate and acceleration then narrow the sectors of its
neighbours. Each node keeps the tangent point of its bound, so that the tree is the proof.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled, entry_point
from orbimpc_ros.mpc.kernels.linear import add_product, copy_to
from orbimpc_ros.mpc.proof.tree import ARCS, CHILD, CHILDREN, CHOICE, CUT, KIND, ROW, SPEED
from orbimpc_ros.mpc.search.best_first import (
    DONE,
    EMPTY,
    FULL,
    LEAST,
    MADE,
    NODES,
    OPEN,
    PAUSED,
    VALUE,
    close,
    cutoff_of,
    least_left,
    leave_open,
    take,
)
from orbimpc_ros.mpc.search.local import descend, is_paced, round_off, set_headings
from orbimpc_ros.mpc.search.relax import (
    GOING,
    PRUNED,
    SOLVED,
    SPACES,
    STALLED,
    cost_of,
    missed_by,
    misses,
    most_of,
    pulled,
    relax,
    rise_of,
    set_slope,
    settle,
    tangent_bound,
)
from orbimpc_ros.mpc.search.ring import (
    ALL,
    FAST,
    HALF,
    HIGH,
    LOW,
    MARGIN,
    SECTOR,
    SLOW,
    TURN,
    cut_near,
    least_speed,
    nearest_speed,
    outline,
    prox,
    take_part,
)

PROMISES, FROM = 3, 4  # in Tree.counts: whether a descent is due; the node it starts from
KEY, TAKEN, MU = range(3)  # in Tree.progress: bound; Newton steps; smoothing of the dual function
MOST_ARCS = 5  # most arcs that the headings of a step are split into
NODE, STEP = 1500.0, 350.0  # work of a node in addition to its relaxation, and per step
NARROWEST = 1e-6  # narrower sectors [rad] and ranges of speeds are not cut
SATISFIED = 1e-8  # smaller violations of a floor or a turn are not branched on
MEMORY: dict[tuple[int, int], np.ndarray] = {}  # by thread and field
ROUNDS, MISSED = 20, 1e-8  # most updates of an arrival's multipliers; a miss that needs none
# Of the weight of an arrival, in relaxations: initially; growth if misses shrink slowly.
SOFT, STIFFER = 1e-2, 10.0
SLOWLY = 0.5  # ratio of successive misses above which they shrink slowly
ACCURATE = 0.02  # gap of a node's relaxation, as a share of the tolerance


class Tree(NamedTuple):
    """A search: its M nodes, and the incumbent.

    With Shor multipliers, K = 4 and C = 1; without them, both are 0.

    Attributes:
        sectors: low, high, slow, fast for each step, shape (M, N, 4).
        z: point where a node's relaxation begins or has ended, shape (M, N, n).
        point: tangent point of a node's bound, shape (M, N, n).
        held: multipliers by kind, shape (M, K, N).
        kept: curvatures assigned to single steps in that bound, shape (M, C, N).
        pull: multipliers of an arrival in that bound, shape (M, 1, n).
        progress: see the names of its entries, shape (M, 3).
        nodes: as in proofs (:class:`orbimpc_ros.mpc.proof.tree.ProofTree`), but with leaves not
            numbered yet, shape (M, 5).
        at: the first angle [rad], or the speed, between a node's children, shape (M,).
        keys: bounds of the open nodes, a heap, shape (M,).
        heap: indices of these nodes, shape (M,).
        best: the incumbent, shape (N, n).
        counts: see the names of its entries, shape (8,).
        numbers: shape (3,).
    """

    sectors: Array
    z: Array
    point: Array
    held: Array
    kept: Array
    pull: Array
    progress: Array
    nodes: np.ndarray
    at: Array
    keys: Array
    heap: np.ndarray
    best: Array
    counts: np.ndarray
    numbers: Array


@lru_cache(maxsize=SPACES)
def tree_for(thread: int, nodes: int, steps: int, n: int, kinds: int) -> Tree:
    """Return memory for a search, used page by page, which it takes from the last of its thread.

    New memory would take milliseconds: the system clears it where it is first used.

    Args:
        thread: identifies it.
        nodes: M.
        steps: N.
        n: dimension.
        kinds: K.
    """
    wide = (steps, SECTOR), (steps, n), (steps, n), (kinds, steps), (min(1, kinds), steps)
    shapes = *wide, (1, n), (3,), (5,), (), (), ()
    arrays = [_kept(thread, i, nodes, shape) for i, shape in enumerate(shapes)]
    return Tree._make([*arrays, np.zeros((steps, n)), np.zeros(8, np.int64), np.zeros(3)])


def _kept(thread: int, i: int, nodes: int, shape: tuple[int, ...]) -> np.ndarray:
    """Return field i of a tree, in the memory that this field had in the last one of a thread."""
    size, memory = nodes * math.prod(shape), MEMORY.get((thread, i))
    if memory is None or len(memory) < size:
        kind = np.int64 if Tree._fields[i] in ('nodes', 'heap') else np.float64
        memory = MEMORY[thread, i] = np.empty(2 * size, kind)  # enough for other horizons
    return memory[:size].reshape(nodes, *shape)


@compiled
def plant(tree):
    """Begin a search with an open root, which is zero but for its sectors, and no incumbent."""
    for data in (tree.z, tree.point, tree.held, tree.kept, tree.pull):
        data[0] = 0.0
    tree.nodes[0], tree.progress[0], tree.progress[0, KEY], tree.at[0] = 0, 0.0, -np.inf, 0.0
    tree.counts[:], tree.numbers[:] = 0, np.inf
    tree.counts[MADE], tree.numbers[LEAST] = 1, -np.inf
    leave_open(tree, 0, -np.inf, np.inf)


@compiled
def branch(tree, node, kind, choice, cut, parts):
    """Split a node; return its first child. The children are copies of it, and leaves."""
    counts, nodes, first = tree.counts, tree.nodes, tree.counts[MADE]
    counts[MADE] += parts
    nodes[node, KIND], nodes[node, CHOICE], nodes[node, ROW] = kind, choice, -1
    nodes[node, CHILD], nodes[node, CHILDREN], tree.at[node] = first, parts, cut
    for i in range(first, first + parts):
        for data in tree[:6]:
            for k in range(data.shape[1]):
                for c in range(data.shape[2]):
                    data[i, k, c] = data[node, k, c]
        for c in range(nodes.shape[1]):
            nodes[i, c] = 0
        tree.at[i] = 0.0
        copy_to(tree.progress[i], tree.progress[node])
        tree.progress[i, TAKEN] = 0.0
    return first


@compiled
def take_better(posed, tree, z):
    """Make a trajectory the incumbent if it is better."""
    if tree.numbers[VALUE] == np.inf or rise_of(posed, tree.best, z) < 0.0:
        tree.numbers[VALUE] = cost_of(posed, z)
        copy_to(tree.best, z)


@compiled
def _narrow(sector, k, low, high, most):
    """Narrow the ranges of all steps from that of step k, given the largest change in a step."""
    for j in range(k + 1, len(sector)):
        sector[j, low] = max(sector[j, low], sector[j - 1, low] - most)
        sector[j, high] = min(sector[j, high], sector[j - 1, high] + most)
    for j in range(k - 1, -1, -1):
        sector[j, low] = max(sector[j, low], sector[j + 1, low] - most)
        sector[j, high] = min(sector[j, high], sector[j + 1, high] + most)


@compiled
def _is_empty(ring, sector):
    """Return True if one of the sectors contains no heading or no speed."""
    for k in range(len(sector)):
        low, high, slow, fast = sector[k, LOW], sector[k, HIGH], sector[k, SLOW], sector[k, FAST]
        if low > high or slow > fast:
            return True
        beyond = ring.faces > 0 and fast < 1.0
        if beyond and nearest_speed(ring.fraction, ring.faces, low, high) > fast + SATISFIED:
            return True
    return False


@compiled
def set_reachable(ring, sector):
    """Set the sectors to reachable headings and speeds; return False if there are none."""
    limited, end = ring.widest < HALF, len(sector) - 1
    for k in range(len(sector)):
        free = k + 1 - ring.decided
        reach = free * ring.widest if limited else min(1, free) * np.pi
        changed = (k + 1) * ring.change
        sector[k, LOW], sector[k, HIGH] = ring.first - reach, ring.first + reach
        sector[k, SLOW] = max(ring.fraction, ring.entry - changed)
        sector[k, FAST] = min(1.0, ring.entry + changed)
    if ring.within < HALF and not limited:
        sector[end, LOW], sector[end, HIGH] = ring.last - ring.within, ring.last + ring.within
    return _aim(ring, sector)[1] > 0 and not _is_empty(ring, sector)


@compiled
def _aim(ring, sector):
    """Intersect the last sector with the approach, if only one winding of the approach meets it.

    Returns:
        The first winding of the approach that meets it, in full turns, and how many there are.
    """
    if ring.within >= HALF:
        return 0.0, 1
    end = sector[len(sector) - 1]
    first = np.ceil((end[LOW] - ring.within - ring.last) / TURN)
    windings = int(np.floor((end[HIGH] + ring.within - ring.last) / TURN) - first) + 1
    if windings == 1:
        middle = ring.last + TURN * first
        end[LOW] = max(end[LOW], middle - ring.within)
        end[HIGH] = min(end[HIGH], middle + ring.within)
        if ring.widest < HALF:
            _narrow(sector, len(sector) - 1, LOW, HIGH, ring.widest)
    return first, windings


@compiled
def _cut_at(ring, angle, low, high):
    """Return where to cut a sector: at a corner of the floor inside it, or else near an angle."""
    angle = cut_near(0.5 * (low + high) if high - low > HALF else angle, low, high)
    if ring.faces > 0:
        share = TURN / ring.faces
        corner = share * (np.round(angle / share - 0.5) + 0.5)
        for away in (0.0, share, -share):
            if low + 1e-9 < corner + away < high - 1e-9:
                return corner + away
    return angle


@compiled
def _heading_parts(ring, angle, low, high):
    """Return where to cut a sector, and into how many children."""
    if high - low < ALL or ring.widest < HALF:
        return _cut_at(ring, angle, low, high), 2
    if ring.faces > 0:
        return np.pi / ring.faces, ring.faces
    return angle, MOST_ARCS


@compiled
def _heading_branching(ring, inverse, z, sector):
    """Return the step whose heading to branch on (-1 for none), the angle, and the gain.

    If a turn is too wide, the wider of its two sectors is cut such that each child excludes one of
    the two headings. Gains of turns are multiplied by their step number: splitting a late step
    narrows all steps before it, whereas an early one leaves those after it nearly as free as
    before.
    """
    chosen, at, gain, before, last = -1, 0.0, 0.0, ring.first, 1.0
    for k in range(len(z)):
        size, angle = np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2), np.arctan2(z[k, 1], z[k, 0])
        width, wider = sector[k, HIGH] - sector[k, LOW], -1.0
        least = least_speed(ring.fraction, ring.faces, angle)
        short = max(sector[k, SLOW], least) - size
        if short > SATISFIED and width > NARROWEST:
            raised = short * short / (2.0 * inverse[k, k])
            if raised > gain:
                chosen, gain, at = k, raised, angle
        turn = angle - before - TURN * np.round((angle - before) / TURN)
        excess = abs(turn) - ring.widest
        if excess > SATISFIED:
            half, away = np.sin(0.5 * excess), np.copysign(0.5 * excess, turn)
            raised = (size * half) ** 2 / (2.0 * inverse[k, k])
            if k > 0:
                raised = min(raised, (last * half) ** 2 / (2.0 * inverse[k - 1, k - 1]))
                wider = sector[k - 1, HIGH] - sector[k - 1, LOW]
            raised *= k + 1.0
            if wider > max(NARROWEST, width) and raised > gain:
                chosen, gain, at = k - 1, raised, before + away
            elif width > NARROWEST and raised > gain:
                chosen, gain, at = k, raised, angle - away
        before, last = angle, size
    return chosen, at, gain


@compiled
def _speed_branching(ring, inverse, z, sector):
    """Return the same as :func:`_heading_branching`, for the ranges of speeds.

    If the speed changes too much, the wider of the two ranges is cut such that each child excludes
    one of the two speeds.
    """
    chosen, cut, gain, last, held = -1, 0.0, 0.0, ring.entry, False
    for k in range(len(z)):
        slow, fast = sector[k, SLOW], sector[k, FAST]
        size = np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2)
        half, holds = 0.5 * (abs(size - last) - ring.change), size > slow - 3e-6
        if half > SATISFIED and held and holds:
            away = np.copysign(half, size - last)
            j, at = k, size - away
            if sector[k - 1, FAST] - sector[k - 1, SLOW] > fast - slow:
                j, at = k - 1, last + away
            width = sector[j, FAST] - sector[j, SLOW]
            raised = half * half / (2.0 * max(inverse[k, k], inverse[k - 1, k - 1])) * (k + 1.0)
            if width > NARROWEST and raised > gain:
                edge = MARGIN * width
                chosen, gain = j, raised
                cut = min(sector[j, FAST] - edge, max(sector[j, SLOW] + edge, at))
        last, held = size, holds
    return chosen, cut, gain


@compiled
def _branching(ring, inverse, z, sector):
    """Return the choice to split (-1 for none), where, and into how many children."""
    k, at, gain = _heading_branching(ring, inverse, z, sector)
    if ring.change < np.inf:
        j, speed, more = _speed_branching(ring, inverse, z, sector)
        if more > gain:
            return j + len(z), speed, 2
    if k < 0:
        return k, at, 0
    cut, parts = _heading_parts(ring, at, sector[k, LOW], sector[k, HIGH])
    return k, cut, parts


@compiled
def _widest(ring, sector):
    """Return the choice with the widest heading (-1 for none), and how to split it."""
    chosen, widest = -1, NARROWEST
    for k in range(len(sector)):
        if sector[k, HIGH] - sector[k, LOW] > widest:
            chosen, widest = k, sector[k, HIGH] - sector[k, LOW]
    low, high = sector[chosen, LOW], sector[chosen, HIGH]
    cut, parts = _heading_parts(ring, 0.5 * (low + high), low, high)
    return chosen, cut, parts


@compiled
def _set_part(ring, sector, choice, cut, parts, i):
    """Set the sectors of a child, given those of its parent; return False if it is empty."""
    count = len(sector)
    k = choice % count
    low, high, most = LOW, HIGH, ring.widest
    if choice >= count:
        low, high, most = SLOW, FAST, ring.change
    take_part(sector, k, low, high, cut, parts, i)
    if choice >= count or most < HALF:
        _narrow(sector, k, low, high, most)
    return _aim(ring, sector)[1] > 0 and not _is_empty(ring, sector)


@compiled
def _moved(posed, shapes, changed, start, z):
    """Move the most violated heading onto its set, the others by least cost; False if none is."""
    count, worst, k, ox, oy = len(z), 0.0, -1, 0.0, 0.0
    for j in range(count):
        if not changed[j]:
            continue
        px, py, _, _, _ = prox(shapes[j], 1.0, 0.0, -start[j, 0], -start[j, 1])
        dx, dy = px - start[j, 0], py - start[j, 1]
        missed = (dx * dx + dy * dy) / posed.inverse[j, j]
        if missed > worst:
            worst, k, ox, oy = missed, j, dx, dy
    if k < 0:
        return False
    for j in range(count):
        share = posed.inverse[j, k] / posed.inverse[k, k]
        z[j, 0], z[j, 1] = start[j, 0] + share * ox, start[j, 1] + share * oy
    return True


@compiled
def _split(posed, ring, tree, node, choice, cut, parts, cutoff, room):
    """Create the children of a node, each with the bound of its parent's point or a moved one."""
    kind = SPEED if choice >= len(posed.q) else ARCS if parts > 2 else CUT
    first = branch(tree, node, kind, choice, cut, parts)
    for i in range(first, first + parts):
        sector, shapes = tree.sectors[i], room.parts
        if not _set_part(ring, sector, choice, cut, parts, i - first):
            tree.nodes[i, ROW], tree.progress[i, KEY] = -1, np.inf  # it is empty
            continue
        copy_to(shapes, room.shapes)
        for k in range(len(sector)):
            room.changed[k] = False
            for e in range(SECTOR):
                room.changed[k] |= sector[k, e] != tree.sectors[node, k, e]
            if room.changed[k]:
                outline(ring, sector[k], shapes[k])
        if posed.stiff == 0.0 and _moved(posed, shapes, room.changed, tree.z[i], room.trial):
            set_slope(posed.hessian, posed.q, room.trial, room.slope)
            key = tangent_bound(posed, shapes, room.trial, room.slope)[1]
            if key > tree.progress[i, KEY]:
                tree.progress[i, KEY] = key
                copy_to(tree.point[i], room.trial)
        leave_open(tree, i, tree.progress[i, KEY], cutoff)


@compiled
def _way(ring, turns):
    """Return the last heading of turns, and the nearest winding of the approach [rad]."""
    angle = ring.first
    for k in range(len(turns)):
        angle += turns[k]
    return angle, ring.last + TURN * np.round((angle - ring.last) / TURN)


@compiled
def is_promising(posed, ring, tree, z, sector, share, room):
    """Round headings to a trajectory; return True if that is worth a descent.

    Args:
        posed: the problem.
        ring: floor and limits.
        tree: where a descent may end infeasible, its incumbent is replaced by a better trajectory.
        z: headings, shape (N, 2).
        sector: to which they are clipped, shape (N, 4).
        share: largest excess of the rounded cost, relative to that of the incumbent.
        room: working memory; its speeds and turns are set.
    """
    value = tree.numbers[VALUE]
    round_off(ring, z, sector, room.speeds, room.turns)
    if posed.stiff > 0.0:  # it does not arrive yet
        return share > 0.0
    if ring.change < np.inf and not is_paced(ring, room.speeds, room.turns):
        return False
    set_headings(ring, room.speeds, room.turns, room.trial)
    rounded = cost_of(posed, room.trial)
    plain = ring.widest >= HALF and posed.lengths[0] == 0.0
    free = ring.faces > 0 and plain  # cells of a polygon need no descent
    angle, way = _way(ring, room.turns)
    aimed = ring.within >= HALF or abs(angle - way) <= ring.within + SATISFIED
    if aimed and (ring.change < np.inf or ring.within < HALF or free):
        take_better(posed, tree, room.trial)
        if free:
            return False
    return rounded <= value + share * abs(value + posed.constant)


@compiled
def improve(posed, ring, tree, room):
    """Descend from the speeds and turns of a promising trajectory, then clip it to the approach."""
    z, sector, end = room.trial, tree.sectors[0].copy(), len(posed.q) - 1
    pull = tree.pull[tree.counts[FROM], 0].copy()
    legal = descend(posed, ring, pull, room.speeds, room.turns, z)
    if ring.within < HALF:
        _, way = _way(ring, room.turns)
        sector[end, LOW] = max(sector[end, LOW], way - ring.within)
        sector[end, HIGH] = min(sector[end, HIGH], way + ring.within)
        _narrow(sector, end, LOW, HIGH, ring.widest)
        if not _is_empty(ring, sector):
            copy_to(room.other, z)
            is_promising(posed, ring, tree, room.other, sector, 0.0, room)
    elif legal:
        take_better(posed, tree, z)


@compiled
def _begin(posed, ring, tree, guess, room):
    """Begin a search with its root and an incumbent near the best point known; see `search`.

    If no trajectory is found near it, the search begins with straight flight. Return False if the
    root is empty.
    """
    plant(tree)
    start, ahead = tree.z[0], np.empty_like(tree.best)
    free = pulled(posed, tree.pull[0, 0], posed.stiff) if posed.stiff > 0.0 else posed
    add_product(posed.inverse, free.q, -1.0, start)
    copy_to(tree.point[0], start)
    if not set_reachable(ring, tree.sectors[0]):
        return False
    if ring.fraction == 0.0:  # over disks the relaxation finds the optimum itself
        return True
    for k in range(len(ahead)):
        ahead[k, 0] = ring.entry * np.cos(ring.first)
        ahead[k, 1] = ring.entry * np.sin(ring.first)
    for near in (guess if len(guess) > 0 else start, ahead):
        if tree.numbers[VALUE] == np.inf and is_promising(
            posed, ring, tree, near, tree.sectors[0], np.inf, room
        ):
            improve(posed, ring, tree, room)
    return True


@compiled
def _choose(posed, ring, tree, node, room):
    """Round the point of a relaxation; return the choice to split (-1 for none), where and how."""
    counts, sector, z = tree.counts, tree.sectors[node], tree.z[node]
    choice, cut, parts = _branching(ring, posed.inverse, z, sector)
    if choice < 0:
        settle(posed, z)
        take_better(posed, tree, z)
    elif ring.fraction > 0.0:
        share = 0.5 if counts[NODES] & (counts[NODES] - 1) == 0 else 0.0  # at powers of two
        counts[FROM] = node
        counts[PROMISES] = is_promising(posed, ring, tree, z, sector, share, room)
    return choice, cut, parts


@compiled
def _cutoff(posed, tree, tolerance):
    """Return the bound from which on nodes are pruned; without an incumbent, that of no arrival."""
    if posed.stiff > 0.0 and tree.numbers[VALUE] == np.inf:
        return most_of(posed)
    return cutoff_of(tree.numbers[VALUE], posed.constant, tolerance)


@compiled
def _relax_arriving(posed, tree, node, limits, room, work):
    """Relax a node, and update the multipliers of the arrival until its point arrives.

    Where there is no point that does, multipliers and bound grow beyond all costs.
    """
    z, point, progress = tree.z[node], tree.point[node], tree.progress[node]
    pull, stiff, last = tree.pull[node, 0].copy(), SOFT * posed.stiff, np.inf
    for _ in range(ROUNDS):
        free, key = pulled(posed, pull, stiff), progress[KEY]
        shift = free.constant - posed.constant
        progress[KEY] = before = key - shift
        relaxed = z, point, progress, room.shapes
        status, work = relax(free, relaxed, (limits[0] - shift, limits[1]), room, work)
        rises, missed = progress[KEY] > before, misses(posed, z)
        progress[KEY] = progress[KEY] + shift if rises else key
        for c in range(2):
            if rises:
                tree.pull[node, 0, c] = pull[c] + stiff * missed_by(posed, point, c)
            pull[c] += stiff * missed_by(posed, z, c)
        if status in (PRUNED, GOING) or missed <= MISSED:
            return status, work
        if missed > SLOWLY * last:
            stiff *= STIFFER
        last = missed
    return GOING, work


@compiled
def _solve_node(posed, ring, tree, node, tolerance, room, work):
    """Relax a node, round its point, and split it; return the remaining multiplications."""
    counts = tree.counts
    first, windings = _aim(ring, tree.sectors[node])
    for k in range(len(posed.q)):
        outline(ring, tree.sectors[node, k], room.shapes[k])
    choice, cut, parts, status = len(posed.q) - 1, ring.last + TURN * first + np.pi, 2, SOLVED
    if windings == 1:
        limits = _cutoff(posed, tree, tolerance), ACCURATE * tolerance
        if posed.stiff > 0.0:
            status, work = _relax_arriving(posed, tree, node, limits, room, work)
        else:
            relaxed = tree.z[node], tree.point[node], tree.progress[node], room.shapes
            status, work = relax(posed, relaxed, limits, room, work)
        choice = -1
        if status in (SOLVED, STALLED):
            choice, cut, parts = _choose(posed, ring, tree, node, room)
    if status == GOING:
        if ring.fraction == 0.0:
            take_better(posed, tree, tree.z[node])
        leave_open(tree, node, tree.progress[node, KEY], np.inf)
        return work
    counts[NODES] += 1
    cutoff = _cutoff(posed, tree, tolerance)
    if choice < 0 and status == STALLED and tree.progress[node, KEY] < cutoff:
        choice, cut, parts = _widest(ring, tree.sectors[node])  # its bound is not that of its point
    if choice < 0:
        close(tree, tree.progress[node, KEY])
        return work
    _split(posed, ring, tree, node, choice, cut, parts, cutoff, room)
    return work


@entry_point
def search(posed, tolerance, tree, ring, guess, room, work):
    """Begin or continue a best-first search.

    Args:
        posed: the problem.
        tolerance: relative gap at which to stop.
        tree: updated in place; without nodes, the search begins.
        ring: floor and limits.
        guess: the best point known, shape (N, 2); (0, 2) for the unconstrained optimum.
        room: working memory.
        work: multiplications to do.

    Returns:
        ``DONE``; ``FULL`` if there is no memory for more nodes; ``EMPTY`` without trajectories;
        ``PAUSED`` if the work is done, or if the next call begins with a descent.
    """
    counts, numbers, status = tree.counts, tree.numbers, PAUSED
    if counts[MADE] == 0 and not _begin(posed, ring, tree, guess, room):
        return EMPTY
    if counts[PROMISES] > 0:
        improve(posed, ring, tree, room)
    counts[PROMISES] = 0
    while work > 0.0 and status == PAUSED and counts[PROMISES] == 0:
        cutoff = _cutoff(posed, tree, tolerance)
        if counts[OPEN] == 0 or tree.keys[0] >= cutoff:
            status = DONE
        elif counts[MADE] + max(MOST_ARCS, ring.faces) > len(tree.sectors):
            status = FULL
        else:
            work = _solve_node(posed, ring, tree, take(tree), tolerance, room, work)
            work -= NODE + STEP * len(posed.q)
    numbers[LEAST] = min(least_left(tree), numbers[VALUE])
    if status == DONE and posed.stiff > 0.0 and numbers[LEAST] >= most_of(posed):
        return EMPTY
    return status
