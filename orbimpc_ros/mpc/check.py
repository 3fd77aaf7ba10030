# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The independent check that every plan and command must pass before it is published.

It uses no result of the search: headings are rolled out from the measured state, objective and
constraints are evaluated anew at every step, the lower bound is compared with the cost, and
rotations and command with the plan. The tolerance of lengths is in units of a step's length, all
others are absolute. ``state`` is as measured, ``goals`` are g_1..g_N, shape (N, n) [m].

Mathematics: docs/mathematics.md, 6.2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, margin
from orbimpc_ros.mpc.model.dynamics import Trajectory
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import leaning, relief, strayed
from orbimpc_ros.mpc.problem.reach import entry_speed, first_change_is_decided

if TYPE_CHECKING:
    from orbimpc_ros.mpc.plan import Command, Plan

TOLERANCE = 1e-6  # of constraints, for numbers of the order of one
ORTHOGONAL = 1e-9
RATE_TOLERANCE = 1e-6  # relative
SUMMING = 1e-9  # relative: between two summations of the same objective
ROUNDING = 1e-15  # relative: of coordinates far from the origin
SHARES = 'hull', 'floor', 'max_rate', 'max_acceleration', 'approach', 'tilt'


def violations(problem: Problem, state: State, goals: Array, plan: Plan) -> list[str]:
    """Return why a plan must not be published; empty if it may be."""
    return list(_flaws(problem, state, goals, plan))


def holds(problem: Problem, state: State, goals: Array, plan: Plan) -> bool:
    """Return True if a plan may be published: if it has no :func:`violations`."""
    return next(_flaws(problem, state, goals, plan), None) is None


