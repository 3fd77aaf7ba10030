"""A coarse search for a way among what is round or moves, step by step.

Vehicles are flown by a few headings at every step, and of the places reached the most promising are
kept, one for each cell of a grid of positions and velocities. What a place promises is its cost so
far, and what is left of it where nothing but obstacles that stand still is in the way. Whatever
comes out is a start for a search, and proves nothing.

Mathematics: docs/mathematics.md, 4.12.
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
        inertial: whether positions follow from velocities.
    """

    transition: Array
    push: Array
    follow: Array
    blown: Array
    kind: int
    moves: Array
    least: float
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
def _hits(world, k, begin, end):
    """Return whether a straight way hits a ball that moves evenly in step k."""
    for j in range(len(world.radii)):
        along = squared = first = 0.0
        for c in range(len(begin)):
            a = begin[c] - world.centres[j, k, c]
            d = end[c] - world.centres[j, k + 1, c] - a
            along += a * d
            squared += d * d
            first += a * a
        share = min(1.0, max(0.0, -along / squared)) if squared > 0.0 else 0.0
        near = first + share * (2.0 * along + share * squared)
        if near < world.radii[j, k] ** 2:
            return True
    return False


@compiled
def _distance(world, place, goal):
    """Return how far a goal is: around what stands still where the grid tells."""
    total = 0.0
    for c in range(len(place)):
        total += (place[c] - goal[c]) ** 2
    straight = np.sqrt(total)
    size = len(world.field)
    if size == 0:
        return straight
    x = int((place[0] - world.corner[0]) / world.spacing + 0.5)
    y = int((place[1] - world.corner[1]) / world.spacing + 0.5)
    if 0 <= x < size and 0 <= y < size:
        if world.field[x, y] < BLOCKED:
            return max(straight, world.field[x, y])
        return straight + size * world.spacing
    return straight


@compiled
def _left(vehicle, away, ahead):
    """Return how far away a goal is so many steps later, gone to straight from where it rests."""
    if not vehicle.inertial:
        return max(0.0, away - ahead * (vehicle.push[0] + vehicle.follow[0]))
    pushed = vehicle.push[1] + vehicle.follow[1]  # full thrust, in units of steps
    half = np.sqrt(away / pushed)  # when it turns to brake
    if ahead <= half:
        return away - 0.5 * pushed * ahead**2
    return 0.5 * pushed * max(0.0, 2.0 * half - ahead) ** 2


@compiled
def _promise(world, vehicle, k, y):
    """Return about what steps k and later cost, ending step k at y; with inertia, from its halt."""
    if k == len(world.goals):
        return 0.0
    halt, speed = y[0].copy(), 0.0
    if vehicle.inertial:
        for c in range(y.shape[1]):
            speed += y[1, c] ** 2
        halt += y[1] * np.sqrt(speed) / (2.0 * (vehicle.push[1] + vehicle.follow[1]))
    away, total = _distance(world, halt, world.goals[-1]), 0.0
    for i in range(k, len(world.goals)):
        total += world.weights[i] * _left(vehicle, away, i - k) ** 2
    return total


@compiled
def _heading(vehicle, unit, before, i, after):
    """Set the heading of a move, shape (n,); return whether it is one."""
    move = vehicle.moves[i]
    if vehicle.kind == TURNING:
        cosine, sine = np.cos(move[0]), np.sin(move[0])
        after[0] = move[1] * (cosine * unit[0] - sine * unit[1])
        after[1] = move[1] * (sine * unit[0] + cosine * unit[1])
        return True
    size = 0.0
    for c in range(len(after)):
        after[c] = move[c] + (before[c] if vehicle.kind == CHANGING else 0.0)
        size += after[c] ** 2
    if size > 1.0:
        if vehicle.kind == CHANGING and size > 1.5:
            return False
        after /= np.sqrt(size)
    return True


@compiled
def _moved(vehicle, y, before, after, out):
    """Set position and velocity, shape (2, n), after a step."""
    a = vehicle.transition
    for c in range(y.shape[1]):
        for i in range(2):
            out[i, c] = a[i, 0] * y[0, c] + a[i, 1] * y[1, c] + vehicle.blown[i, c]
            out[i, c] += vehicle.push[i] * before[c] + vehicle.follow[i] * after[c]


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
    after, count = np.empty(z.shape[1]), 0
    for b in range(len(cost)):
        for i in range(len(vehicle.moves)):
            if count == len(costs) or not _heading(vehicle, unit[b], z[b], i, after):
                continue
            _moved(vehicle, y[b], z[b], after, reached[count])
            if _hits(world, k, y[b, 0], reached[count, 0]):
                continue
            missed = changed = 0.0
            for c in range(len(after)):
                missed += (reached[count, 0, c] - world.goals[k, c]) ** 2
                changed += (after[c] - z[b, c]) ** 2
            costs[count] = cost[b] + world.weights[k] * missed + world.turning * changed
            if k == len(world.goals) - 1:
                for c in range(len(after)):
                    costs[count] += world.stopping * reached[count, 1, c] ** 2
            _moved(vehicle, reached[count], after, after, onward[count])
            promises[count] = costs[count] + _promise(world, vehicle, k + 1, onward[count])
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


@compiled
def _traced(z_of, from_of, last):
    """Return the headings of the way that ends at one of the last places, shape (N, n)."""
    found, at = np.empty((len(z_of), z_of.shape[2])), last
    for k in range(len(z_of) - 1, -1, -1):
        found[k] = z_of[k, at]
        at = from_of[k, at]
    return found


@compiled
def scout(vehicle, world, start, first, ahead, beam, fine, swift):
    """Return the headings R_1 e1..R_N e1, shape (N, n), of the best way found, and whether one was.

    Args:
        vehicle: how it moves.
        world: what it moves in.
        start: position and velocity, shape (2, n).
        first: R_0 e1, shape (n,).
        ahead: the attitude's axis, shape (n,).
        beam: places that are kept at every step.
        fine: size of a cell.
        swift: size of a cell in velocities.
    """
    steps, n, moves = len(world.goals), len(first), len(vehicle.moves)
    z_of, from_of = np.zeros((steps, beam, n)), np.zeros((steps, beam), np.int64)
    y, z, unit = start.copy().reshape(1, 2, n), first.copy().reshape(1, n), ahead.copy()
    units, cost, room = unit.reshape(1, n), np.zeros(1), beam * moves
    made = (
        np.empty(room), np.empty(room), np.empty(room, np.int64), np.empty((room, 2, n)),
        np.empty((room, n)), np.empty((room, 2, n)),
    )  # fmt: skip
    for k in range(steps):
        count = _spread(vehicle, world, k, y, z, units, cost, made)
        if count == 0:
            return z_of[:, 0], False
        taken = _selected(made, count, beam, fine, swift)
        kept = len(taken)
        y, z, cost = made[3][taken], made[4][taken], made[1][taken]
        z_of[k, :kept], from_of[k, :kept] = z, made[2][taken]
        before, units = units, np.empty((kept, n))
        for b in range(kept):
            size = np.sqrt((z[b] * z[b]).sum())
            units[b] = z[b] / size if size > 1e-9 else before[from_of[k, b]]
    return _traced(z_of, from_of, np.argmin(cost)), True


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
