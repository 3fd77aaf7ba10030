# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Optimal values found with other formulations and other solvers."""

import numpy as np
import pytest
from problems import ANSWERS, CASES, reference

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.solve.solver import Solver

BEST_KNOWN = ('uav_circle', 'uav_unit', 'dubins_circle')  # feasible values, not proved optimal


@pytest.mark.parametrize('name', CASES)
def test_objective_bound_and_constraints(name):
    problem, state, goals = reference(name)
    plan = Solver(problem).solve(state, goals)
    answer = ANSWERS[name]['objective']
    assert plan.is_closed
    # With a weight on fuel, plans of a cone program are too inaccurate for a certificate.
    assert plan.proof.checked or (name == 'spacecraft_fuel0.1' and not COMPILED)
    assert plan.lower_bound <= plan.objective
    assert plan.gap <= 1e-4 or not plan.proof.checked
    assert plan.nodes >= 1
    assert violations(problem, state, goals, plan) == []
    if name.startswith(BEST_KNOWN):
        assert plan.objective <= answer * (1 + 1e-6)
        assert plan.lower_bound <= answer * (1 + 1e-4)
    else:
        assert plan.objective == pytest.approx(answer, rel=1e-5)


def test_the_unit_floor_is_constant_speed():
    problem, state, goals = reference('uav_unit_1')
    plan = Solver(problem).solve(state, goals)
    assert np.allclose(plan.speed_fraction[1:], 1.0, atol=1e-9)
    assert np.allclose(plan.rotations[1:], plan.projected[1:], atol=1e-9)