def _flaws(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[str]:
    """Yield the reasons why a plan must not be published; the slowest checks are last."""
    parts = plan.rotations, plan.projected, plan.positions, plan.velocities
    if not (math.isfinite(plan.objective) and np.isfinite(np.concatenate(parts, axis=None)).all()):
        yield 'plan is not finite'
        return
    yield from _dynamics_violations(problem, state, plan)
    yield from terminal_violations(problem, goals, plan)
    yield from _proof_violations(problem, state, goals, plan)
    yield from _rotation_violations(problem, state, plan)
    length = _length_tolerance(problem, state.position)
    for name, least in margins(problem, state, goals, plan).items():
        if least < -(TOLERANCE if name in SHARES else length):
            yield f'{name} violated by {-least:.2g}'


# --- dynamics


def _dynamics_violations(problem: Problem, state: State, plan: Plan) -> Iterator[str]:
    decided, length = [state.rotation], _length_tolerance(problem, state.position)
    if problem.rotation_order == 2:
        if state.coasted is None:
            decided.append(state.rotation + problem.step * state.rotation_rate)
        else:
            yield from _coasting_violations(problem, state.coasted, plan)
    positions, velocities = _rolled_out(problem, state, plan.rotations[:, :, 0])
    for name, rolled, planned, allowed in (
        ('rotations', np.array(decided), plan.rotations[: len(decided)], TOLERANCE),
        ('positions', positions, plan.positions, length),
        ('velocities', velocities, plan.velocities, length / problem.step),
    ):
        error = np.abs(rolled - planned).max()
        if not error <= allowed:  # true for NaN, too, after an overflow
            yield f'{name} differ by {error:.2g} from a rollout of the measured state'


def _rolled_out(problem: Problem, state: State, headings: Array) -> tuple[Array, Array]:
    """Return s_0..s_N and p_0..p_N from a rollout of headings R_0 e1..R_N e1."""
    once = step_of(problem.translation, problem.step, problem.forward)
    push, follow, blow = (each[:, None, None] for each in once[1:])
    moved, *sped = push * headings[:-1] + follow * headings[1:] + blow * state.disturbance
    if problem.inertial:
        (_, lasts), (_, kept) = once.transition
        velocities = [state.velocity]
        for more in sped[0]:
            velocities.append(kept * velocities[-1] + more)
        rolled = np.array(velocities)
        moved += lasts * rolled[:-1]
    else:
        rolled = problem.forward * headings + state.disturbance
    return np.concatenate([state.position[None], moved]).cumsum(axis=0), rolled


def _coasting_violations(problem: Problem, coasted: Array, plan: Plan) -> Iterator[str]:
    fraction = float(np.sum(plan.rotations[1] * coasted)) / problem.dimension
    stray = np.abs(plan.rotations[1] - fraction * coasted).max()
    if stray > TOLERANCE:
        yield f'R_1 strays {stray:.2g} from the rotation at the measured body rate'
    if fraction < -TOLERANCE:
        yield f'R_1 thrusts backwards by {-fraction:.2g}'


def _length_tolerance(problem: Problem, place: Array) -> float:
    """Return the tolerance of positions near a place, shape (n,) [m]."""
    return TOLERANCE * problem.maps.unit + ROUNDING * max(map(abs, place.tolist()))


# --- limits


def margins(problem: Problem, state: State, goals: Array, plan: Plan) -> dict[str, float]:
    """Return the least margin of a plan to each limit, negative outside.

    They are shares of full speed or thrust for ``hull``, ``floor``, ``max_acceleration`` (in a
    step), ``approach`` and ``tilt``; for ``max_rate`` an angle in a step [rad] with a floor, and a
    share of full speed without; for obstacles, hazards and ``glide_slope`` lengths [m].
    """
    steps = step_margins(problem, state, goals, plan.rotations[:, :, 0], plan.positions[1:])
    least = {name: float(each.min()) for name, each in steps.items()}
    least['hull'] = float(margin(plan.rotations[1:]).min())
    if problem.boxes:
        least['obstacle'] = obstacle_margin(problem, plan.positions)
    if problem.obstacles or state.hazards:
        least |= clearances(problem, state, plan)
    return least


def step_margins(
    problem: Problem, state: State, goals: Array, headings: Array, places: Array
) -> dict[str, Array]:
    """Return the margins of single steps to all limits but hull and bodies, as :func:`margins`.

    Those of R_0 e1..R_N e1, shape (..., N + 1, n), and s_1..s_N, shape (..., N, n) [m], have shape
    (..., N); those to ``approach`` are of the last step, see :func:`approach_margin`.
    """
    by_limit, turned = dict[str, Array](), headings[..., 1:, :]
    if problem.floor.exists:
        outward = problem.floor_normals
        above = _sizes(turned) if outward is None else (turned @ outward.T).max(axis=-1)
        by_limit['floor'] = above - problem.floor.fraction
    if problem.max_rate:
        by_limit['max_rate'] = turn_margin(problem, state, headings)
    if problem.max_acceleration:
        by_limit['max_acceleration'] = speed_margin(problem, state, headings)
    if problem.approach.exists:
        by_limit['approach'] = approach_margin(problem, state, headings[..., -1, :])
    if problem.tilt or problem.glide_slope:
        eased = relief(problem, state, goals)
        if problem.tilt:
            by_limit['tilt'] = eased.tilt - leaning(problem, turned)
        if problem.glide_slope:
            by_limit['glide_slope'] = eased.slope - strayed(problem, places - goals)
    return by_limit


def approach_margin(problem: Problem, state: State, heading: Array) -> Array:
    """Return the margins of last headings R_N e1, shape (..., n), inside the cone of approach.

    They are to its sides and to its flat end, which are smooth, shape (..., 2).
    """
    sizes = _sizes(heading)
    lengths = np.stack([sizes, np.full_like(sizes, problem.least_heading)], axis=-1)
    ahead = heading @ problem.approach.axis(state)
    return np.asarray(ahead[..., None] - math.cos(problem.approach.cone) * lengths)


def turn_margin(problem: Problem, state: State, headings: Array) -> Array:
    """Return the margins of turns between headings, (..., N + 1, n), to the limit, (..., N).

    With a floor they are angles [rad]: h omega minus the angle from R_k e1 to R_{k+1} e1, the first
    one from the measured axis; a first turn that the state decides counts as zero. Without a floor
    they are chords: 2 sin(h omega / 2) - |R_{k+1} e1 - R_k e1|.
    """
    turn = problem.step * problem.max_rate
    if not problem.floor.exists:
        return np.asarray(2.0 * math.sin(0.5 * turn) - _sizes(np.diff(headings, axis=-2)))
    units = headings / np.maximum(_sizes(headings), HEADING_UNDEFINED)[..., None]
    units[..., 0, :] = state.attitude[:, 0]
    before, after = units[..., :-1, :], units[..., 1:, :]
    angles = 2.0 * np.arctan2(_sizes(after - before), _sizes(after + before))
    if problem.rotation_order == 2:
        angles[..., 0] = 0.0
    return np.asarray(turn - angles)


def speed_margin(problem: Problem, state: State, headings: Array) -> Array:
    """Return the margins of changes of the size of headings, (..., N + 1, n), (..., N).

    They are h max_acceleration / z - ||R_{k+1} e1| - |R_k e1||, the first change being counted from
    the entry speed; a first change that the state decides counts as zero.
    """
    speeds = _sizes(headings)
    speeds[..., 0] = entry_speed(problem, state)
    changes = np.abs(np.diff(speeds))
    if first_change_is_decided(problem, state):
        changes[..., 0] = 0.0
    return np.asarray(problem.speed_change - changes)


def obstacle_margin(problem: Problem, positions: Array) -> float:
    """Return the least clearance of s_1..s_N from all boxes [m], for s_0..s_N, shape (N + 1, n).

    With ``no_corner_cutting`` consecutive points must be clear of a common face.
    """
    outside = np.array([box.clearances(positions[1:]) for box in problem.boxes])
    if problem.no_corner_cutting and len(positions) > 2:
        outside = np.minimum(outside[:, :-1], outside[:, 1:])
    return float(outside.max(axis=2).min())


def terminal_violations(problem: Problem, goals: Array, plan: Trajectory) -> list[str]:
    """Return the violation of a terminal constraint by a plan or its rollout, if any."""
    if problem.terminal != 'constraint':
        return []
    miss = float(np.abs(plan.positions[-1] - goals[-1]).max())
    if problem.inertial:
        miss = max(miss, problem.step * float(np.abs(plan.velocities[-1]).max()))
    missed = miss > _length_tolerance(problem, goals[-1])
    return [f'terminal constraint missed by {miss:.2g}'] if missed else []


# --- proof


def _proof_violations(problem: Problem, state: State, goals: Array, plan: Plan) -> list[str]:
    cost = _objective(problem, state, goals, plan)
    # The tolerance must be finite: after an overflow it would accept anything.
    if not abs(plan.objective - cost) <= SUMMING * cost < math.inf:
        return [f'the objective is {cost:.6g}, not {plan.objective:.6g}']
    # Violations within the tolerance can reduce the cost by as much.
    excess = plan.proof.lower_bound - cost
    if not excess <= TOLERANCE * (cost + plan.proof.cost_unit) < math.inf:
        return [f'the lower bound exceeds the cost of {cost:.6g} by {excess:.2g}']
    return []


def _objective(problem: Problem, state: State, goals: Array, plan: Plan) -> float:
    """Return the cost of a plan, term by term: every term is >= 0, so nothing cancels."""
    w, h = problem.weights, problem.step
    misses, order = plan.positions[1:] - goals, problem.rotation_order
    inputs = np.diff(plan.rotations, order, axis=0) / h**order  # rounded once: it may vanish
    cost = w.position * np.vdot(misses, misses) + w.input * np.vdot(inputs, inputs)
    cost += (w.terminal + problem.arrival_weight) * (misses[-1] @ misses[-1])
    if w.length > 0.0:
        cost += w.length * h * problem.forward * _flown(problem, plan)
    if problem.inertial:
        cost += problem.arrival_weight * h * h * np.sum(plan.velocities[-1] ** 2)
    if w.attitude > 0.0:
        cost += w.attitude * np.sum((plan.rotations[-1] - state.wanted) ** 2)
    return float(cost)


def _flown(problem: Problem, plan: Plan) -> float:
    """Return the sum of the steps' speed fractions: at their start, or for chords at both ends."""
    sizes = _sizes(plan.rotations[:, :, 0])
    _, push, follow, _ = step_of(problem.translation, problem.step, problem.forward)
    late = float(follow[-1] / (push[-1] + follow[-1]))
    return float((1.0 - late) * sizes[:-1].sum() + late * sizes[1:].sum())


# --- rotations and command


def _rotation_violations(problem: Problem, state: State, plan: Plan) -> Iterator[str]:
    turned = plan.projected
    skewed = np.swapaxes(turned, 1, 2) @ turned - np.eye(problem.dimension)
    if np.abs(skewed).max() > ORTHOGONAL:
        yield 'a projected rotation is not orthogonal'
        return
    if np.linalg.det(turned).min() < 0.0:
        yield 'a projected rotation does not have determinant +1'
        return
    if np.abs(turned[0] - state.attitude).max() > ORTHOGONAL:
        yield 'the first rotation is not the measured attitude'
    coasted = state.coasted if problem.rotation_order == 2 else None
    if coasted is not None and np.abs(turned[1] - coasted).max() > ORTHOGONAL:
        yield 'the second rotation is not the first turned at the body rate'
    stray = _off_projection(plan, 1 if coasted is None else 2)
    if stray > TOLERANCE:
        yield f'a projected rotation strays {stray:.2g} from its projection'


def _off_projection(plan: Plan, first: int) -> float:
    """Return the largest error of Q_k, k >= first, as projections of R_k.

    If R e1 vanishes, Q is the rotation before it. In the plane R = |R e1| Q. Otherwise a
    thrust-aligned Q in space has its first axis on R e1, and M = Q'R cannot be improved by a roll
    about it: M_23 = M_32, and M_22 + M_33 >= 0. The nearest Q makes M symmetric, with no two
    eigenvalues whose sum is negative (the optimality conditions of Wahba's problem).
    """
    r, q, before = plan.rotations[first:], plan.projected[first:], plan.projected[first - 1 : -1]
    sizes, plane = _sizes(r[:, :, 0]), r.shape[-1] == 2
    held = sizes < HEADING_UNDEFINED
    strays = [np.abs(sizes[:, None, None] * q - r)] if plane else []
    if held.any():
        strays.append(np.abs(q - before)[held])
        r, q, sizes = r[~held], q[~held], sizes[~held]
    if not plane and plan.projection == 'thrust_aligned':
        strays.append(np.abs(sizes[:, None] * q[:, :, 0] - r[:, :, 0]))
    if not plane:
        m = np.swapaxes(q, 1, 2) @ r
        m = m[:, 1:, 1:] if plan.projection == 'thrust_aligned' else m
        transposed, least = np.swapaxes(m, 1, 2), np.einsum('kcc->k', m)
        if m.shape[2] == 3:  # the sum of two eigenvalues is least without the largest
            least = least - np.linalg.eigvalsh(0.5 * (m + transposed))[:, 2]
        strays += [np.abs(m - transposed), -least]
    return max(float(each.max(initial=0.0)) for each in strays)


def _sizes(vectors: Array) -> Array:
    """Return the lengths, shape (...,), of vectors, shape (..., n)."""
    return np.asarray(np.sqrt(np.einsum('...c,...c->...', vectors, vectors)))


def command_violations(
    problem: Problem, plan: Plan, command: Command, entry: float = 0.0
) -> list[str]:
    """Return why a command is not that of a plan's first step; empty if it is.

    The speed must be that of R_1 or, without a floor, its component along the commanded axis, but
    no slower than ``max_acceleration`` allows. The rotation must be the one that the rate leads to
    in a step, and as close to the planned rotation as ``max_rate`` allows. The first change of
    speed starts from the ``entry`` share of full speed.
    """
    parts = (command.speed_fraction, command.body_rate, command.rotation)
    if not all(np.isfinite(part).all() for part in parts):
        return ['command is not finite']
    flaws = []
    first = problem.rotation_order - 1
    start, end = plan.projected[first], plan.projected[min(first + 1, plan.horizon)]
    planned = plan.speed_fraction[1]
    if problem.rotation_order == 1 and problem.max_rate and not problem.floor.exists:
        slowest = entry - problem.speed_change
        along = planned * max(0.0, command.rotation[:, 0] @ end[:, 0])
        planned = max(along, min(planned, slowest))
    if abs(command.speed_fraction - planned) > TOLERANCE:
        flaws.append('the commanded speed is not that of the plan')
    turned = start @ _rotation_by(problem.step * command.body_rate)
    if np.abs(turned - command.rotation).max() > ORTHOGONAL:
        flaws.append('the commanded rotation does not match the commanded rate')
    left, needed = _angle_between(command.rotation, end), _angle_between(start, end)
    allowed = problem.step * (problem.max_rate or math.inf)
    if abs(left - max(0.0, needed - allowed)) > TOLERANCE:
        flaws.append(f'the commanded rotation is {left:.2g} rad from that of the plan')
    return flaws


def _angle_between(a: Array, b: Array) -> float:
    """Return the angle of the rotation between two others [rad], from |a - b|_F."""
    return 2.0 * math.asin(min(1.0, float(np.linalg.norm(a - b)) / math.sqrt(8.0)))


def _rotation_by(turn: Array) -> Array:
    """Return the rotation by a vector, shape (1,) or (3,) [rad], by Rodrigues' formula.

    The map that commands are made with is not used to check them.
    """
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
    """Return why a command must not be sent, whatever its origin; empty if it may be.

    This is the last check before a vehicle gets it. All numbers must be finite; the speed a share
    of full speed, not below the floor and not changed too fast; the rate below the limit (without
    one, below half a turn in a step); and the rotation a rotation.

    A requested stop (``stopping``) is exempt from the floor and from the limit of the change of
    speed, which is measured from the ``entry`` share of full speed, None if unknown.
    """
    fraction = command.speed_fraction
    rate, rotation = command.body_rate.tolist(), command.rotation
    if not (all(map(math.isfinite, (fraction, *rate))) and np.isfinite(rotation).all()):
        return 'the command is not finite'
    if not 0.0 <= fraction <= 1.0:
        return f'a speed fraction of {fraction:.6g} is not in [0, 1]'
    largest = problem.max_rate or math.pi / problem.step
    if math.hypot(*rate) > largest * (1.0 + RATE_TOLERANCE):
        return f'a body rate of {math.hypot(*rate):.6g} rad/s is beyond {largest:.6g}'
    error = np.abs(rotation.T @ rotation - np.eye(len(rotation))).max()
    if error > ORTHOGONAL or np.linalg.det(rotation) < 0.0:
        return 'the commanded rotation is not a rotation'
    return '' if stopping else _speed_flaw(problem, fraction, entry)


def _speed_flaw(problem: Problem, fraction: float, entry: float | None) -> str:
    floor = problem.least_speed
    if fraction < floor:
        return f'a speed fraction of {fraction:.6g} is below the floor of {floor:.6g}'
    changed = 0.0 if entry is None else abs(fraction - entry)
    if changed > problem.speed_change + TOLERANCE:
        most = f'{problem.speed_change:.6g} in a step'
        return f'the speed fraction changes by {changed:.6g}, more than {most}'
    return ''
