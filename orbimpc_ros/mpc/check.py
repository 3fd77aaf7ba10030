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
from typing import TYPE_CHECKING, Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.geometry.orbitopes import margin
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.model.translation import Step, step_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import leaning, relief, strayed
from orbimpc_ros.mpc.problem.pace import entry_speed, first_change_is_decided

if TYPE_CHECKING:
    from orbimpc_ros.mpc.command import Command
    from orbimpc_ros.mpc.plan import Plan

TOLERANCE = 1e-6  # on what constraints ask, of numbers of the order of one
ORTHOGONAL = 1e-9
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


def _flaws(problem: Problem, state: State, goals: Array, plan: Plan) -> Iterator[str]:
    """Yield why a plan must not be published, what takes long to find out last."""
    arrays = (plan.positions, plan.velocities, plan.rotations, plan.inputs, plan.projected)
    numbers = np.concatenate([array.ravel() for array in arrays])
    if not (np.isfinite(numbers).all() and math.isfinite(plan.objective)):
        yield 'plan is not finite'
        return
    yield from _dynamics_violations(problem, state, plan)
    yield from _terminal_violations(problem, goals, plan)
    yield from _proof_violations(problem, state, goals, plan)
    yield from _rotation_violations(problem, state, plan)
    yield from _limit_violations(problem, state, goals, plan)


# --- dynamics


def _dynamics_violations(problem: Problem, state: State, plan: Plan) -> list[str]:
    found, first_rate = [], state.rotation_rate
    if problem.rotation_order == 2 and state.coasted is not None:
        found = _coasting_violations(problem, state.coasted, plan)
        first_rate = (plan.rotations[1] - state.rotation) / problem.step
    length = _length_tolerance(problem, state)
    rolled = _rollout(problem, state, first_rate, plan.inputs)
    for name, again, planned, allowed in zip(
        ('rotations', 'positions', 'velocities'),
        rolled,
        (plan.rotations, plan.positions, plan.velocities),
        (TOLERANCE, length, length / problem.step),
        strict=True,
    ):
        error = np.abs(again - planned).max()
        if error > allowed:
            found.append(f'{name} differ by {error:.2g} from a rollout of the inputs')
    return found


def _coasting_violations(problem: Problem, coasted: Array, plan: Plan) -> list[str]:
    found = []
    fraction = float(np.sum(plan.rotations[1] * coasted)) / problem.dimension
    stray = np.abs(plan.rotations[1] - fraction * coasted).max()
    if stray > TOLERANCE:
        found.append(f'R_1 strays {stray:.2g} from where the body rate carries it')
    if fraction < -TOLERANCE:
        found.append(f'R_1 thrusts backwards by {-fraction:.2g}')
    return found


def _rollout(
    problem: Problem, state: State, first_rate: Array, inputs: Array
) -> tuple[Array, Array, Array]:
    """Return rotations by explicit Euler steps, and the positions and velocities they lead to."""
    h, changes = problem.step, problem.step * inputs
    if problem.rotation_order == 2:
        changes = h * _summed(first_rate, changes[:-1])
    rotations = _summed(state.rotation, changes)
    thrusts = rotations[:, :, 0]
    once = step_of(problem.translation, h, problem.forward)
    moved = _pushed(once, state, thrusts, 0)
    if not problem.inertial:
        velocities = problem.forward * thrusts
        if state.disturbed:
            velocities += state.disturbance
        return rotations, _summed(state.position, moved), velocities
    a = once.transition
    velocities = _summed(state.velocity, _pushed(once, state, thrusts, 1), a[1, 1])
    return rotations, _summed(state.position, moved + a[0, 1] * velocities[:-1]), velocities


def _pushed(once: Step, state: State, thrusts: Array, part: int) -> Array:
    """Return what each step adds to the position (part 0) or velocity (1), shape (N, n)."""
    added = once.push[part] * thrusts[:-1]
    if once.follow[part]:
        added += once.follow[part] * thrusts[1:]
    if state.disturbed:
        added += once.blow[part] * state.disturbance
    return np.asarray(added)


def _summed(first: Array, changes: Array, kept: float = 1.0) -> Array:
    """Return y_0 = first, y_{k+1} = kept y_k + changes_k; one entry more than changes."""
    if kept == 1.0:
        return np.add.accumulate(np.concatenate([first[None], changes]))
    values = [first]
    for change in changes:
        values.append(kept * values[-1] + change)
    return np.array(values)


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


def _rotation_violations(problem: Problem, state: State, plan: Plan) -> list[str]:
    q = plan.projected
    if np.abs(np.swapaxes(q, -1, -2) @ q - np.eye(q.shape[-1])).max() > ORTHOGONAL:
        return ['a projected rotation is not orthogonal']
    if (_determinants(q) < 0.0).any():
        return ['a projected rotation has not determinant +1']
    found, known = [], 1
    if np.abs(q[0] - state.attitude).max() > ORTHOGONAL:
        found.append('the first rotation is not the measured attitude')
    if problem.rotation_order == 2 and state.coasted is not None:
        known = 2
        if np.abs(q[1] - state.coasted).max() > ORTHOGONAL:
            found.append('the second rotation is not where the body rate carries the first')
    stray = _strays(plan, known)
    if stray > TOLERANCE:
        found.append(f'a projected rotation strays {stray:.2g} from its projection')
    return found


def _determinants(q: Array) -> Array:
    """Return the determinants, shape (K,), of matrices, shape (K, n, n)."""
    if q.shape[-1] == 2:
        return q[:, 0, 0] * q[:, 1, 1] - q[:, 0, 1] * q[:, 1, 0]
    return np.linalg.det(q)


def _sizes(vectors: Array) -> Array:
    """Return the lengths, shape (K,), of vectors, shape (K, n)."""
    return np.sqrt(np.einsum('kc,kc->k', vectors, vectors))


def _strays(plan: Plan, known: int) -> float:
    """Return how far rotations Q_k, k >= known, are from the projections that they claim to be.

    Where R_k e1 vanishes, Q_k is the rotation before it. Else a thrust-aligned Q has its first
    axis on R e1, and M = Q'R is what no roll about it improves: M_23 = M_32, and M_22 + M_33 >= 0.
    The nearest Q makes M symmetric, with no two eigenvalues that add up to less than 0 (the
    optimality conditions of Wahba's problem). For n = 2 both say that Q e1 is on R e1.
    """
    r, q = plan.rotations[known:], plan.projected[known:]
    sizes = _sizes(r[:, :, 0])
    held = sizes < HEADING_UNDEFINED
    stray = 0.0
    if held.any():
        stray = float(np.abs(q - plan.projected[known - 1 : -1])[held].max())
        r, q, sizes = r[~held], q[~held], sizes[~held]
    if not len(r):
        return stray
    if q.shape[-1] == 2 or plan.projection == 'thrust_aligned':
        stray = max(stray, float(np.abs(r[:, :, 0] - sizes[:, None] * q[:, :, 0]).max()))
    if q.shape[-1] == 2:
        return stray
    m = np.swapaxes(q, -1, -2) @ r
    if plan.projection == 'thrust_aligned':
        twist, gain = m[:, 1, 2] - m[:, 2, 1], m[:, 1, 1] + m[:, 2, 2]
        return max(stray, float(np.abs(twist).max()), float(-gain.min()))
    transposed = np.swapaxes(m, -1, -2)
    skewed = np.abs(m - transposed).max()
    pairs = np.linalg.eigvalsh(0.5 * (m + transposed))[:, :2].sum(axis=1)
    return max(stray, float(skewed), float(-pairs.min()))


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
