# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of the loop in wind and under gravity: measurements, delays, safe commands."""

from dataclasses import replace

import numpy as np
import problems
import pytest
from stepping import Stepped

from orbimpc_ros.loop.compensation import Compensator
from orbimpc_ros.loop.fallback import safe_command
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.sim.vehicle import Model, launched, measured

UP = exp(np.array([0.0, -0.5 * np.pi, 0.0]))  # the thrust axis to the zenith
WEIGHT = np.array([0.0, 0.0, -9.81])


def known(problem, wind=None, source='ground'):
    return Compensator(problem, given=wind, velocity_source=source)


def windy(rng, n, order=1, **changes):
    """A model in wind, and a vehicle of it in a random state."""
    model = Model(n, 1, order, step=0.4, forward=2.0, disturbance=tuple(rng.normal(size=n)))
    model = replace(model, **changes)
    attitude = problems.rotation(rng, n)
    return model, launched(model, rng.normal(size=n), attitude, fraction=rng.uniform(0.2, 1.0))


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('source', ['ground', 'air'])
@pytest.mark.parametrize('seed', range(5))
def test_a_plan_starts_from_the_speed_through_the_air(n, source, seed):
    rng = np.random.default_rng([seed, n])
    model, vehicle = windy(rng, n, velocity_source=source)
    problem, wind = Problem(n, forward=2.0), model.blown
    compensator, seen = known(problem, wind, source), measured(vehicle, source)
    state = State.at(**compensator.state(seen))
    np.testing.assert_allclose(state.rotation, vehicle.fraction * vehicle.attitude, atol=1e-12)
    np.testing.assert_allclose(state.disturbance, wind)
    assert compensator.odd_speed(seen) == ''


@pytest.mark.parametrize('n', [2, 3])
def test_no_wind_and_no_slip_makes_a_measurement_illegal(n):
    rng = np.random.default_rng(n)
    for _ in range(50):
        attitude, wind = problems.rotation(rng, n), 30.0 * rng.normal(size=n)
        still = np.zeros(1 if n == 2 else 3)
        seen = Odometry(0.0, np.zeros(n), attitude, 20.0 * rng.normal(size=n), still)
        for source in ('ground', 'air'):
            state = State.at(**known(Problem(n, forward=5.0), wind, source).state(seen))
            share = float(np.linalg.norm(state.rotation[:, 0]))
            assert 0.0 <= share <= 1.0 + 1e-12
            np.testing.assert_allclose(state.rotation, share * attitude, atol=1e-12)


def test_an_odd_speed_is_one_through_the_air():
    seen = Odometry(0.0, np.zeros(2), np.eye(2), np.array([1.5, 0.0]), np.zeros(1))
    along = np.array([0.7, 0.0])
    assert 'measured a forward speed of 1.5 m/s' in known(Problem()).odd_speed(seen)
    assert known(Problem(), along).odd_speed(seen) == ''
    assert 'of 1.5 m/s' in known(Problem(), along, 'air').odd_speed(seen)


# --- safe commands under gravity


@pytest.mark.parametrize('tilt', [0.0, 0.5, 1.0])
def test_hovering_leaves_no_acceleration_along_the_weight(tilt):
    problem = Problem(3, 1, 2, forward=20.0)
    attitude = UP @ exp(np.array([0.0, 0.0, tilt]))
    command = safe_command('hover', problem, attitude, 0.0, WEIGHT)
    thrust = 20.0 * command.speed_fraction * attitude[:, 0]
    assert thrust[2] == pytest.approx(9.81)
    assert not command.body_rate.any()


def test_what_tilts_too_far_to_be_carried_is_thrust_least_astray():
    problem = Problem(3, 1, 2, forward=12.0)
    for tilt in np.linspace(0.7, np.pi, 9):
        attitude = UP @ exp(np.array([0.0, 0.0, tilt]))
        command = safe_command('hover', problem, attitude, 0.0, WEIGHT)
        left = [
            np.linalg.norm(12.0 * share * attitude[:, 0] + WEIGHT)
            for share in (command.speed_fraction, *np.linspace(0.0, 1.0, 101))
        ]
        assert left[0] <= min(left) + 1e-9
    assert safe_command('hover', problem, UP, 0.0).speed_fraction == 0.0  # nothing to carry


def test_a_vehicle_without_plans_hovers_above_its_least_thrust():
    problem = Problem(3, 1, 2, forward=20.0, floor=Floor('circle', fraction=0.6))
    controller = Stepped(problem, safe='hover', disturbance=WEIGHT)
    tick = controller.safe(UP, Reason(Cause.ODOMETRY, 'lost'))
    assert tick.command.speed_fraction == 0.6
    free = Stepped(replace(problem, floor=Floor()), safe='hover', disturbance=WEIGHT)
    command = free.safe(UP, Reason(Cause.ODOMETRY, 'lost')).command
    assert command.speed_fraction == pytest.approx(9.81 / 20.0)


def test_a_wind_of_another_dimension_is_refused():
    with pytest.raises(BadInput, match='wind'):
        Model(3, disturbance=(1.0, 2.0))
