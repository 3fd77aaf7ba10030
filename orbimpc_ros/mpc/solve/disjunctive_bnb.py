"""Branch and bound over disjunctions, with the convex program at its nodes.

Best first: the open node with the least bound is solved next, so that no node is solved whose bound
already exceeds the optimum. Before a child is solved it inherits its parent's bound raised by one
exact dual step. With the parent's multipliers held, the dual function along the multiplier t >= 0
of a new row a.x >= beta is

    D(t) = D(0) + t (beta - a.x) - t^2/2 a.H^-1 a,

a parabola in the parent's solution x and the condensed Hessian H of the rotations, so the child
costs at least D(0) + max(0, beta - a.x)^2 / (2 a.H^-1 a). That prunes most children unsolved.

A round floor is branched on its cells, and the cells are cut finer where a solution slips below the
floor. Trajectories come from dives, which hold all that a solution misses at its nearest cell; of a
round floor, beyond its tangent in the direction of v, where |v| is surely above the floor.

Mathematics: docs/mathematics.md, 4.9 and 5.4.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.cells import Cell
from orbimpc_ros.mpc.geometry.orbitopes import margin
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.model.trajectory import Trajectory, trajectory_of
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.problem.cones import relief
from orbimpc_ros.mpc.problem.traffic import Traffic, traffic_of
from orbimpc_ros.mpc.solve.disjunction import Disjunction, Slot, disjunctions_of, shortfall
from orbimpc_ros.mpc.solve.passages import Passage, Passages
from orbimpc_ros.mpc.solve.place_program import PlaceProgram
from orbimpc_ros.mpc.solve.relaxation import Halfspace, Relaxation, Relaxed
from orbimpc_ros.mpc.solve.request import Found, Request
from orbimpc_ros.mpc.solve.scouting import Scout
from orbimpc_ros.mpc.solve.so3_multipliers import SO3Multipliers
from orbimpc_ros.mpc.solve.turns import Turns

SATISFIED = 1e-7  # a cell missed by less holds; a tenth of what the plan's check allows
ACCURATE = 1e-6  # on the orbitope, and on an arrival in units of a step's length: as the check's
ROUNDING = 1e-15  # of the coordinates of goals far from the origin
NEAR = 0.05  # a round floor missed by less is worth a dive
DIVE_STEPS = 4
BESIDE = 2.0  # steps' lengths from a way: what is farther away does not guide it
FOLLOWED = 8  # times that a way is followed anew
WORTH = 1e-3  # share of the cost that makes it worth while
PASSING_STEPS = 10  # of a dive among what is round or moves
MAX_NODES = 20_000
HALFWAY = (
    50.0  # times the tolerance, for descents and traffic: half of the gap that counts as proved
)

Choice = tuple[Cell | None, ...]
Missed = dict[int, tuple[float, Array]]  # by choice: by how much, and the values it sees


class DisjunctiveSearch:
    """Solves any problem by branch and bound; without disjunctions, by its one relaxation.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
        coasting: whether states come with a ``coasted`` rotation.
        among: whether states will come with hazards.
    """

    trusts_guess = True

    def __init__(
        self, problem: Problem, tolerance: float, *, coasting: bool = False, among: bool = False
    ) -> None:
        self.problem = problem
        among = among or len(problem.boxes) < len(problem.obstacles)
        self.tolerance = (HALFWAY if problem.has_cones or among else 1.0) * tolerance
        self.disjunctions = disjunctions_of(problem)
        self.takes_guess = bool(self.disjunctions) or among  # one relaxation needs none
        self.exchangeable = _steps_are_exchangeable(problem)
        self.inverse = inverse_hessian(problem)
        self.curvature = inverse_curvatures(problem, self.disjunctions, self.inverse)
        slots = [slot for d in self.disjunctions for slot in d.slots]
        self.turns = Turns(problem) if problem.turns_are_angles else None
        if self.turns is not None:
            slots += self.turns.slots
        self.program = _program(problem, slots, coasting, among)
        self.scout = Scout(problem) if among else None

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies: it does to every problem."""
        return True

    def solve(self, request: Request) -> Found:
        """Return the best trajectory and the proof; complete unless time or nodes run out.

        Raises:
            Infeasible: no trajectory satisfies the constraints: every branch was refuted.
        """
        state, goals = request.state, request.goals
        traffic = traffic_of(self.problem, state)
        if traffic is not None:
            run = _Run(self, request, Passages(self.problem, state, traffic))
            return run.run(self._ways(request, traffic))
        if not self.disjunctions:
            relaxed = self.program.relax(request)
            if relaxed.x is None:
                return Found(None, np.inf, relaxed.bound, 1)
            trajectory = trajectory_of(self.problem, state, goals, relaxed.x)
            found = Found(relaxed.x, trajectory.cost, relaxed.bound, 1)
            # What was solved to the end needs no second look, which costs a quarter of a tick.
            solved = abs(found.gap) <= self.tolerance and not request.late
            accurate = _arrives if solved else _is_accurate
            if accurate(self.problem, goals, trajectory):
                return found
            return Found(None, np.inf, relaxed.bound, 1)
        return _Run(self, request).run()

    def _ways(self, request: Request, traffic: Traffic) -> Iterator[Array]:
        """Yield headings R_1 e1..R_N e1, shape (N, n), of ways to start from: guessed, scouted."""
        if request.guess is not None:
            yield request.guess.x[:, : self.problem.dimension]
        scouted = None
        if self.scout is not None:
            scouted = self.scout.way(request.state, request.goals, traffic)
        if scouted is not None:
            yield scouted


