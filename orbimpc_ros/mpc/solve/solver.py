# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The solver: one problem in, one checked plan with a verified bound out.

It solves in natural units, in which a problem's step, full speed and costs are all of the order of
one. Rotations are dimensionless, so a solution of the scaled problem solves the original one; only
costs and bounds differ in scale. Methods with absolute tolerances then work as well at 1000 m/s as
at 1 m/s.

Mathematics: docs/mathematics.md, 1.4, 5.4 and 6.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from threading import RLock

import numpy as np

from orbimpc_ros.mpc.arrays import Array, frozen, number, word
from orbimpc_ros.mpc.check import holds, violations
from orbimpc_ros.mpc.errors import BadInput, Infeasible, OrbimpcError, SolverFailure
from orbimpc_ros.mpc.geometry.rotations import PROJECTIONS, coordinate_count
from orbimpc_ros.mpc.model.dynamics import Condensed, trajectory_of
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import UNPROVED, Plan, Proof, assemble, joined, shifted
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.problem.cones import cone_violations
from orbimpc_ros.mpc.problem.reach import beyond_reach, beyond_turning, clear_of_hazards, reason
from orbimpc_ros.mpc.proof.stated import SPEEDS
from orbimpc_ros.mpc.proof.tree import ProofTree
from orbimpc_ros.mpc.proof.verify import Verifier
from orbimpc_ros.mpc.solve.request import Enough, Found, Method, Request, method_for
from orbimpc_ros.mpc.solve.stand_ins import in_time, straight, turning

SEARCH_SHARE = 0.01  # a search stops at this share of the gap tolerance
SURELY = 1e-3  # in units of a step's length, or rad: farther beyond reach no search is needed
OUTWARD = 1e-9  # relative reduction of published bounds: plans satisfy constraints to a tolerance
ROUNDED = 1e-15  # reduction in units of cost: states and goals are rounded
STANDS_IN = 'a plan found without search is used'
DOUBTFUL = 'found to be infeasible, but not verified'
GOES_ON = 'the previous plan continues: no better one was found in time'
Answer = tuple[Plan | None, Status, str]  # a checked plan, the status of the solve, and the reason
Late = Callable[[], bool]


@dataclass(frozen=True)
class Units:
    """The units in which a problem is solved.

    Attributes:
        problem: the problem in these units.
        length: [m].
        time: [s].
        cost: in units of the objective.
    """

    problem: Problem
    length: float
    time: float
    cost: float

    @classmethod
    def of(cls, problem: Problem) -> Units:
        """Return the natural units: the longest step from rest, a step, the largest curvature."""
        length, time, w = problem.maps.unit, problem.step, problem.weights
        area, paid = length * length, w.length * time * problem.forward
        # Rotations have no units, so curvatures are the same in all.
        curved = float(np.abs(np.diag(Condensed(problem).hessian)).max())
        cost = max(curved, paid) or 1.0
        weights = Weights(
            position=w.position * area / cost,
            # The inputs are first or second derivatives of dimensionless numbers.
            input=w.input / time ** (2 * problem.rotation_order) / cost,
            length=paid / cost,
            terminal=w.terminal * area / cost,
            attitude=w.attitude / cost,
        )
        scaled = replace(
            problem,
            step=1.0,
            forward=1.0,
            weights=weights,
            arrival_weight=problem.arrival_weight * area / cost,
            max_rate=min(math.pi, problem.max_rate * time),
            max_acceleration=problem.max_acceleration * time * time / length,
            obstacles=tuple(body.scaled(1.0 / length) for body in problem.obstacles),
        )
        return cls(scaled, length, time, cost)

    def state(self, state: State) -> State:
        """Return a state in these units."""
        inverse = 1.0 / self.length, 1.0 / self.time
        pushing = self.time ** (2 if self.problem.inertial else 1) / self.length
        return replace(
            state,
            position=state.position * inverse[0],
            velocity=state.velocity * (self.time / self.length),
            rotation_rate=state.rotation_rate * self.time,
            disturbance=state.disturbance * pushing,
            hazards=tuple(each.scaled(*inverse) for each in state.hazards),
        )

    def posed(self, tree: ProofTree) -> ProofTree:
        """Return a tree in these units converted to the units of the posed problem."""
        cost, force = self.cost, self.cost / self.length
        paces = [[force], [force * self.time]][: tree.pull.shape[1]]
        units = {'press': force, 'pull': paces, 'slide': force, 'tether': cost, 'share': cost}
        used = {n: getattr(tree, n) * unit for n, unit in units.items() if getattr(tree, n).size}
        return tree._replace(shor=tree.shor * cost, **used)


