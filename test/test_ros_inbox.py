"""The planner's inputs: order, age and togetherness of what came."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.inbox import Inbox
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.ros.planner_parameters import PLANNER, planner_settings
from orbimpc_ros.world.vehicle import Model, launched

FRAMES = Frames('odom', 'base_link')


def stamp(seconds):
    return Stamp(round(seconds * 1e9), FRAMES)


def odometry(seconds):
    return messages.odometry_message(stamp(seconds), launched(Model(), np.zeros(2), np.eye(2)))


def goal(seconds, x=5.0):
    return messages.goal_message(stamp(seconds), np.array([x, 0.0]))


@pytest.fixture
def inbox():
    values = {row.name: row.default for row in PLANNER}
    return Inbox(planner_settings({**values, 'step': 0.1}))  # timeouts 0.2 s and 1 s


def test_what_is_missing_is_said(inbox):
    assert 'odometry' in inbox.missing
    assert 'goal' in inbox.missing
    inbox.take_odometry(odometry(1.0), 0.0)
    assert inbox.missing == 'a goal on goal or goal_path'
    inbox.take_goal(goal(1.0), 0.0)
    assert inbox.missing == ''


def test_duplicate_and_reordered_stamps_are_refused_and_counted(inbox):
    assert inbox.take_odometry(odometry(1.0), 0.0) == ''
    assert 'duplicate' in inbox.take_odometry(odometry(1.0), 0.01)
    assert 'reordered' in inbox.take_odometry(odometry(0.5), 0.02)
    assert inbox.refused == {'odom: duplicate stamp': 1, 'odom: reordered stamp': 1}
    assert inbox.odometry.at == 0.0  # what was refused does not count as fresh


def test_a_sender_whose_clock_went_back_is_heard_once_the_old_is_stale(inbox):
    inbox.take_odometry(odometry(100.0), 0.0)
    inbox.take_goal(goal(100.0), 0.0)
    assert inbox.take_odometry(odometry(0.0), 0.1)
    assert inbox.take_odometry(odometry(0.0), 0.3) == ''
    assert inbox.goal is None  # of the old time


def test_a_frozen_stamp_never_counts_as_fresh(inbox):
    inbox.take_odometry(odometry(1.0), 0.0)
    for now in np.arange(0.05, 1.0, 0.05):
        assert inbox.take_odometry(odometry(1.0), now)
    assert 'odometry' in inbox.stale_odometry(1.0)


def test_age_is_of_arrival(inbox):
    inbox.take_odometry(odometry(1e6), 0.0)  # a stamp far in the future
    inbox.take_goal(goal(1e6), 0.0)
    assert inbox.stale_odometry(0.15) == ''
    assert 'odometry' in inbox.stale_odometry(0.25)
    inbox.take_odometry(odometry(1e6 + 1), 1.1)
    assert 'goal' in inbox.stale_goal(1.15)


def test_a_source_stamped_like_the_odometry_is_waited_for(inbox):
    inbox.take_goal(goal(1.0), 0.0)
    inbox.take_odometry(odometry(1.5), 0.0)
    assert inbox.complete  # nothing says that they belong together
    inbox.take_goal(goal(1.5), 0.0)
    inbox.take_odometry(odometry(2.0), 0.1)
    assert not inbox.complete
    inbox.take_goal(goal(2.0, x=6.0), 0.1)
    assert inbox.complete
    np.testing.assert_array_equal(inbox.targets(3, 0.1), [[6.0, 0.0]] * 3)


def test_a_forecast_from_outside_is_used_while_it_is_fresh(inbox):
    inbox.take_goal(goal(0.0), 0.0)
    inbox.take_odometry(odometry(0.0), 0.0)
    places = [np.array([k, 1.0]) for k in range(5)]
    inbox.take_path(messages.goal_path_message(stamp(0.0), 0.1, places), 0.0)
    np.testing.assert_allclose(inbox.targets(3, 0.5), [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]])
    np.testing.assert_array_equal(inbox.targets(1, 1.5), [[5.0, 0.0]])


def test_a_malformed_message_changes_nothing(inbox):
    inbox.take_goal(goal(0.0), 0.0)
    before = inbox.goal
    assert 'position' in inbox.take_goal(goal(1.0, x=np.nan), 0.1)
    assert inbox.goal is before
    np.testing.assert_array_equal(inbox.forecast.at(np.array([1.0])), [[5.0, 0.0]])
