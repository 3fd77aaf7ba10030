"""A plan: the trajectory found, how good it is proved to be, and its independent check."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc import dynamics
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.floors.faces import normals
from orbimpc_ros.mpc.orbitopes import coordinates, margin
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.rotations import project_all
from orbimpc_ros.mpc.trajectory import Trajectory, trajectory_of

OPTIMAL, FEASIBLE, INFEASIBLE, FAILED = 'optimal', 'feasible', 'infeasible', 'failed'
CHECK_TOLERANCE = 1e-6
ORTHOGONAL_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Plan:
    """A trajectory over N steps with its certificate. All arrays are read-only.

    Attributes:
        status: ``optimal`` (proved within the gap tolerance) or ``feasible`` (checked, not proved).
        objective: cost of this trajectory, evaluated from its own numbers.
        lower_bound: no trajectory of the problem costs less; -inf where nothing was proved.
        nodes: relaxations solved on the way.
        positions: s_0..s_N, shape (N + 1, n) [m].
        velocities: p_0..p_N, shape (N + 1, n) [m/s].
        rotations: R_0..R_N in conv SO(n), shape (N + 1, n, n).
        inputs: u_0..u_{N-1}, shape (N, n, n).
        projected: rotations made of R_0..R_N, shape (N + 1, n, n).
        held: for which k R_k e1 = 0 left the heading undefined, so the previous one was held,
            shape (N + 1,).
    """

    status: str
    objective: float
    lower_bound: float
    nodes: int
    positions: Array
    velocities: Array
    rotations: Array
    inputs: Array
    projected: Array
    held: np.ndarray

    def __post_init__(self) -> None:
        for array in (self.positions, self.velocities, self.rotations, self.inputs):
            sealed(array)
        sealed(self.projected)
        sealed(self.held)

    @property
    def horizon(self) -> int:
        """Return N."""
        return len(self.inputs)

    @property
    def gap(self) -> float:
        """Return (objective - lower bound) / max(1e-9, |objective|)."""
        return (self.objective - self.lower_bound) / max(1e-9, abs(self.objective))

    @property
    def speed_fraction(self) -> Array:
        """Return |R_k e1|, shape (N + 1,)."""
        return np.linalg.norm(self.rotations[:, :, 0], axis=1)

    @property
    def projection_distance(self) -> Array:
        """Return the Frobenius distance from each R_k to its rotation, shape (N + 1,)."""
        return np.linalg.norm(self.rotations - self.projected, axis=(1, 2))


def assemble(
    problem: Problem,
    state: State,
    goals: Array,
    x: Array,
    *,
    status: str,
    lower_bound: float,
    nodes: int,
    projection: str,
    flown: Trajectory | None = None,
) -> Plan:
    """Return the plan of rotation coordinates x_1..x_N, shape (N, d), found by a solver.

    Everything else follows from the dynamics, so that the plan is consistent by construction;
    ``flown`` is the trajectory of x where it is known already.
    """
    flown = flown or trajectory_of(problem, state, goals, x)
    rotations = flown.rotations
    projected = np.empty_like(rotations)
    held = np.zeros(len(rotations), dtype=bool)
    projected[0] = state.attitude
    known = 1
    if problem.rotation_order == 2 and state.coasted is not None:
        projected[1], known = state.coasted, 2  # whatever the thrust, the body turns there
    before = projected[known - 1]
    projected[known:], held[known:] = project_all(rotations[known:], before, projection)
    return Plan(
        status=status,
        objective=flown.cost,
        lower_bound=min(lower_bound, flown.cost),
        nodes=nodes,
        positions=flown.positions,
        velocities=flown.velocities,
        rotations=rotations,
        inputs=flown.inputs,
        projected=projected,
        held=held,
    )


def violations(problem: Problem, state: State, goals: Array, plan: Plan) -> list[str]:
    """Return why a plan must not be published; empty if it may be.

    Independent of how the plan was found: a rollout of its inputs from the measured state must
    reproduce it, and every constraint must hold on the result.

    Args:
        problem: what was to be solved.
        state: where the vehicle was measured to be.
        goals: g_1..g_N, shape (N, n) [m].
        plan: to be checked.
    """
    arrays = (plan.positions, plan.velocities, plan.rotations, plan.inputs, plan.projected)
    if not all(np.isfinite(a).all() for a in arrays) or not np.isfinite(plan.objective):
        return ['plan is not finite']
    return [
        *_dynamics_violations(problem, state, plan),
        *_limit_violations(problem, plan),
        *_terminal_violations(problem, goals, plan),
        *_rotation_violations(plan),
    ]


def _dynamics_violations(problem: Problem, state: State, plan: Plan) -> list[str]:
    found = []
    if state.coasted is not None and problem.rotation_order == 2:
        first_rate = (plan.rotations[1] - state.rotation) / problem.step
        fraction = float(np.sum(plan.rotations[1] * state.coasted)) / problem.dimension
        stray = np.abs(plan.rotations[1] - fraction * state.coasted).max()
        if stray > CHECK_TOLERANCE:
            found.append(f'R_1 strays {stray:.2g} from where the body rate carries it')
        if fraction < -CHECK_TOLERANCE:
            found.append(f'R_1 thrusts backwards by {-fraction:.2g}')
    else:
        first_rate = state.rotation_rate
    rotations = dynamics.rotation_rollout(problem, state, first_rate, plan.inputs)
    positions, velocities = dynamics.translation_rollout(problem, state, rotations[:, :, 0])
    for name, rolled, planned in (
        ('rotations', rotations, plan.rotations),
        ('positions', positions, plan.positions),
        ('velocities', velocities, plan.velocities),
    ):
        error = np.abs(rolled - planned).max()
        if error > CHECK_TOLERANCE:
            found.append(f'{name} differ by {error:.2g} from a rollout of the inputs')
    return found


def _limit_violations(problem: Problem, plan: Plan) -> list[str]:
    limits = {
        'conv SO(n)': margin(plan.rotations[1:]).min(),
        'floor': floor_margin(problem, plan.rotations[1:, :, 0]).min(),
        'max_rate': rate_margin(problem, plan.rotations[:, :, 0]).min(),
        'obstacle': obstacle_margin(problem, plan.positions),
    }
    return [f'{k} violated by {-v:.2g}' for k, v in limits.items() if v < -CHECK_TOLERANCE]


def _terminal_violations(problem: Problem, goals: Array, plan: Plan) -> list[str]:
    if problem.terminal != 'constraint':
        return []
    miss = np.abs(plan.positions[-1] - goals[-1]).max()
    if problem.translation_order == 2:
        miss = max(miss, np.abs(plan.velocities[-1]).max())
    return [f'terminal constraint missed by {miss:.2g}'] if miss > CHECK_TOLERANCE else []


def _rotation_violations(plan: Plan) -> list[str]:
    q = plan.projected
    found = []
    if np.abs(np.swapaxes(q, -1, -2) @ q - np.eye(q.shape[-1])).max() > ORTHOGONAL_TOLERANCE:
        found.append('a projected rotation is not orthogonal')
    if np.abs(np.linalg.det(q) - 1.0).max() > ORTHOGONAL_TOLERANCE:
        found.append('a projected rotation has not determinant +1')
    return found


def floor_margin(problem: Problem, headings: Array) -> Array:
    """Return by how much headings R_k e1, shape (N, n), clear the floor, shape (N,)."""
    floor = problem.floor
    if floor.shape == 'none':
        return np.full(len(headings), np.inf)
    if floor.shape == 'circle':
        return np.linalg.norm(headings, axis=1) - floor.fraction
    faces = normals(problem.dimension, floor.faces)
    return (headings @ faces.T).max(axis=1) - floor.fraction


def rate_margin(problem: Problem, headings: Array) -> Array:
    """Return how far below the rate limit headings R_0 e1..R_N e1 turn, shape (N,)."""
    return problem.chord - np.linalg.norm(np.diff(headings, axis=0), axis=1)


def obstacle_margin(problem: Problem, positions: Array) -> float:
    """Return how far s_1..s_N stay outside every box, negative inside [m].

    Args:
        problem: gives the boxes.
        positions: s_0..s_N, shape (N + 1, n) [m].

    With ``no_corner_cutting`` also how far consecutive points clear a face that they share.
    """
    least = np.inf
    for box in problem.obstacles:
        outside = np.concatenate([box.minimum - positions, positions - box.maximum], axis=1)
        least = min(least, outside[1:].max(axis=1).min())
        if problem.no_corner_cutting and len(positions) > 2:
            shared = np.minimum(outside[1:-1], outside[2:]).max(axis=1)
            least = min(least, shared.min())
    return float(least)


def shifted(
    problem: Problem, state: State, goals: Array, plan: Plan, *, projection: str
) -> Plan | None:
    """Return the previous plan moved one step on, its last rotation held, from a new state.

    None where the shift does not fit: at rotation order 2 the first rotation is given.

    Args:
        problem: what is to be solved now.
        state: from where.
        goals: g_1..g_N, shape (N, n) [m].
        plan: the previous one, for a state a step before.
        projection: ``nearest`` or ``thrust_aligned``.
    """
    if problem.rotation_order == 2:
        return None
    x = coordinates(plan.rotations)
    moved = np.concatenate([x[2:], x[-1:]])[: problem.horizon]
    if len(moved) < problem.horizon:
        return None
    return _unproved(problem, state, goals, moved, projection)


def run_up(problem: Problem, state: State, goals: Array, *, projection: str) -> Plan:
    """Return the plan to go straight ahead, and faster by as much in each step as is allowed.

    Args:
        problem: what is to be solved, of rotation order 1 and with a rate limit.
        state: from where.
        goals: g_1..g_N, shape (N, n) [m].
        projection: ``nearest`` or ``thrust_aligned``.
    """
    start = np.linalg.norm(state.rotation[:, 0])
    fractions = start + problem.chord * np.arange(1, problem.horizon + 1)
    x = np.minimum(fractions, 1.0)[:, None] * coordinates(state.attitude)
    return _unproved(problem, state, goals, x, projection)


def _unproved(problem: Problem, state: State, goals: Array, x: Array, projection: str) -> Plan:
    """Return the plan of coordinates that no solver found, and that nothing is proved of."""
    return assemble(
        problem,
        state,
        goals,
        x,
        status=FEASIBLE,
        lower_bound=-np.inf,
        nodes=0,
        projection=projection,
    )
