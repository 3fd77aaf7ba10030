"""One problem in, one plan out: which method solves it, and how well it is proved.

Mathematics: docs/mathematics.md, 5.5 and 6.1.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput, Infeasible, OrbimpcError, SolverFailure
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.plan import UNPROVED, Plan, Proof, assemble, turns, unsought
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.feasibility import reason
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.solve.registry import method_for
from orbimpc_ros.mpc.solve.request import Found, Guess, Request

SEARCH_SHARE = 0.01  # a search stops at this share of the gap that counts as proved
OUTWARD = 1e-9  # relative: bounds are published lower by what plans may miss constraints by
NOTHING = Found(None, np.inf, -np.inf, 0)


class Solver:
    """Solves one problem for any state and goals; compiled at construction.

    Args:
        problem: what to solve.
        projection: ``nearest`` or ``thrust_aligned``, how plans become rotations.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        coasting: whether states will come with a ``coasted`` rotation (rotation order 2).
        patient: whether a deadline leaves time to set up slower methods where the first one fails;
            that takes a second or so.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        projection: str = 'thrust_aligned',
        gap_tolerance: float = 1e-4,
        coasting: bool = False,
        patient: bool = False,
    ) -> None:
        self.problem = problem
        self._projection, self._tolerance = projection, gap_tolerance
        self._units, self._patient = Units.of(problem), patient
        tolerance = SEARCH_SHARE * gap_tolerance
        self._method = method_for(self._units.problem, tolerance, coasting=coasting)

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Plan | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Plan:
        """Return the best plan found, checked, with its proof.

        Where the method fails, or the plan it proposes does not pass the check, the guess and the
        plans to go straight on or straight to the goal stand in for it, as far as they pass; else,
        unless there is proved to be none, plans that turn at an even rate or arrive after a turn.

        Args:
            state: where the plan starts; its dimension is the problem's.
            goals: g_1..g_N, shape (N, n) [m].
            guess: a plan from this very state to start the search from; used if it is feasible.
            out_of_time: polled at least every few milliseconds; True makes the search return the
                best so far.

        Raises:
            BadInput: goals of another shape.
            Infeasible: no trajectory satisfies the constraints.
            SolverFailure: no trajectory was found, and none was proved not to exist.
        """
        try:
            found = self._found(state, goals, guess, out_of_time)
        except Infeasible as error:
            found = replace(NOTHING, reason=f'a plan exists, though the search found: {error}')
            return self._instead(state, goals, guess, found, error, out_of_time)
        if found.x is None:
            return self._instead(
                state, goals, guess, found, SolverFailure(found.reason), out_of_time
            )
        plan = self._assembled(state, goals, found.x, self._proof(found))
        flaws = violations(self.problem, state, goals, plan)
        if flaws:
            found = replace(NOTHING, reason='the plan found fails its check: ' + '; '.join(flaws))
            return self._instead(
                state, goals, guess, found, SolverFailure(found.reason), out_of_time
            )
        if plan.gap <= self._tolerance:  # not just as near as rounding allows to tell
            return plan
        sound = [plan, *self._candidates(state, goals, guess, plan.proof)]
        return min(sound, key=lambda each: each.objective)

    def propose(
        self,
        state: State,
        goals: Array,
        guess: Plan | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Plan:
        """Return what the method finds, as :meth:`solve` does, but before any check.

        Raises:
            BadInput: goals of another shape.
            Infeasible: the method proved that no trajectory satisfies the constraints.
            SolverFailure: the method found none.
        """
        found = self._found(state, goals, guess, out_of_time)
        if found.x is None:
            raise SolverFailure(found.reason)
        return self._assembled(state, goals, found.x, self._proof(found))

    def _found(
        self,
        state: State,
        goals: Array,
        guess: Plan | None,
        out_of_time: Callable[[], bool] | None,
    ) -> Found:
        wanted = (self.problem.horizon, self.problem.dimension)
        if np.shape(goals) != wanted:
            raise BadInput('goals', np.shape(goals), f'an array of shape {wanted}')
        usable, units = self._usable(state, goals, guess), self._units
        start, targets = units.state(state), units.lengths(goals)
        try:
            found = self._method.solve(Request(start, targets, usable, out_of_time, self._patient))
        except Infeasible:
            raise Infeasible(reason(self.problem, state, goals)) from None
        except SolverFailure as error:
            return replace(NOTHING, reason=str(error))
        if found.x is None:
            return replace(found, reason=f'no trajectory found in {found.nodes} relaxations')
        if not np.isfinite(found.x).all():  # or what is made of it would end in errors
            return replace(NOTHING, reason='the trajectory found is not finite')
        return found

    @property
    def takes_guess(self) -> bool:
        """Return whether a guess makes this solver faster."""
        return self._method.takes_guess

    def _usable(self, state: State, goals: Array, guess: Plan | None) -> Guess | None:
        if guess is None or not self.takes_guess:
            return None
        if self._method.trusts_guess and violations(self.problem, state, goals, guess):
            return None
        return Guess(coordinates(guess.rotations[1:]), guess.objective / self._units.cost)

    def _assembled(self, state: State, goals: Array, x: Array, proof: Proof) -> Plan:
        return assemble(self.problem, state, goals, x, projection=self._projection, proof=proof)

    def _proof(self, found: Found) -> Proof:
        """Return the proof of a bound in natural units; no term of the objective is negative."""
        bound = self._units.cost * (1.0 - OUTWARD) * found.lower_bound
        known = bound if 0.0 < bound < np.inf else 0.0
        return Proof(known, found.nodes, self._tolerance, self._units.cost, found.reason)

    def _instead(
        self,
        state: State,
        goals: Array,
        guess: Plan | None,
        found: Found,
        failure: OrbimpcError,
        out_of_time: Callable[[], bool] | None,
    ) -> Plan:
        """Return the cheapest of the plans that can stand in for one that was not found."""
        proof = self._proof(found)
        sound = list(self._candidates(state, goals, guess, proof))
        if not sound and isinstance(failure, SolverFailure):
            sound = self._turns(state, goals, proof, out_of_time)
        if not sound:
            raise failure
        return min(sound, key=lambda each: each.objective)

    def _candidates(
        self, state: State, goals: Array, guess: Plan | None, proof: Proof
    ) -> Iterator[Plan]:
        """Yield the plans that cost no search and pass the check, held against a proof."""
        made = unsought(self.problem, state, goals, projection=self._projection)
        if guess is not None and guess.horizon == self.problem.horizon:
            x = coordinates(guess.rotations[1:])  # from this state, whatever it was made for
            made = itertools.chain([self._assembled(state, goals, x, UNPROVED)], made)
        for plan in made:
            held = plan.proved(proof)
            if not violations(self.problem, state, goals, held):
                yield held

    def _turns(
        self,
        state: State,
        goals: Array,
        proof: Proof,
        out_of_time: Callable[[], bool] | None,
    ) -> list[Plan]:
        """Return plans that turn, as far as they pass the check; once late, one of them."""
        sound = []
        for plan in turns(self.problem, state, goals, projection=self._projection):
            held = plan.proved(proof)
            if not violations(self.problem, state, goals, held):
                sound.append(held)
            if sound and out_of_time is not None and out_of_time():
                break
        return sound