class Solver:
    """Solver of one problem for any state and goals; compiled at construction.

    Threads may share it: of several calls one runs at a time.

    Args:
        problem: what to solve.
        projection: ``nearest`` or ``thrust_aligned``: projection of plans to rotations.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        coasting: whether states come with a ``coasted`` rotation (rotation order 2).
        patient: whether the deadline leaves time to set up slower methods if the first one fails;
            this takes a second or so.
        enough: criteria for stopping a search before the gap is closed.

    Raises:
        BadInput: an unknown projection, or a tolerance outside [0, 1].

    Attributes:
        problem: what it solves.
        takes_guess: whether it benefits from a warm start; with hazards it always does.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        projection: str = 'thrust_aligned',
        gap_tolerance: float = 1e-4,
        coasting: bool = False,
        patient: bool = False,
        enough: Enough | None = None,
    ) -> None:
        self.problem, self._projection = problem, word(projection, 'projection', PROJECTIONS)
        self._tolerance = number(gap_tolerance, 'gap_tolerance', 0.0, 1.0)
        self._units, self._patient = Units.of(problem), patient
        self._shape = problem.horizon, coordinate_count(problem.dimension)  # of guesses
        self._verifier = Verifier(problem) if problem.floor.shape in SPEEDS else None
        self._coasting = coasting and problem.rotation_order == 2
        self._method = self._made(among=False)
        self.takes_guess = self._method.takes_guess
        self._enough = Enough(*(each / self._units.cost for each in enough or Enough()))
        self._turn = RLock()  # methods and the verifier keep their work arrays between calls

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Plan | Array | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Plan:
        """Return the best plan found, checked, with its proof.

        If the method fails, or its plan fails the check, the cheapest fallback that passes the
        check is returned: the guess or a straight plan, or without these, unless infeasibility is
        proved, a plan that turns at a constant rate or arrives after a turn.

        Args:
            state: initial state of the plan, of the same dimension as the problem.
            goals: g_1..g_N, shape (N, n) [m].
            guess: warm start, used if it is feasible: a plan from this state, or its rotation
                coordinates, shape (N, d).
            out_of_time: polled at least every few milliseconds; once it returns True, the search
                returns its best result so far.

        Raises:
            BadInput: state, goals or guess have a wrong shape or are no numbers.
            Infeasible: no trajectory satisfies the constraints.
            SolverFailure: no trajectory was found, and none was proved not to exist.
        """
        request = self._request(state, goals, guess, out_of_time)
        with self._turn:
            return self._checked(request)

    def propose(
        self,
        state: State,
        goals: Array,
        guess: Plan | Array | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Plan:
        """Return the plan of the method as in :meth:`solve`, but without check or fallback.

        Raises:
            BadInput: state, goals or guess have a wrong shape or are no numbers.
            Infeasible: the method proved that no trajectory satisfies the constraints.
            SolverFailure: the method found no trajectory.
        """
        request = self._request(state, goals, guess, out_of_time)
        with self._turn:
            result = self._result(request)
            if result.x is None:
                raise SolverFailure(result.reason)
            return self._assembled(request, result.x, self._proof(request, result))

    def _checked(self, request: Request) -> Plan:
        """Return the plan of a request, with the errors of :meth:`solve`."""
        try:
            result = self._result(request)
        except Infeasible as error:
            result = Found(reason=f'a plan exists, though the search found: {error}')
            return self._instead(request, result, error)
        if result.x is None:
            return self._instead(request, result, SolverFailure(result.reason))
        plan = self._assembled(request, result.x, self._proof(request, result))
        flaws = violations(self.problem, request.state, request.goals, plan)
        if flaws:
            result = Found(reason='the plan found fails its check: ' + '; '.join(flaws))
            return self._instead(request, result, SolverFailure(result.reason))
        closed = plan.objective - plan.lower_bound <= self._tolerance * plan.objective
        # Proved optimal relative to its own cost, however small, or good enough, or time is up.
        if closed or self._enough.met(result) or request.late:
            return plan
        instead = replace(plan.proof, reason=joined(plan.proof.reason, STANDS_IN))
        return self._cheapest(request, self._unsought(request), instead, plan.objective) or plan

    def _request(
        self, state: State, goals: Array, guess: Plan | Array | None, out_of_time: Late | None
    ) -> Request:
        """Return the request, in the units of the caller."""
        if len(state.position) != self.problem.dimension:
            allowed = f'{self.problem.dimension} numbers'
            raise BadInput('state.position', state.position.tolist(), allowed)
        if self._coasting and state.coasted is None:
            raise BadInput('state.coasted', None, 'a rotation: the solver was made for coasting')
        if self.problem.wants_attitude and state.wanted is None:
            raise BadInput('state.wanted', None, 'a rotation, in a file goal_attitude, for its end')
        goals = _floats(goals, (self.problem.horizon, self.problem.dimension), 'goals')
        if isinstance(guess, Plan):
            guess = guess.x[1:] if guess.x[1:].shape == self._shape else None
        elif guess is not None:
            guess = _floats(guess, self._shape, 'guess')
        return Request(state, goals, guess, out_of_time, self._patient, self._enough)

    def _searched(self, state: State) -> State:
        """Return the state, without hazards if all are out of reach: faster methods then apply."""
        if not state.hazards:
            return state
        key = 'searched', self.problem
        return state.once(key, lambda: clear_of_hazards(self.problem, state))

    def _result(self, request: Request) -> Found:
        """Return the result of the method, with a reason if it found no trajectory but the guess.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        state, goals, units = self._searched(request.state), request.goals, self._units
        if self.problem.terminal == 'constraint' or self.problem.approach.exists:
            beyond = beyond_reach(self.problem, state, goals) / self.problem.maps.unit
            if max(beyond, beyond_turning(self.problem, state)) > SURELY:
                raise Infeasible(reason(self.problem, state, goals))
        method = self._among if state.hazards else self._method
        guess = request.guess if method.takes_guess else None
        posed = request._replace(state=units.state(state), goals=goals / units.length, guess=guess)
        try:
            result = method.solve(posed)
        except Infeasible as error:
            if error.proof is not None and self._verified(request, error.proof)[0] < np.inf:
                return Found(reason=DOUBTFUL)
            raise Infeasible(reason(self.problem, state, goals)) from None
        except (SolverFailure, ArithmeticError, np.linalg.LinAlgError) as error:  # or an overflow
            return Found(reason=str(error))
        if result.x is None:
            return replace(result, reason=f'no trajectory found in {result.nodes} relaxations')
        if not np.isfinite(result.x).all():  # its rollout and projection would raise errors
            return Found(reason='the trajectory found is not finite')
        if result.x is guess and result.gap > self._tolerance:
            return replace(result, reason=GOES_ON)
        return result

    def expect_hazards(self) -> None:
        """Build the method for hazards in advance, which takes a second or so."""
        assert self._among

    @cached_property
    def _among(self) -> Method:
        """Return the method for states with hazards, built when needed: the general one."""
        return self._made(among=True)

    def _made(self, *, among: bool) -> Method:
        tolerance = SEARCH_SHARE * self._tolerance
        return method_for(self._units.problem, tolerance, coasting=self._coasting, among=among)

    def _assembled(self, request: Request, x: Array, proof: Proof) -> Plan:
        posed = self.problem, request.state, request.goals
        plan = assemble(*posed, x, projection=self._projection, proof=proof)
        if plan.objective < proof.lower_bound:  # constraints may be violated by rounding
            plan = replace(plan, proof=replace(proof, lower_bound=plan.objective))
        return plan

    def _proof(self, request: Request, result: Found) -> Proof:
        """Return the proof of a result in natural units; no cost is negative, so no bound is.

        The bound is the verifier's for the first of the method's trees that proves what the search
        did, or the best one that there is time for; without any, the method's own.
        """
        cost, bound, tree = self._units.cost, -np.inf, None
        for each in result.proofs:
            if bound < cost * (result.lower_bound - self._tolerance * abs(result.lower_bound)):
                bound, tree = max((bound, tree), self._verified(request, each), key=itemgetter(0))
        checked = -np.inf < bound < np.inf
        if not checked:
            bound, tree = cost * result.lower_bound, None
        lower = max(0.0, float(bound) * (1.0 - OUTWARD) - ROUNDED * cost) if bound < np.inf else 0.0
        checked = checked or lower == 0.0
        return Proof(lower, result.nodes, self._tolerance, cost, result.reason, checked, tree)

    def _verified(self, request: Request, tree: ProofTree) -> tuple[float, ProofTree]:
        """Return the verified bound of a tree in natural units, and the tree in users' units."""
        made = self._units.posed(tree)
        if self._verifier is None:
            return -np.inf, made
        posed = self._searched(request.state), request.goals
        return self._verifier.bound(*posed, made, request.out_of_time), made

    def _instead(self, request: Request, result: Found, failure: OrbimpcError) -> Plan:
        """Return the cheapest fallback plan that passes the check, or raise ``failure``."""
        proof = self._proof(request, replace(result, reason=joined(result.reason, STANDS_IN)))
        plan = self._cheapest(request, self._unsought(request), proof)
        if plan is None and isinstance(failure, SolverFailure):
            every = turning(self.problem, request.state, request.goals)
            plan = self._cheapest(request, in_time(every, request.out_of_time), proof)
        if plan is None:
            raise failure
        return plan

    def _unsought(self, request: Request) -> Iterator[Array]:
        """Yield the coordinates of fallback plans, shape (N, d): the guess and straight ones."""
        if request.guess is not None:
            yield request.guess  # rolled out from this state
        yield from straight(self.problem, request.state, request.goals)

    def _cheapest(
        self, request: Request, candidates: Iterable[Array], proof: Proof, below: float = np.inf
    ) -> Plan | None:
        """Return the cheapest plan that passes the check and costs less than ``below``.

        Args:
            request: the request.
            candidates: rotation coordinates of plans, shape (N, d) each.
            proof: of a bound.
            below: the limit of costs.
        """
        posed, best = (self.problem, request.state, request.goals), None
        for x in candidates:
            if trajectory_of(*posed, x).objective < below:
                plan = self._assembled(request, x, proof)
                if holds(*posed, plan):
                    best, below = plan, plan.objective
        return best