def _program(problem: Problem, slots: Sequence[Slot], coasting: bool, among: bool) -> Relaxed:
    """Return the fastest convex program for a problem, perhaps among what is round or moves."""
    if not among and SO3Multipliers.solves(problem, slots):
        return SO3Multipliers(problem, slots, coasting=coasting)
    if PlaceProgram.solves(problem):
        return PlaceProgram(problem, slots)
    from orbimpc_ros.mpc.solve.program import Program  # brings CVXPY, half of a start-up

    return Program(problem, slots, coasting=coasting)


@dataclass(order=True)
class _Node:
    bound: float
    order: int  # later nodes first among equals: deeper ones
    choice: Choice = field(compare=False)


class _Run:
    """One search: the open nodes, the best trajectory, the least bound given up."""

    def __init__(
        self, search: DisjunctiveSearch, request: Request, passages: Passages | None = None
    ) -> None:
        self._search, self._request, guess = search, request, request.guess
        self._passages, self._fixed = passages, len(search.disjunctions)
        self._guided = passages is not None  # trajectories come from ways, not yet from dives
        self._choices: list[Disjunction | Passage] = [*search.disjunctions]
        self._curvature = list(search.curvature)
        if passages is not None:
            self._choices += passages.choices
            self._curvature += passages.curvatures(search.inverse)
        self._best = None if guess is None else guess.x
        self._cost = np.inf if guess is None else guess.cost
        self._closed = np.inf
        self._open = [_Node(-np.inf, 0, (None,) * len(self._choices))]
        self._nodes = self._made = 0
        problem = search.problem
        eased = relief(problem, request.state, request.goals).tilt if problem.tilt else ()
        self._upright = [not each for each in eased]

    def _follow(self, headings: Array) -> None:
        """Hold tangents where a way passes, solve, and go on from what that finds.

        Each time costs less: where the way satisfies all that it is held by, so does it again.
        """
        ahead = self._request.state.rotation[:, 0]
        cost = np.inf
        for _ in range(FOLLOWED):
            every = np.vstack([ahead, headings])
            x = self._beside(every)
            if x is None:
                return
            trajectory = self._flown(x)
            if not self._missed(trajectory):
                self._accept(x, trajectory)
            if self._is_late or trajectory.cost > (1.0 - WORTH) * cost:
                return
            headings, cost = trajectory.headings[1:], trajectory.cost

    def _beside(self, headings: Array) -> Array | None:
        """Return the best trajectory, shape (N, d), that passes where a way does; None without.

        Args:
            headings: of the way, R_0 e1..R_N e1, shape (N + 1, n).
        """
        problem, turns = self._search.problem, self._search.turns
        positions, _ = translation_rollout(problem, self._request.state, headings)
        held: list[Cell | None] = [None] * len(self._choices)
        around = [] if turns is None else turns.kept(headings)
        for j, each in enumerate(self._search.disjunctions):
            values = each.values(headings, positions)
            if around and each.on == 'heading':
                held[j] = around[each.steps[0] - 1]
            else:
                held[j] = _nearest_cell(each, values, None)
        assert self._passages is not None
        for j, cell in self._passages.tangents(headings[1:], BESIDE * problem.length_unit):
            held[self._fixed + j] = cell
        close = None if turns is None else turns.close(around)
        self._nodes += 1
        halfspaces = self._halfspaces(tuple(held), narrow=turns is not None)
        try:
            return self._search.program.relax(self._request, halfspaces, close).x
        except Infeasible:
            return None

    def run(self, ways: Iterable[Array] = ()) -> Found:
        """Search, from the best trajectories that pass everything on the same sides as some ways.

        Args:
            ways: headings R_1 e1..R_N e1, shape (N, n) each.
        """
        if self._passages is not None:  # the root first: its bound holds whatever becomes of them
            self._expand(heapq.heappop(self._open))
            for way in ways:
                if not self._is_late:
                    self._follow(way)
            self._guided = False
        while self._open and self._open[0].bound < self._limit:
            if self._nodes >= MAX_NODES or (self._nodes and self._is_late):
                break
            self._expand(heapq.heappop(self._open))
        lower = min([self._closed, self._cost, *(node.bound for node in self._open)])
        if lower == np.inf:
            raise Infeasible('no trajectory satisfies the constraints: every branch is infeasible')
        return Found(self._best, self._cost, lower, self._nodes)

    @property
    def _is_late(self) -> bool:
        return self._request.late

    @property
    def _cutoff(self) -> float:
        """Return the bound from which on a node cannot improve on the best by enough."""
        if self._best is None:
            return np.inf
        return self._cost - self._search.tolerance * max(abs(self._cost), 1e-9)

    @property
    def _limit(self) -> float:
        """Return the bound from which on a node can neither improve the plan nor the bound.

        What turns too wide leave open at a leaf, no other leaf makes up for.
        """
        if self._best is None or self._search.turns is None:
            return self._cutoff
        return min(self._cutoff, self._closed)

    def _expand(self, node: _Node) -> None:
        try:
            relaxed = self._relaxed(node.choice)
        except Infeasible:
            if self._nodes == 1:
                raise
            return
        bound = max(node.bound, relaxed.bound)
        if relaxed.x is None:  # neither refuted nor solved
            self._give_up(node.choice, bound)
            return
        trajectory = self._flown(relaxed.x)
        missed = self._missed(trajectory)
        if not missed:
            self._closed = min(self._closed, bound)
            self._accept(relaxed.x, trajectory)
            if self._is_too_wide(trajectory):
                self._turn(node.choice, trajectory)
            return
        if (self._best is None and not self._guided) or self._is_nearly_round(missed):
            self._dive(node.choice, trajectory, missed)
        self._branch(node.choice, missed, bound, relaxed.dual_value)

    def _give_up(self, choice: Choice, bound: float) -> None:
        """Close a node that was not solved, unless it is the root, whose children may be."""
        if self._nodes > 1 or self._is_late:
            self._closed = min(self._closed, bound)
            return
        for cell in self._cells(0, None):
            self._push((cell, *choice[1:]), bound)

    def _cells(self, j: int, held: Cell | None) -> Sequence[Cell]:
        """Return the alternatives that a choice leaves: fewer where the tilt is limited."""
        choice = self._choices[j]
        cells = choice.cells if held is None else held.parts()
        if isinstance(choice, Passage):
            return choice.possible(cells)
        if held is None and choice.upright and self._upright[choice.steps[0] - 1]:
            return choice.upright
        return cells

    def _relaxed(self, choice: Choice) -> Relaxation:
        self._nodes += 1
        return self._search.program.relax(self._request, self._halfspaces(choice))

    def _flown(self, x: Array) -> Trajectory:
        return trajectory_of(self._search.problem, self._request.state, self._request.goals, x)

    def _is_too_wide(self, trajectory: Trajectory) -> bool:
        """Return whether a turn, which the relaxation bounds by its chord, is too wide an angle."""
        turns = self._search.turns
        return turns is not None and not turns.hold(self._request.state, trajectory.headings)

    def _accept(self, x: Array, trajectory: Trajectory) -> None:
        if (
            trajectory.cost < self._cost
            and not self._is_too_wide(trajectory)
            and _is_accurate(self._search.problem, self._request.goals, trajectory)
        ):
            self._best, self._cost = x, trajectory.cost

    def _halfspaces(self, choice: Choice, *, narrow: bool = False) -> Iterator[Halfspace]:
        """Yield what holds at a choice; if narrow, with a first turn that is surely in time."""
        slot = 0
        for disjunction, cell in zip(self._search.disjunctions, choice, strict=False):
            for _ in disjunction.steps:
                if cell is not None:
                    yield slot, cell.normal, cell.offset
                slot += 1
        yield from self._turned(slot, narrow=narrow)
        passages = [] if self._passages is None else self._passages.choices
        for passage, cell in zip(passages, choice[self._fixed :], strict=True):
            if cell is not None:
                yield from passage.halfspaces(cell)

    def _missed(self, trajectory: Trajectory) -> Missed:
        """Return, by disjunction that is not satisfied, by how much and the values it sees."""
        missed = {}
        for j, disjunction in enumerate(self._search.disjunctions):
            values = disjunction.values(trajectory.headings, trajectory.positions)
            by = disjunction.missed_by(values)
            if by > SATISFIED:
                missed[j] = (by, values)
        return missed | self._passed(trajectory, -SATISFIED)

    def _passed(self, trajectory: Trajectory, within: float) -> Missed:
        """Return the passages that a trajectory misses, or is within a distance of missing."""
        if self._passages is None:
            return {}
        near = self._passages.near(trajectory.headings[1:], within)
        return {self._fixed + j: each for j, each in near.items()}

    def _is_nearly_round(self, missed: Missed) -> bool:
        """Return whether all that is missed are round floors, and those by little."""
        return all(self._choices[j].radius and by < NEAR for j, (by, _) in missed.items())

    def _dive(self, choice: Choice, trajectory: Trajectory, missed: Missed) -> None:
        """Look for a trajectory: hold whatever is missed at its nearest cell, and solve again."""
        if self._search.turns is not None:
            self._turn(choice, trajectory)
            if self._best is not None:
                return
        held = list(choice)
        for _ in range(DIVE_STEPS if self._passages is None else PASSING_STEPS):
            for j, (_, values) in missed.items():
                held[j] = _nearest_cell(self._choices[j], values, held[j])
            if self._is_late:
                return
            try:
                x = self._relaxed(tuple(held)).x
            except Infeasible:
                return
            if x is None:
                return
            trajectory = self._flown(x)
            missed = self._missed(trajectory)
            if not missed:
                self._accept(x, trajectory)
                missed = self._round_floors(trajectory)  # tangents there may descend further
                if not missed:
                    return

    def _turn(self, choice: Choice, trajectory: Trajectory) -> None:
        """Look for a trajectory that turns in time, near this one's headings, then its speeds."""
        turns = self._search.turns
        assert turns is not None
        reached = turns.reached(self._request.state, trajectory.headings)
        for around in (reached, turns.kept(trajectory.headings)):
            if not self._is_late:
                self._turn_from(choice, trajectory, around)

    def _turn_from(self, chosen: Choice, trajectory: Trajectory, around: list[Cell]) -> None:
        """Look for a trajectory that turns in time, near cells of the floor, one for each step.

        Consecutive headings are held so close to each other that no angle is too wide.
        """
        turns, held, state = self._search.turns, list(chosen), self._request.state
        assert turns is not None
        for _ in range(DIVE_STEPS):
            missed = self._missed(trajectory)
            for j, choice in enumerate(self._choices):
                if isinstance(choice, Disjunction) and choice.on == 'heading':
                    held[j] = around[choice.steps[0] - 1]
                elif j in missed:
                    held[j] = _nearest_cell(choice, missed[j][1], held[j])
            if self._is_late:
                return
            close = self._halfspaces(tuple(held), narrow=True)
            self._nodes += 1
            try:
                x = self._search.program.relax(self._request, close, turns.close(around)).x
            except Infeasible:
                return
            if x is None:
                return
            trajectory = self._flown(x)
            if not self._missed(trajectory):
                self._accept(x, trajectory)
            if not turns.hold(state, trajectory.headings):
                return
            around = turns.kept(trajectory.headings)

    def _turned(self, slot: int, *, narrow: bool) -> Iterator[Halfspace]:
        """Yield the half-spaces of all turns so far, for the slots after those of disjunctions."""
        turns, ahead = self._search.turns, self._request.state.attitude[:, 0]
        for i, each in enumerate(turns.slots if turns else ()):
            assert turns is not None
            first = narrow and each.step == 1
            yield slot + i, ahead, turns.narrow if first else turns.ahead(each.step)

    def _round_floors(self, trajectory: Trajectory) -> Missed:
        return {
            j: (0.0, d.values(trajectory.headings, trajectory.positions))
            for j, d in enumerate(self._search.disjunctions)
            if d.radius
        }

    def _branch(
        self,
        choice: Choice,
        missed: Missed,
        bound: float,
        dual_value: float,
    ) -> None:
        """Open a child per cell of the disjunction that raises the bound the most.

        The parabola of a child's bound begins at the dual value that belongs to the solution.
        """
        if self._search.exchangeable:
            self._branch_in_order(choice, bound)
            return
        options: dict[int, Sequence[Cell]] = {}
        for j in missed:
            cell = choice[j]
            if cell is not None and not cell.parts():
                continue
            options[j] = self._cells(j, cell)
            if not options[j]:
                return  # none of them can be reached
        if not options:  # a chosen face is missed: the solve was not accurate enough
            self._closed = min(self._closed, bound)
            return
        gains = {j: self._gain(j, cells, missed[j][1]) for j, cells in options.items()}
        promises = {j: (self._promise(j, gains[j], missed[j][0]), missed[j][0]) for j in options}
        chosen = max(options, key=promises.__getitem__)
        for cell, gain in zip(options[chosen], gains[chosen], strict=True):
            raised = max(bound, dual_value + float(gain))
            self._push((*choice[:chosen], cell, *choice[chosen + 1 :]), raised)

    def _branch_in_order(self, choice: Choice, bound: float) -> None:
        """Branch on the first open step, on faces not before that of the step before it.

        Where steps are exchangeable, every trajectory has the cost of one whose faces are sorted;
        of the last step, which the cost does not see at all, one face stands for the others.
        """
        if None not in choice:
            self._closed = min(self._closed, bound)
            return
        j = choice.index(None)
        cells = self._search.disjunctions[j].cells
        least = cells.index(choice[j - 1]) if j else 0
        last = j == len(choice) - 1
        for cell in cells[:1] if last else cells[least:]:
            self._push((*choice[:j], cell, *choice[j + 1 :]), bound)

    def _push(self, choice: Choice, bound: float) -> None:
        if bound >= self._cutoff:
            self._closed = min(self._closed, bound)
            return
        self._made += 1
        heapq.heappush(self._open, _Node(bound, -self._made, choice))

    def _promise(self, j: int, gains: Array, by: float) -> float:
        """Return by how much the children of a disjunction missed by ``by`` may raise the bound.

        Of the parts of a round floor's patch the nearer one often holds already, and tells
        nothing: what is missed of the floor is what finer patches will ask for.
        """
        if self._choices[j].radius:
            return float(by * by / (2.0 * self._curvature[j].min()))
        return float(gains.min())

    def _gain(self, j: int, cells: Sequence[Cell], values: Array) -> Array:
        """Return by how much each cell raises the bound at least, shape (cells,)."""
        short = np.maximum(self._choices[j].shortfall(cells, values), 0.0)
        return np.asarray((short**2 / (2.0 * self._curvature[j])).max(axis=1))


