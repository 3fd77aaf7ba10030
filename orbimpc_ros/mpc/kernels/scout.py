# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A coarse search for a way among what is round or moves, step by step.

Vehicles are flown by a few headings at every step, and of the places reached the most promising are
kept, one for each cell of a grid of positions and velocities. What a place promises is its cost so
far, and what is left of it where nothing but obstacles that stand still is in the way. Whatever
comes out is a start for a search, and proves nothing.

Mathematics: docs/mathematics.md, 4.11.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled

ANYWHERE, TURNING, CHANGING = range(3)  # which headings can follow a heading
SLOTS = 8192  # of the table of cells taken, more than any beam
FACTOR, PRIME = 1_000_003, 2_147_483_647  # of a number for each cell
BLOCKED = 1e12


class Craft(NamedTuple):
    """How the vehicle moves, as :class:`orbimpc_ros.mpc.model.translation.Step` has it.

    Attributes:
        transition: A, padded to (2, 2).
        push: b, padded to (2,).
        follow: c, padded to (2,).
        blown: e w, padded to (2, n).
        kind: which headings can follow: any of ``moves``; in the plane, the unit heading before
            turned by the angle and at the speed of a row; or the one before plus a row.
        moves: shape (A, n), or (A, 2) of angles and speeds.
        least: speed.
        widest: a heading changes by no more, speed and direction together.
        inertial: whether positions follow from velocities.
    """

    transition: Array
    push: Array
    follow: Array
    blown: Array
    kind: int
    moves: Array
    least: float
    widest: float
    inertial: bool


class World(NamedTuple):
    """What is aimed at and what is in the way.

    Attributes:
        centres: of J balls at the ends of steps, shape (J, N + 1, n).
        radii: in each step, shape (J, N).
        goals: shape (N, n).
        weights: on squared distances to them, shape (N,).
        turning: weight on squared changes of the heading.
        stopping: weight on the squared velocity at the end.
        field: how far the last goal is from places of a grid, shape (G, G); (0, 0) for none.
        corner: of the grid, shape (n,).
        spacing: of the grid.
    """

    centres: Array
    radii: Array
    goals: Array
    weights: Array
    turning: float
    stopping: float
    field: Array
    corner: Array
    spacing: float


@compiled
def _hits(centres, radii, k, begin, end):
    """Return whether a straight way hits a ball that moves evenly in step k."""
    for j in range(len(radii)):
        along = squared = first = 0.0
        for c in range(len(begin)):
            a = begin[c] - centres[j, k, c]
            d = end[c] - centres[j, k + 1, c] - a
            along += a * d
            squared += d * d
            first += a * a
        share = min(1.0, max(0.0, -along / squared)) if squared > 0.0 else 0.0
        near = first + share * (2.0 * along + share * squared)
        if near < radii[j, k] ** 2:
            return True
    return False


@compiled
def _distance(field, corner, spacing, place, goal):
    """Return how far a goal is: around what stands still where the grid tells."""
    total = 0.0
    for c in range(len(place)):
        total += (place[c] - goal[c]) ** 2
    straight = np.sqrt(total)
    size = len(field)
    if size == 0:
        return straight
    x = int((place[0] - corner[0]) / spacing + 0.5)
    y = int((place[1] - corner[1]) / spacing + 0.5)
    if 0 <= x < size and 0 <= y < size:
        if field[x, y] < BLOCKED:
            return max(straight, field[x, y])
        return straight + size * spacing
    return straight


@compiled
def _set_halt(braking, y, halt):
    """Set where a vehicle comes to rest if it brakes at once; without inertia, where it is."""
    speed = 0.0
    if braking > 0.0:
        for c in range(len(halt)):
            speed += y[1, c] ** 2
        speed = np.sqrt(speed) / (2.0 * braking)
    for c in range(len(halt)):
        halt[c] = y[0, c] + speed * y[1, c]


@compiled
def _promise(weights, advance, braking, k, away):
    """Return about what steps k and later cost, gone straight to a goal so far away."""
    total = 0.0
    if braking == 0.0:
        for i in range(k, len(weights)):
            total += weights[i] * max(0.0, away - (i - k) * advance) ** 2
        return total
    half = np.sqrt(away / braking)  # when it turns to brake
    for i in range(k, len(weights)):
        ahead = i - k
        if ahead <= half:
            left = away - 0.5 * braking * ahead**2
        else:
            left = 0.5 * braking * max(0.0, 2.0 * half - ahead) ** 2
        total += weights[i] * left * left
    return total


