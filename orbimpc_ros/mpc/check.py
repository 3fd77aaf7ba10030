# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The independent check that every plan and command passes before it leaves.

It takes nothing over from how a plan was found: the inputs are rolled out from the measured state,
objective and constraints are evaluated anew at every step, the proof is held against the cost, and
rotations and command are held against the plan. Lengths are checked in proportion to what a step
moves the vehicle at most, everything else as it is.

Mathematics: docs/mathematics.md, 6.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, margin
from orbimpc_ros.mpc.kernels import compiled, entry_point
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import leaning, relief, strayed
from orbimpc_ros.mpc.problem.pace import entry_speed, first_change_is_decided

if TYPE_CHECKING:
    from orbimpc_ros.mpc.plan import Command, Plan

TOLERANCE = 1e-6  # on what constraints ask, of numbers of the order of one
ORTHOGONAL = 1e-9
RATE_TOLERANCE = 1e-6  # relative
SUMMING = 1e-9  # relative: two ways to add up the same objective
ROUNDING = 1e-15  # of the coordinates of places far from the origin


def violations(problem: Problem, state: State, goals: Array, plan: Plan) -> list[str]:
    """Return why a plan must not be published; empty if it may be.

    Args:
        problem: what was to be solved.
        state: where the vehicle was measured to be.
        goals: g_1..g_N, shape (N, n) [m].
        plan: to be checked.
    """
    return list(_flaws(problem, state, goals, plan))


def holds(problem: Problem, state: State, goals: Array, plan: Plan) -> bool:
    """Return whether a plan may be published: whether it has no :func:`violations`."""
    return next(_flaws(problem, state, goals, plan), None) is None


def prepare() -> None:
    """Compile, or load, what a check takes: at start-up, not in a tick."""
    _strayed(np.zeros(64), np.zeros(12), False, True, 2, 1, 1, 1)