@dataclass(frozen=True)
class Deadline:
    """The deadline of a decision; calling it returns whether it has passed."""

    clock: Callable[[], float]  # [s]
    end: float  # on that clock; infinite without a deadline [s]

    def __call__(self) -> bool:
        """Return True if the deadline has passed."""
        return self.clock() > self.end


@dataclass(frozen=True)
class Task:
    """The optimisation behind a decision, warm-started from the remainder of the previous plan."""

    problem: Problem
    state: State  # initial state of plans
    goals: Array  # g_1..g_N, shape (N, n) [m]
    solver_for: Callable[[Problem], Solver] = Solver  # makes or looks up the solver of a problem
    previous: Plan | None = None  # the previous plan; None without one to continue
    pace: float = 1.0  # step of the previous plan [s]
    since: float = 0.0  # start of the previous plan until that of this one [s]
    projection: str = 'thrust_aligned'  # projection of plans to rotations
    late: Late | None = None  # whether the deadline has passed; None without one

    @cached_property
    def parts(self) -> tuple[Problem, State, Array]:
        """Return the problem, state and goals against which plans are checked."""
        return self.problem, self.state, self.goals

    @property
    def knots(self) -> Array:
        """Return the ends of the steps, in steps of the previous plan from its start, (N,)."""
        steps = np.arange(1.0, self.problem.horizon + 1.0)
        return np.asarray(self.since / self.pace + self.problem.step / self.pace * steps)

    @cached_property
    def onward(self) -> Array | None:
        """Return the remainder of the previous plan as coordinates, shape (N, d), if it fits."""
        if self.previous is None:
            return None
        return shifted(self.problem, self.state, self.previous, self.knots)

    @cached_property
    def rest(self) -> Plan | None:
        """Return the remainder of the previous plan as a plan from this state, if it fits."""
        if self.onward is None:
            return None
        return assemble(*self.parts, self.onward, projection=self.projection, proof=UNPROVED)

    def solved(self, *, guessing: bool = False) -> Answer:
        """Return a checked plan, or None, with status and reason.

        The search is warm-started from the remainder of the previous plan if that helps the solver,
        or if ``guessing``.
        """
        solver = self.solver_for(self.problem)
        useful = guessing or solver.takes_guess or bool(self.state.hazards)
        guess = self.onward if useful else None
        try:
            plan = solver.solve(self.state, self.goals, guess, self.late)
        except Infeasible as error:
            return None, Status.INFEASIBLE, str(error)
        except SolverFailure as error:
            return None, Status.FAILED, str(error)
        outside = cone_violations(self.problem, self.goals, plan) if self.problem.has_cones else ''
        if plan.status == Status.OPTIMAL:
            return plan, Status.OPTIMAL, outside
        unproved = '' if plan.is_closed else f'not proved optimal: gap {plan.gap:.2g}'
        return plan, plan.status, joined(unproved, plan.proof.reason, outside)


def _floats(value: Array, shape: tuple[int, ...], culprit: str) -> Array:
    """Return finite floats of a shape as they are; convert other numbers, refuse the rest."""
    fits = isinstance(value, np.ndarray) and (value.dtype, value.shape) == (float, shape)
    return value if fits and np.isfinite(value).all() else frozen(value, shape, culprit)