@compiled
def _heading(kind, move, unit, before, after):
    """Set the heading of a move, shape (n,); return whether it is one."""
    if kind == TURNING:
        cosine, sine = np.cos(move[0]), np.sin(move[0])
        after[0] = move[1] * (cosine * unit[0] - sine * unit[1])
        after[1] = move[1] * (sine * unit[0] + cosine * unit[1])
        return True
    size = 0.0
    for c in range(len(after)):
        after[c] = move[c] + (before[c] if kind == CHANGING else 0.0)
        size += after[c] ** 2
    if size > 1.0:
        if kind == CHANGING and size > 1.5:
            return False
        after /= np.sqrt(size)
    return True


@compiled
def _moved(coasted, push, follow, before, after, out):
    """Set position and velocity, shape (2, n), after a step, given where it leads unpushed."""
    for c in range(len(before)):
        for i in range(2):
            out[i, c] = coasted[i, c] + push[i] * before[c] + follow[i] * after[c]


@compiled
def _set_coasted(transition, blown, y, out):
    """Set position and velocity, shape (2, n), after a step without thrust."""
    for c in range(y.shape[1]):
        for i in range(2):
            out[i, c] = transition[i, 0] * y[0, c] + transition[i, 1] * y[1, c] + blown[i, c]


@compiled
def _taken(table, y, fine, swift):
    """Return whether another place is in the same cell; if not, take it."""
    key = 1
    for c in range(y.shape[1]):
        key = (key * FACTOR + int(np.floor(y[0, c] / fine))) % PRIME
        key = (key * FACTOR + int(np.floor(y[1, c] / swift))) % PRIME
    key += 1  # zero is for places that are free
    at = key % SLOTS
    while table[at] != 0:
        if table[at] == key:
            return True
        at = (at + 1) % SLOTS
    table[at] = key
    return False


@compiled
def _spread(vehicle, world, k, y, z, unit, cost, made):
    """Fly every move from every place; return how many ways there are.

    ``made`` holds their promises, costs, origins, positions and velocities, headings, and where
    these lead in another step.
    """
    promises, costs, origins, reached, headings, onward = made
    centres, radii, goal, field = world.centres, world.radii, world.goals[k], world.field
    corner, spacing, last = world.corner, world.spacing, world.goals[-1]
    transition, push, follow, blown = (
        vehicle.transition,
        vehicle.push,
        vehicle.follow,
        vehicle.blown,
    )
    moves, weights, advance = vehicle.moves, world.weights, push[0] + follow[0]
    braking = push[1] + follow[1] if vehicle.inertial else 0.0
    stopping = world.stopping if k == len(weights) - 1 else 0.0
    n, count, coasted = z.shape[1], 0, np.empty_like(y[0])
    after, halt = np.empty(n), np.empty(n)
    for b in range(len(cost)):
        _set_coasted(transition, blown, y[b], coasted)
        for i in range(len(moves)):
            if count == len(costs) or not _heading(vehicle.kind, moves[i], unit[b], z[b], after):
                continue
            changed = 0.0
            for c in range(n):
                changed += (after[c] - z[b, c]) ** 2
            if changed > vehicle.widest**2:
                continue
            place = reached[count]
            _moved(coasted, push, follow, z[b], after, place)
            if _hits(centres, radii, k, y[b, 0], place[0]):
                continue
            missed = stopped = 0.0
            for c in range(n):
                missed += (place[0, c] - goal[c]) ** 2
                stopped += place[1, c] ** 2
            costs[count] = cost[b] + weights[k] * missed + world.turning * changed
            costs[count] += stopping * stopped
            _set_coasted(transition, blown, place, onward[count])
            _moved(onward[count], push, follow, after, after, onward[count])
            _set_halt(braking, onward[count], halt)
            promises[count] = costs[count]
            if k + 1 < len(weights):
                away = _distance(field, corner, spacing, halt, last)
                promises[count] += _promise(weights, advance, braking, k + 1, away)
            origins[count], headings[count] = b, after
            count += 1
    return count


@compiled
def _selected(made, count, beam, fine, swift):
    """Return the most promising of the places reached, one of each cell."""
    table, taken, kept = np.zeros(SLOTS, np.int64), np.empty(min(beam, count), np.int64), 0
    for i in np.argsort(made[0][:count]):
        if kept == len(taken):
            break
        if not _taken(table, made[5][i], fine, swift):
            taken[kept] = i
            kept += 1
    return taken[:kept]