def _flaws(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[str]:
    """Yield why a plan must not be published, what takes long to find out last."""
    strays = _strays(problem, state, plan)
    if not (strays.finite and math.isfinite(plan.objective)):
        yield 'plan is not finite'
        return
    yield from _dynamics_violations(problem, state, plan, strays)
    yield from _terminal_violations(problem, goals, plan)
    yield from _proof_violations(problem, state, goals, plan)
    yield from _rotation_violations(problem, state, plan, strays)
    yield from _limit_violations(problem, state, goals, plan)


class _Strays(NamedTuple):
    """How far a plan is from what it has to be.

    Attributes:
        finite: whether all of its numbers are.
        rotations: by how much they differ from a rollout of the inputs.
        positions: [m].
        velocities: [m/s].
        skewed: by how much Q_k'Q_k differ from the identity.
        mirrored: -det Q_k, where that is greatest.
        projected: by how much rotations differ from the projections that they claim to be.
    """

    finite: bool
    rotations: float
    positions: float
    velocities: float
    skewed: float
    mirrored: float
    projected: float


def _strays(problem: Problem, state: State, plan: Plan) -> _Strays:
    """Return how far a plan is from a rollout of its inputs, and its rotations from rotations."""
    first_rate, known = state.rotation_rate, 1
    if problem.rotation_order == 2 and state.coasted is not None:
        first_rate, known = (plan.rotations[1] - state.rotation) / problem.step, 2
    planned = plan.rotations, plan.projected, plan.inputs, plan.positions, plan.velocities
    start = state.rotation, first_rate, state.position, state.velocity, state.disturbance
    numbers = np.concatenate([each.ravel() for each in planned + start])
    once = step_of(problem.translation, problem.step, problem.forward)
    moved = *once.transition[0], *once.transition[-1], *once.push, *once.follow, *once.blow
    moves = np.array([problem.step, problem.forward, *moved])
    aligned = problem.dimension == 2 or plan.projection == 'thrust_aligned'
    sizes = problem.dimension, len(plan.inputs), problem.rotation_order, known
    found = _Strays(*_strayed(numbers, moves, problem.inertial, aligned, *sizes))
    if aligned or not found.finite:
        return found
    return found._replace(projected=max(found.projected, _improvable(plan, known)))


@compiled
def _worse(worst, error):
    """Return the greater of two errors; infinity where one is not a number."""
    return error if error > worst else worst if error <= worst else np.inf


@entry_point
def _strayed(numbers, moves, inertial, aligned, n, count, order, known):
    """Return what :class:`_Strays` has.

    Args:
        numbers: R_k, Q_k, k = 0..N, u_0..u_{N-1}, s_k, p_k; R_0, W_0, s_0, p_0 and w, one after
            another.
        moves: h, z, and the first and the last row of A, b, c and e of the model, one after
            another.
        inertial: whether the velocity is part of the state.
        aligned: whether projected rotations have thrust axes along R_k e1.
        n: dimension.
        count: N.
        order: of rotation.
        known: how many rotations are not projections.
    """
    square, line = (count + 1) * n * n, (count + 1) * n
    rotations = numbers[:square].reshape(count + 1, n, n)
    projected = numbers[square : 2 * square].reshape(count + 1, n, n)
    inputs = numbers[2 * square : 3 * square - n * n].reshape(count, n, n)
    at = 3 * square - n * n
    positions = numbers[at : at + line].reshape(count + 1, n)
    velocities = numbers[at + line : at + 2 * line].reshape(count + 1, n)
    start = numbers[at + 2 * line :]
    finite = np.isfinite(numbers).all()
    turned, moved, sped = _rolled_off(
        rotations, inputs, positions, velocities, start, moves, inertial, order
    )
    skewed, mirrored, stray = 0.0, -np.inf, 0.0
    for k in range(count + 1):
        q = projected[k]
        for i in range(n):
            for j in range(i + 1):
                inner = -1.0 if i == j else 0.0
                for c in range(n):
                    inner += q[c, i] * q[c, j]
                skewed = _worse(skewed, abs(inner))
        mirrored = _worse(mirrored, -_determinant(q))
        if k >= known:
            stray = _worse(stray, _off_projection(rotations[k], q, projected[k - 1], aligned))
    return finite, turned, moved, sped, skewed, mirrored, stray


@compiled
def _rolled_off(rotations, inputs, positions, velocities, start, moves, inertial, order):
    """Return by how much rotations, positions and velocities differ from a rollout of inputs."""
    n, step, forward = positions.shape[1], moves[0], moves[1]
    m = 2 if inertial else 1
    rolled, rate = start[: n * n].copy(), start[n * n : 2 * n * n].copy()
    rest = start[2 * n * n :]
    s, p, w = rest[:n].copy(), rest[n : 2 * n].copy(), rest[2 * n :]
    a, push, follow, blow = moves[2:], moves[2 + 2 * m :], moves[2 + 3 * m :], moves[2 + 4 * m :]
    turned, moved, sped = 0.0, 0.0, 0.0
    for k in range(len(positions)):
        for i in range(n):
            before = rolled[i * n]
            for j in range(n):
                c = i * n + j
                if k > 0:
                    rolled[c] += step * (inputs[k - 1, i, j] if order == 1 else rate[c])
                    rate[c] += step * inputs[k - 1, i, j]
                turned = _worse(turned, abs(rolled[c] - rotations[k, i, j]))
            after = rolled[i * n]
            if k > 0:
                s[i] += push[0] * before + follow[0] * after + blow[0] * w[i]
            if k > 0 and inertial:
                s[i] += a[1] * p[i]
                p[i] = a[3] * p[i] + push[1] * before + follow[1] * after + blow[1] * w[i]
            elif not inertial:
                p[i] = forward * after + w[i]
            moved = _worse(moved, abs(s[i] - positions[k, i]))
            sped = _worse(sped, abs(p[i] - velocities[k, i]))
    return turned, moved, sped


@compiled
def _determinant(q):
    """Return the determinant of a matrix, shape (n, n)."""
    if len(q) == 2:
        return q[0, 0] * q[1, 1] - q[0, 1] * q[1, 0]
    first = q[0, 0] * (q[1, 1] * q[2, 2] - q[1, 2] * q[2, 1])
    second = q[0, 1] * (q[1, 0] * q[2, 2] - q[1, 2] * q[2, 0])
    return first - second + q[0, 2] * (q[1, 0] * q[2, 1] - q[1, 1] * q[2, 0])


@compiled
def _off_projection(r, q, before, aligned):
    """Return how far a rotation Q is from the projection of R that it claims to be.

    Where R e1 vanishes, Q is the rotation before it. Else a thrust-aligned Q has its first axis on
    R e1, and M = Q'R is what no roll about it improves: M_23 = M_32, and M_22 + M_33 >= 0. For
    n = 2 the nearest Q is thrust-aligned.
    """
    n, size, stray = len(q), 0.0, 0.0
    for i in range(n):
        size += r[i, 0] * r[i, 0]
    size = np.sqrt(size)
    if size < HEADING_UNDEFINED:
        for i in range(n):
            for j in range(n):
                stray = _worse(stray, abs(q[i, j] - before[i, j]))
        return stray
    for i in range(n if aligned else 0):
        stray = _worse(stray, abs(r[i, 0] - size * q[i, 0]))
    if n == 2 or not aligned:
        return stray
    twist, gain = 0.0, 0.0
    for c in range(n):
        twist += q[c, 1] * r[c, 2] - q[c, 2] * r[c, 1]
        gain += q[c, 1] * r[c, 1] + q[c, 2] * r[c, 2]
    return _worse(_worse(stray, abs(twist)), -gain)


def _improvable(plan: Plan, known: int) -> float:
    """Return by how much rotations Q_k, k >= known, miss to be the nearest ones in space.

    The nearest Q makes M = Q'R symmetric, with no two eigenvalues that add up to less than 0 (the
    optimality conditions of Wahba's problem).
    """
    r, q = plan.rotations[known:], plan.projected[known:]
    free = _sizes(r[:, :, 0]) >= HEADING_UNDEFINED
    m = np.swapaxes(q[free], -1, -2) @ r[free]
    transposed = np.swapaxes(m, -1, -2)
    pairs = np.linalg.eigvalsh(0.5 * (m + transposed))[:, :2].sum(axis=1)
    return max(float(np.abs(m - transposed).max(initial=0.0)), float(-pairs.min(initial=np.inf)))


# --- dynamics


def _dynamics_violations(
    problem: Problem, state: State, plan: Plan, strays: _Strays
) -> Iterator[str]:
    if problem.rotation_order == 2 and state.coasted is not None:
        yield from _coasting_violations(problem, state.coasted, plan)
    length = _length_tolerance(problem, state)
    for name, error, allowed in (
        ('rotations', strays.rotations, TOLERANCE),
        ('positions', strays.positions, length),
        ('velocities', strays.velocities, length / problem.step),
    ):
        if error > allowed:
            yield f'{name} differ by {error:.2g} from a rollout of the inputs'


def _coasting_violations(problem: Problem, coasted: Array, plan: Plan) -> Iterator[str]:
    fraction = float(np.sum(plan.rotations[1] * coasted)) / problem.dimension
    stray = np.abs(plan.rotations[1] - fraction * coasted).max()
    if stray > TOLERANCE:
        yield f'R_1 strays {stray:.2g} from where the body rate carries it'
    if fraction < -TOLERANCE:
        yield f'R_1 thrusts backwards by {-fraction:.2g}'


def _length_tolerance(problem: Problem, state: State) -> float:
    """Return by how much positions may be off [m]."""
    farthest = max(map(abs, state.position.tolist()))
    return TOLERANCE * problem.length_unit + ROUNDING * farthest


# --- limits


def margins(problem: Problem, state: State, goals: Array, plan: Plan) -> dict[str, float]:
    """Return how far inside of each limit a plan stays at its closest, negative outside.

    Args:
        problem: gives the limits.
        state: that the plan starts from, with the hazards.
        goals: g_1..g_N, shape (N, n) [m].
        plan: to be judged.

    Returns:
        Shares of full speed or thrust for ``hull``, ``floor``, ``max_acceleration`` (in a step),
        ``approach`` and ``tilt``; for ``max_rate`` the turn of a step [rad] with a floor, and a
        share of full speed without; for obstacles, hazards and ``glide_slope`` lengths [m].
    """
    return {name: least for name, (least, _) in _limits(problem, state, goals, plan).items()}


def _limit_violations(problem: Problem, state: State, goals: Array, plan: Plan) -> list[str]:
    limits = _limits(problem, state, goals, plan)
    return [f'{name} violated by {-m:.2g}' for name, (m, most) in limits.items() if m < -most]


def _limits(
    problem: Problem, state: State, goals: Array, plan: Plan
) -> dict[str, tuple[float, float]]:
    """Return the least margin to each limit, and by how much it may be missed."""
    rotations, length = plan.rotations, _length_tolerance(problem, state)
    shares: dict[str, Any] = {'hull': margin(rotations[1:])}
    lengths: dict[str, Any] = {}
    if problem.floor.exists:
        shares['floor'] = problem.floor.margin(rotations[1:, :, 0])
    if problem.max_rate > 0.0:
        shares['max_rate'] = turn_margin(problem, state, rotations)
    if problem.max_acceleration > 0.0:
        shares['max_acceleration'] = speed_margin(problem, state, rotations)
    if problem.approach.exists:
        shares['approach'] = approach_margin(problem, state, rotations[-1, :, 0])
    if problem.has_cones:
        tilt, slope = cone_margins(problem, state, goals, plan)
        shares |= {'tilt': tilt} if problem.tilt else {}
        lengths |= {'glide_slope': slope} if problem.glide_slope else {}
    if problem.boxes:
        lengths['obstacle'] = obstacle_margin(problem, plan.positions)
    if problem.obstacles or state.hazards:
        lengths |= clearances(problem, state, plan)
    found = {name: (float(np.min(each)), TOLERANCE) for name, each in shares.items()}
    return found | {name: (float(np.min(each)), length) for name, each in lengths.items()}


def cone_margins(problem: Problem, state: State, goals: Array, plan: Plan) -> tuple[Array, Array]:
    """Return how far inside of what is demanded of them R_k e1 and s_k are, shape (N,) each.

    Args:
        problem: gives the cones.
        state: says how far outside they may be, if it is itself.
        goals: g_1..g_N, shape (N, 3) [m].
        plan: gives rotations and positions.
    """
    eased = relief(problem, state, goals)
    headings, away = plan.rotations[1:, :, 0], plan.positions[1:] - goals
    return eased.tilt - leaning(problem, headings), eased.slope - strayed(problem, away)


def approach_margin(problem: Problem, state: State, heading: Array) -> float:
    """Return how far inside of the cone of approach a last heading R_N e1, shape (n,), is."""
    approach, size = problem.approach, math.sqrt(heading @ heading)
    demanded = math.cos(approach.cone) * max(size, problem.least_heading)
    return float(heading @ approach.axis(state)) - demanded


def turn_margin(problem: Problem, state: State, rotations: Array) -> Array:
    """Return how far the turns of R_0..R_N, shape (N + 1, n, n), stay below the limit, shape (N,).

    With a floor as angles [rad]: h omega less that from R_k e1 to R_{k+1} e1, the first one from
    the measured axis; it counts as zero where the state has decided it. Without a floor as chords:
    2 sin(h omega / 2) less |R_{k+1} e1 - R_k e1|.
    """
    if problem.max_rate == 0.0:
        return np.full(len(rotations) - 1, np.inf)
    headings, turn = rotations[:, :, 0], problem.step * problem.max_rate
    if not problem.floor.exists:
        return 2.0 * math.sin(0.5 * turn) - _sizes(np.diff(headings, axis=0))
    units = headings / np.maximum(_sizes(headings), HEADING_UNDEFINED)[:, None]
    units[0] = state.attitude[:, 0]
    before, after = units[:-1], units[1:]
    angles: Array = 2.0 * np.arctan2(_sizes(after - before), _sizes(after + before))
    if problem.first_turn_is_decided:
        angles[0] = 0.0
    return turn - angles


def speed_margin(problem: Problem, state: State, rotations: Array) -> Array:
    """Return how far the changes of |R_k e1| stay below the limit, shape (N,).

    h max_acceleration / z less ||R_{k+1} e1| - |R_k e1||, the first one from the speed that changes
    count from; it counts as zero where the state has decided it.

    Args:
        problem: gives the limit.
        state: says what the first change counts from.
        rotations: R_0..R_N, shape (N + 1, n, n).
    """
    speeds = _sizes(rotations[:, :, 0])
    speeds[0] = entry_speed(problem, state)
    changes = np.abs(np.diff(speeds))
    if first_change_is_decided(problem, state):
        changes[0] = 0.0
    return np.asarray(problem.speed_change - changes)


def obstacle_margin(problem: Problem, positions: Array) -> float:
    """Return how far s_1..s_N stay outside every box, negative inside [m].

    Args:
        problem: gives the boxes.
        positions: s_0..s_N, shape (N + 1, n) [m].

    With ``no_corner_cutting`` also how far consecutive points clear a face that they share.
    """
    least = np.inf
    for box in problem.boxes:
        outside = box.clearances(positions)
        least = min(least, outside[1:].max(axis=1).min())
        if problem.no_corner_cutting and len(positions) > 2:
            shared = np.minimum(outside[1:-1], outside[2:]).max(axis=1)
            least = min(least, shared.min())
    return float(least)


def _terminal_violations(problem: Problem, goals: Array, plan: Plan) -> list[str]:
    if problem.terminal != 'constraint':
        return []
    miss = float(np.abs(plan.positions[-1] - goals[-1]).max())
    if problem.inertial:
        miss = max(miss, problem.step * float(np.abs(plan.velocities[-1]).max()))
    allowed = TOLERANCE * problem.length_unit + ROUNDING * float(np.abs(goals[-1]).max())
    return [f'terminal constraint missed by {miss:.2g}'] if miss > allowed else []


# --- proof


def _proof_violations(problem: Problem, state: State, goals: Array, plan: Plan) -> list[str]:
    cost = _objective(problem, state, goals, plan)
    # What is allowed must be finite: an overflow would excuse anything.
    if not abs(plan.objective - cost) <= SUMMING * cost < math.inf:
        return [f'the objective is {cost:.6g}, not {plan.objective:.6g}']
    # What constraints may be missed by can save as much of the cost.
    excess = plan.proof.lower_bound - cost
    if not excess <= TOLERANCE * (cost + plan.proof.cost_unit) < math.inf:
        return [f'the lower bound exceeds the cost of {cost:.6g} by {excess:.2g}']
    return []


def _objective(problem: Problem, state: State, goals: Array, plan: Plan) -> float:
    """Return the cost of a plan, equation by equation: every term is >= 0, so nothing cancels."""
    w, h = problem.weights, problem.step
    misses, inputs = plan.positions[1:] - goals, plan.inputs.ravel()
    cost = w.position * np.vdot(misses, misses) + w.input * (inputs @ inputs)
    cost += (w.terminal + problem.arrival_weight) * (misses[-1] @ misses[-1])
    if w.length > 0.0:
        cost += w.length * h * problem.forward * _flown(problem, plan)
    if problem.inertial:
        cost += problem.arrival_weight * h * h * np.sum(plan.velocities[-1] ** 2)
    if w.attitude > 0.0:
        cost += w.attitude * np.sum((plan.rotations[-1] - state.wanted) ** 2)
    return float(cost)


def _flown(problem: Problem, plan: Plan) -> float:
    """Return the steps' speed fractions, added up: at their begin, or in the middle of a chord."""
    sizes = _sizes(plan.rotations[:, :, 0])
    _, push, follow, _ = step_of(problem.translation, problem.step, problem.forward)
    late = float(follow[-1] / (push[-1] + follow[-1]))
    return float((1.0 - late) * sizes[:-1].sum() + late * sizes[1:].sum())


# --- rotations and command


def _rotation_violations(
    problem: Problem, state: State, plan: Plan, strays: _Strays
) -> Iterator[str]:
    if strays.skewed > ORTHOGONAL:
        yield 'a projected rotation is not orthogonal'
        return
    if strays.mirrored > 0.0:
        yield 'a projected rotation has not determinant +1'
        return
    if np.abs(plan.projected[0] - state.attitude).max() > ORTHOGONAL:
        yield 'the first rotation is not the measured attitude'
    coasted = state.coasted if problem.rotation_order == 2 else None
    if coasted is not None and np.abs(plan.projected[1] - coasted).max() > ORTHOGONAL:
        yield 'the second rotation is not where the body rate carries the first'
    if strays.projected > TOLERANCE:
        yield f'a projected rotation strays {strays.projected:.2g} from its projection'


def _sizes(vectors: Array) -> Array:
    """Return the lengths, shape (K,), of vectors, shape (K, n)."""
    return np.sqrt(np.einsum('kc,kc->k', vectors, vectors))


def command_violations(
    problem: Problem, plan: Plan, command: Command, entry: float = 0.0
) -> list[str]:
    """Return why a command is not that of a plan's first step; empty if it is.

    The speed must be that of R_1; without a floor, what of it is along the axis commanded, yet no
    slower than ``max_acceleration`` allows. The rotation must be where the rate leads in a step,
    and that must be as far on the way to the planned rotation as ``max_rate`` allows.

    Args:
        problem: gives the limits.
        plan: whose first step is commanded.
        command: to be checked.
        entry: share of full speed that changes of speed count from.
    """
    parts = (command.speed_fraction, command.body_rate, command.rotation)
    if not all(np.isfinite(part).all() for part in parts):
        return ['command is not finite']
    found = []
    first = problem.rotation_order - 1
    start, end = plan.projected[first], plan.projected[min(first + 1, plan.horizon)]
    planned = plan.speed_fraction[1]
    if problem.rotation_order == 1 and problem.max_rate and not problem.floor.exists:
        slowest = entry - problem.speed_change
        along = planned * max(0.0, command.rotation[:, 0] @ end[:, 0])
        planned = max(along, min(planned, slowest))
    if abs(command.speed_fraction - planned) > TOLERANCE:
        found.append('the commanded speed is not that of the plan')
    turned = start @ _rotation_by(problem.step * command.body_rate)
    if np.abs(turned - command.rotation).max() > ORTHOGONAL:
        found.append('the commanded rotation is not where the commanded rate leads')
    left, whole = _angle_between(command.rotation, end), _angle_between(start, end)
    allowed = problem.step * (problem.max_rate or math.inf)
    if abs(left - max(0.0, whole - allowed)) > TOLERANCE:
        found.append(f'the commanded rotation is {left:.2g} rad from that of the plan')
    return found


def _angle_between(a: Array, b: Array) -> float:
    """Return the angle of the rotation from one to the other [rad], from |a - b|_F."""
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(a - b)) / math.sqrt(8.0)))


