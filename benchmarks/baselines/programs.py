# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Model predictive control by other programs: linearised, and nonlinear by IPOPT."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from benchmarks.baselines.baseline import BEHIND, Baseline, Range, Sight
from benchmarks.baselines.linearised import Linearised
from benchmarks.baselines.nonlinear import Nonlinear
from benchmarks.baselines.program import Program
from orbimpc_ros.mpc.command import command_of
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.parameters.planner import PlannerSettings

WEIGHTS = {
    **BEHIND,
    'position': Range(1.0, 0.1, 1.0),
    'input': Range(1.0, 0.01, 10.0),
    'terminal': Range(1.0, 0.1, 10.0),
}  # weights: times those of the configuration


class _Programmed(Baseline):
    """Tracks the forecast over the horizon: the planner's own problem, without its proofs."""

    SPACE: ClassVar[Mapping[str, Range]] = WEIGHTS

    def __init__(self, settings: PlannerSettings, tuned: Mapping[str, float]) -> None:
        super().__init__(settings, tuned)
        self._program = self._programmed(self._weighed(settings.problem))

    def _programmed(self, problem: Problem) -> Program:
        raise NotImplementedError

    def _weighed(self, problem: Problem) -> Problem:
        given = problem.weights
        return replace(
            problem,
            weights=replace(
                given,
                position=given.position * self.tuned['position'],
                input=given.input * self.tuned['input'],
                terminal=given.terminal * self.tuned['terminal'],
            ),
        )

    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return the command of the program's plan."""
        plan = self._program.plan(sight.state, sight.goals)
        command = command_of(self._program.problem, sight.state, plan)
        return command.speed_fraction, float(command.body_rate[0])


class LinearisedBaseline(_Programmed):
    """One quadratic program a tick about the plan before; ``trust`` is its region [rad]."""

    SPACE: ClassVar[Mapping[str, Range]] = {**WEIGHTS, 'trust': Range(0.5, 0.1, 1.5)}

    def _programmed(self, problem: Problem) -> Program:
        return Linearised(problem, self.tuned['trust'])


class NonlinearBaseline(_Programmed):
    """IPOPT from the plan before, with exact derivatives."""

    def _programmed(self, problem: Problem) -> Program:
        return Nonlinear(problem)