class Trail(NamedTuple):
    """The places that are kept, and how they were come to.

    Attributes:
        headings: R_1 e1..R_N e1 by place, shape (N, B, n).
        origins: the places that they come from, shape (N, B).
        reached: positions and velocities of the last places, shape (B, 2, n).
        last: headings there, shape (B, n).
        units: directions of these, or of the last ones that had any, shape (B, n).
        costs: so far, shape (B,).
        counts: how many places there are, shape (1,).
    """

    headings: Array
    origins: np.ndarray
    reached: Array
    last: Array
    units: Array
    costs: Array
    counts: np.ndarray


def begun(start: Array, first: Array, ahead: Array, steps: int, beam: int) -> Trail:
    """Return a trail of one place.

    Args:
        start: position and velocity, shape (2, n).
        first: R_0 e1, shape (n,).
        ahead: the attitude's axis, shape (n,).
        steps: N.
        beam: places that are kept at every step.
    """
    n = len(first)
    headings, origins = np.zeros((steps, beam, n)), np.zeros((steps, beam), np.int64)
    reached, last, units = np.zeros((beam, 2, n)), np.zeros((beam, n)), np.zeros((beam, n))
    trail = Trail(headings, origins, reached, last, units, np.zeros(beam), np.ones(1, np.int64))
    trail.reached[0], trail.last[0], trail.units[0] = start, first, ahead
    return trail


@compiled
def advance(vehicle, world, k, trail, fine, swift):
    """Fly on by a step; return whether that is possible.

    Args:
        vehicle: how it moves.
        world: what it moves in.
        k: steps so far.
        trail: moved on.
        fine: size of a cell.
        swift: size of a cell in velocities.
    """
    had, beam, n = trail.counts[0], len(trail.costs), trail.last.shape[1]
    room = had * len(vehicle.moves)
    made = (
        np.empty(room), np.empty(room), np.empty(room, np.int64), np.empty((room, 2, n)),
        np.empty((room, n)), np.empty((room, 2, n)),
    )  # fmt: skip
    y, z, units = trail.reached[:had], trail.last[:had], trail.units[:had].copy()
    count = _spread(vehicle, world, k, y, z, units, trail.costs[:had], made)
    taken = _selected(made, count, beam, fine, swift)
    trail.counts[0] = len(taken)
    for b in range(len(taken)):
        i = taken[b]
        trail.reached[b], trail.last[b], trail.costs[b] = made[3][i], made[4][i], made[1][i]
        trail.headings[k, b], trail.origins[k, b] = made[4][i], made[2][i]
        size = np.sqrt((made[4][i] * made[4][i]).sum())
        for c in range(n):
            trail.units[b, c] = made[4][i, c] / size if size > 1e-9 else units[made[2][i], c]
    return count > 0


def traced(trail: Trail) -> Array:
    """Return the headings R_1 e1..R_N e1, shape (N, n), of the best way to any of the places."""
    found, at = np.empty_like(trail.headings[:, 0]), int(np.argmin(trail.costs[: trail.counts[0]]))
    for k in range(len(found) - 1, -1, -1):
        found[k], at = trail.headings[k, at], trail.origins[k, at]
    return found


@compiled
def flood(free, goal, spacing):
    """Return how far a goal is from every place of a grid, shape (G, G), around what is not free.

    Args:
        free: whether vehicles can be there, shape (G, G).
        goal: of the grid's places, shape (2,).
        spacing: of the grid.
    """
    size, field = len(free), np.full(free.shape, BLOCKED)
    field[goal[0], goal[1]], changed, rounds = 0.0, True, 0
    while changed and rounds < 32:
        changed, rounds = False, rounds + 1
        for sweep in range(4):
            for i in range(size):
                x = i if sweep & 1 else size - 1 - i
                for j in range(size):
                    y = j if sweep & 2 else size - 1 - j
                    if not free[x, y]:
                        continue
                    for dx in range(-1, 2):
                        for dy in range(-1, 2):
                            u, v = x + dx, y + dy
                            if 0 <= u < size and 0 <= v < size:
                                way = field[u, v] + spacing * np.sqrt(dx * dx + dy * dy)
                                if way < field[x, y] - 1e-9:
                                    field[x, y], changed = way, True
    return field