def _is_accurate(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return whether a relaxation's solution holds what is not branched on as well as plans must.

    One that was interrupted, or is not accurate, proves a bound all the same.
    """
    inside = bool(margin(trajectory.rotations[1:]).min() >= -ACCURATE)
    return inside and _arrives(problem, goals, trajectory)


def _arrives(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return whether a terminal constraint, if there is one, is met as well as plans must."""
    if problem.terminal != 'constraint':
        return True
    missed = np.abs(trajectory.positions[-1] - goals[-1]).max()
    if problem.inertial:
        missed = max(missed, problem.step * np.abs(trajectory.velocities[-1]).max())
    rounding = ROUNDING * np.abs(goals[-1]).max()
    return bool(missed <= ACCURATE * problem.length_unit + rounding)


def _nearest_cell(
    disjunction: Disjunction | Passage, values: Array, held: Cell | None
) -> Cell | None:
    """Return the cell that values, shape (K, n), miss least; of a round floor, the tangent."""
    if isinstance(disjunction, Passage):
        return disjunction.nearest(values)
    if not disjunction.radius:
        if held is not None:
            return held
        short = shortfall(disjunction.cells, values).max(axis=1)
        return disjunction.cells[int(np.argmin(short))]
    norm = float(np.linalg.norm(values[0]))
    return Cell(values[0] / norm, disjunction.radius) if norm > HEADING_UNDEFINED else held


def _steps_are_exchangeable(problem: Problem) -> bool:
    """Return whether cost and constraints see nothing of z_1..z_{N-1} but their sum and lengths."""
    return (
        problem.floor.shape == 'polygon'
        and (problem.rotation_order, problem.translation_order) == (1, 1)
        and problem.discretisation == 'euler'  # whose last step pushes nothing
        and problem.weights.input == problem.weights.position == problem.max_rate == 0.0
        and problem.weights.attitude == 0.0
        and not problem.approach.exists
        and not problem.obstacles
    )


def inverse_hessian(problem: Problem) -> Array:
    """Return H^-1, shape (N, N); infinite where H is singular.

    H is the Hessian of the quadratic part of the objective in R_1..R_N, positions eliminated. It
    is the same for each coordinate of R_k e1.
    """
    hessian = Condensed(problem).hessian
    if not np.linalg.cond(hessian) <= 1e12:  # of no curvature at all it is not a number
        return np.full(hessian.shape, np.inf)
    return np.asarray(np.linalg.inv(hessian))


def inverse_curvatures(
    problem: Problem, disjunctions: Sequence[Disjunction], inverse: Array
) -> list[Array]:
    """Return a.H^-1 a of each disjunction's rows, one per step, shapes (len(steps),).

    Normals have length one. Infinite (no gain) where H is singular.
    """
    if not np.isfinite(inverse).all():
        return [np.full(len(d.steps), np.inf) for d in disjunctions]
    rows = problem.maps.reach[:, 1:]
    along = np.einsum('ki,ij,kj->k', rows, inverse, rows)
    every = {'heading': np.diag(inverse), 'position': np.where(along > 0.0, along, np.inf)}
    return [every[d.on][np.array(d.steps) - 1] for d in disjunctions]
