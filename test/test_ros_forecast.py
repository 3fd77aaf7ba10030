# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Forecasts of the goal decide the job: over DDS, against the same flights without ROS."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from flying import fly
from nav_msgs.msg import Odometry, Path
from scenarios import retrieval, retrieval_problem

from orbimpc_ros.loop.goal.forecast import forecast_named
from orbimpc_ros.loop.goal.motion import GoalTrajectory
from orbimpc_ros.loop.planner import Planner

LONG = {'exit_when_done': True, 'wait_subscribers': 2}


class Told:
    """The rope's true future, as the simulator tells it."""

    def observe(self, sighting):
        pass

    def at(self, times):
        rope = retrieval().rope
        return np.array([rope.at(time) for time in times])


def ticks_without_ros(forecast):
    log = fly(Planner(retrieval_problem()), retrieval(), forecast)
    assert log.captured
    return len(log.ticks)


@pytest.mark.parametrize(
    ('prediction', 'path_steps'),
    [('harmonic', 0), ('auto', 0), ('hold', 5)],
    ids=['harmonic', 'auto', 'goal_path'],
)
def test_who_knows_the_swing_catches_the_rope_in_well_under_half_of_the_ticks(
    launch, observer, prediction, path_steps
):
    odometry = observer.listen(Odometry, 'odom')
    paths = observer.listen(Path, 'goal_path')
    # The file's section for the node outranks a parameter for any node.
    launch('planner', {'planner:goal_prediction': prediction}, 'retrieval')
    sim = launch('sim', LONG | {'goal_path_steps': path_steps}, 'retrieval')
    observer.until(lambda: sim.ended, 'the end of the flight')
    assert sim.wait() == 0, sim.output
    expected = ticks_without_ros(Told() if path_steps else forecast_named(prediction))
    stamps = lambda: {m.header.stamp.sec for m in odometry}  # noqa: E731
    observer.until(lambda: len(stamps()) > expected, 'the last odometry')
    assert len(stamps()) - 1 == expected
    assert expected < 0.4 * ticks_without_ros(forecast_named('hold'))
    assert bool(paths) == bool(path_steps)
    for path in paths:
        _check_future(path)


def _check_future(path):
    stamps = np.array([p.header.stamp.sec + 1e-9 * p.header.stamp.nanosec for p in path.poses])
    places = np.array([[p.pose.position.x, p.pose.position.y] for p in path.poses])
    future = GoalTrajectory(stamps, places)
    assert np.allclose(future.at(stamps), Told().at(stamps))
    assert len(stamps) == 6