def _rotation_by(turn: Array) -> Array:
    """Return the rotation by a vector, shape (1,) or (3,) [rad], after Rodrigues."""
    if len(turn) == 1:
        c, s = math.cos(turn[0]), math.sin(turn[0])
        return np.array([[c, -s], [s, c]])
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = math.sqrt(x * x + y * y + z * z)
    half = np.sinc(0.5 * angle / math.pi)
    return np.eye(3) + np.sinc(angle / math.pi) * cross + 0.5 * half * half * cross @ cross


def flaw(
    problem: Problem, command: Command, *, stopping: bool = False, entry: float | None = None
) -> str:
    """Return why a command must not be sent, whatever it came from; empty if it may be.

    The last look before a vehicle gets it: finite, a share of full speed and not below the floor,
    a rate below the limit (without one, below half a turn in a step), a speed that is not changed
    faster than it may be, and a rotation.

    A stop that was asked for (``stopping``) is forbidden by no floor and no limit of the change of
    speed, which counts from the ``entry`` share of full speed; None if that is not known.
    """
    fraction = command.speed_fraction
    rate, rotation = command.body_rate.tolist(), command.rotation
    if not (all(map(math.isfinite, (fraction, *rate))) and np.isfinite(rotation).all()):
        return 'the command is not finite'
    if not 0.0 <= fraction <= 1.0:
        return f'a speed fraction of {fraction:.6g} is not in [0, 1]'
    floor = problem.least_speed
    if not stopping and fraction < floor:
        return f'a speed fraction of {fraction:.6g} is below the floor of {floor:.6g}'
    changed = abs(fraction - entry) if entry is not None and not stopping else 0.0
    if changed > problem.speed_change + TOLERANCE:
        most = f'{problem.speed_change:.6g} in a step'
        return f'a speed fraction changed by {changed:.6g} is beyond {most}'
    largest = problem.max_rate or math.pi / problem.step
    if math.hypot(*rate) > largest * (1.0 + RATE_TOLERANCE):
        return f'a body rate of {math.hypot(*rate):.6g} rad/s is beyond {largest:.6g}'
    error = np.abs(rotation.T @ rotation - np.eye(len(rotation))).max()
    if error > ORTHOGONAL or np.linalg.det(rotation) < 0.0:
        return 'the commanded rotation is not a rotation'
    return ''
