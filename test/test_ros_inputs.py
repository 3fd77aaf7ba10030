# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's inputs: order and age of messages, and which of them belong together."""

import numpy as np
import pytest
from planners import goal, odometry, settings, stamp
from stepping import stale, targets

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.planner.core import Inputs

NOW = 1_700_000_000 * SECOND  # [ns]
UPRIGHT = (np.sqrt(0.5), 0, np.sqrt(0.5), 0)  # x is vertical: no yaw


@pytest.fixture
def inputs():
    return Inputs(settings(step=0.1, odom_timeout=0.2, goal_timeout=1.0))


@pytest.fixture
def default():
    return Inputs(settings(step=0.1))


@pytest.fixture
def limited():
    return Inputs(settings(step=0.1, goal_jump_limit=0.5, goal_prediction='velocity'))


def ahead(inputs, steps, start=None):
    """Return the ends of steps after the odometry's stamp, or after ``start`` [s]."""
    start = inputs.odometry.value.time if start is None else start
    return start + inputs.settings.problem.step * np.arange(1, steps + 1)


def path(seconds, places):
    return messages.path_message(
        stamp(seconds), 0.1, map(messages.pose, [np.array(each) for each in places])
    )


def oriented(message, w, x, y, z):
    pose = message.poses[-1].pose if hasattr(message, 'poses') else message.pose
    turned = pose.orientation
    turned.w, turned.x, turned.y, turned.z = map(float, (w, x, y, z))
    return message


def clock(seconds):
    """Return the node's clock some seconds after NOW [ns]."""
    return NOW + round(seconds * SECOND)


def stamped(make, seconds, *arguments):
    message = make(1.0, *arguments)
    message.header.stamp = messages.time_message(NOW + round(seconds * SECOND))
    return message


def typed(x, frame='', make=goal):
    """Return a message as ``ros2 topic pub`` makes it of a pose alone: without stamp and frame."""
    message = make(0.0, x) if make is goal else make(0.0)
    message.header.frame_id = frame
    return message


def sent(inputs, *times):
    for at in times:
        inputs.update('odom', odometry(at), at)
        assert inputs.update('goal', goal(at), at) == ''


# --- order


def test_what_is_missing_is_said_by_the_names_of_topics_as_they_are_resolved(default):
    names = {'odom': '/boat/gps', 'goal': '/boat/goal', 'goal_path': '/boat/path'}
    remapped = Inputs(default.settings, lambda topic: names.get(topic, topic))
    assert remapped.missing == 'odometry on /boat/gps and a goal on /boat/goal or /boat/path'
    assert remapped.update('odom', odometry(1.0), 0.0) == ''
    assert remapped.missing == 'a goal on /boat/goal or /boat/path'
    assert remapped.update('odom', odometry(1.0), 0.1).startswith('/boat/gps refused: duplicate')
    assert remapped.refused == {'odom: duplicate stamp': 1}  # counters are not remapped
    remapped.update('odom', odometry(2.0), 0.2, clock(0.2))
    assert remapped.untimed == '/boat/gps'
    remapped.update('goal', goal(1.0), 0.0)
    assert remapped.missing == ''


def test_duplicate_and_reordered_stamps_are_refused_counted_and_never_fresh(inputs):
    assert inputs.update('odom', odometry(1.0), 0.0) == ''
    assert 'duplicate' in inputs.update('odom', odometry(1.0), 0.01)
    assert 'reordered' in inputs.update('odom', odometry(0.5), 0.02)
    assert inputs.refused == {'odom: duplicate stamp': 1, 'odom: reordered stamp': 1}
    for now in np.arange(0.05, 1.0, 0.05):
        assert inputs.update('odom', odometry(1.0), now)
    assert stale(inputs, 'odometry', 1.0) == '1.00 s old'


def test_a_sender_whose_clock_went_back_is_heard_once_the_old_is_stale(inputs):
    inputs.update('odom', odometry(100.0), 0.0)
    inputs.update('goal', goal(100.0), 0.0)
    assert inputs.update('odom', odometry(0.0), 0.1)
    assert inputs.update('odom', odometry(0.0), 0.3) == ''
    kept = inputs.latest['goal']  # its position still holds, its stamp does not
    assert kept.stamp.nanoseconds == 0
    assert kept.value.time == 0.0


@pytest.mark.parametrize('refused', [False, True])
def test_a_goal_of_the_past_leaves_odometry_as_it_is(inputs, refused):
    """Whether the older goal is accepted or refused, odometry received before stays valid."""
    inputs.adopt(settings(**{'weights.attitude': 0.5}))
    inputs.update('goal', goal(100.0), 0.0)
    inputs.update('odom', odometry(101.0), 2.9)
    known, old = inputs.odometry, goal(50.0, x=7.0)
    if refused:
        oriented(old, *UPRIGHT)
    assert bool(inputs.update('goal', old, 3.0)) == refused
    assert inputs.odometry is known
    assert inputs.latest['goal'].value.position[0] == (5.0 if refused else 7.0)


def test_a_malformed_message_changes_nothing(inputs):
    inputs.update('goal', goal(0.0), 0.0)
    before = inputs.latest['goal']
    assert 'position' in inputs.update('goal', goal(1.0, x=np.nan), 0.1)
    assert inputs.latest['goal'] is before
    np.testing.assert_array_equal(inputs.forecast.at(np.array([1.0])), [[5.0, 0.0]])


def test_stamps_that_nobody_sets_are_told_as_what_they_are(inputs):
    assert inputs.update('odom', odometry(0.0), 0.0) == ''  # simulated time may begin at zero
    refusal = inputs.update('odom', odometry(0.0), 0.1)
    assert 'unset stamp: 0 again; set header.stamp to the time' in refusal
    assert inputs.refused == {'odom: unset stamp': 1}
    assert inputs.update('odom', odometry(NOW / SECOND), 0.2, clock(0.2)) == ''
    refusal = inputs.update('odom', odometry(0.0), 100.0, clock(100.0))  # the valid one is stale
    assert 'unset stamp: 0; set header.stamp to the time' in refusal
    assert inputs.odometry.stamp.nanoseconds == NOW


# --- age


def test_age_is_of_arrival_whatever_the_stamp_and_where_time_stands_still(inputs):
    inputs.update('odom', odometry(1e6), 0.0)  # a stamp far in the future
    inputs.update('goal', goal(1e6), 0.0)
    assert stale(inputs, 'odometry', 0.15) == ''
    assert stale(inputs, 'odometry', 0.25)
    inputs.update('odom', odometry(1e6 + 1), 1.1)
    assert stale(inputs, 'goal', 1.15)
    inputs.update('odom', stamped(odometry, 0.0), 2.0, clock(0.0))
    assert stale(inputs, 'odometry', 2.1, clock(0.0)) == ''
    assert stale(inputs, 'odometry', 2.3, clock(0.0)) == '0.30 s old'


def test_a_stamp_from_the_future_is_refused_and_counted(inputs):
    assert inputs.update('odom', stamped(odometry, 0.09), 0.0, clock(0.0)) == ''
    refusal = inputs.update('odom', stamped(odometry, 0.25), 0.1, clock(0.1))
    assert 'future stamp is 0.15 s ahead; allowed: at most 0.1 s ahead' in refusal
    assert 'future' in inputs.update('goal', stamped(goal, 9.0), 0.1, clock(0.1))
    assert inputs.refused == {'odom: future stamp': 1, 'goal: future stamp': 1}
    assert inputs.odometry.at == 0.0
    assert 'goal' not in inputs.latest


def test_simulated_time_may_trail_by_a_step_and_before_it_starts_nothing_is_of_the_future(inputs):
    assert inputs.update('odom', stamped(odometry, 0.1), 0.0, None) == ''
    assert not inputs.odometry.timed
    assert inputs.untimed == ''  # nor is another clock suspected
    inputs.lag = 0.1
    assert inputs.update('odom', stamped(odometry, 0.19), 0.0, clock(0.0)) == ''
    assert 'future' in inputs.update('odom', stamped(odometry, 0.3), 0.1, clock(0.0))


def test_a_source_once_timed_stays_so(inputs):
    """Messages that a link held back for minutes come in order, but must not pass for fresh."""
    inputs.update('odom', stamped(odometry, 0.0), 0.0, clock(0.0))
    inputs.update('goal', stamped(goal, 0.0), 5.0, clock(1.5))
    assert stale(inputs, 'goal', 5.0, clock(1.5)) == '1.50 s old'
    assert inputs.update('odom', stamped(odometry, 0.1), 120.0, clock(120.0)) == ''
    assert stale(inputs, 'odometry', 120.0, clock(120.0)) == '119.90 s old'
    assert inputs.update('odom', stamped(odometry, -0.1), 240.0, clock(240.0)) == ''
    assert stale(inputs, 'odometry', 240.0, clock(240.0))
    inputs.latest.clear()
    inputs.start_afresh()
    inputs.update('odom', odometry(1.0), 240.1, clock(240.1))
    assert inputs.untimed == 'odom'


def test_a_goal_sent_by_hand_holds_and_a_source_that_streams_and_stops_is_missed(default):
    sent(default, 1.0)
    assert stale(default, 'goal', 1e4) == ''
    sent(default, 60.0, 300.0, 301.5)  # occasional goals are not a stream
    assert stale(default, 'goal', 1e4) == ''
    sent(default, 401.0, 401.5, 402.0)
    assert stale(default, 'goal', 402.9) == ''
    assert stale(default, 'goal', 403.1) == '1.10 s old'
    sent(default, 410.0)  # sent by hand again
    assert stale(default, 'goal', 1e4) == ''


@pytest.mark.parametrize('given', [{'goal_prediction': 'velocity'}, {'goal_timeout': 1.0}])
def test_a_goal_that_moves_on_or_has_a_timeout_gets_stale_at_once(given):
    aged = Inputs(settings(step=0.1, **given))
    sent(aged, 1.0)
    assert stale(aged, 'goal', 2.1) == '1.10 s old'


def test_a_timeout_below_zero_is_none():
    patient = Inputs(settings(step=0.1, goal_timeout=-1.0))
    sent(patient, 1.0, 1.1, 1.2, 1.3)
    assert stale(patient, 'goal', 1e4) == ''
    assert patient.update('goal_path', path(1.3, [(7.0, 1.0)]), 1.3) == ''
    assert stale(patient, 'goal', 1e4) == ''
    np.testing.assert_array_equal(targets(patient, ahead(patient, 1), 1e4), [[7.0, 1.0]])


# --- messages that belong together


ALL = list(range(60))


@pytest.mark.parametrize(
    ('shares', 'waits'),
    [
        (lambda turn: True, ALL),  # in lock-step, from the first message on
        (lambda turn: turn % 15 != 14, ALL),  # occasional losses
        *((lambda turn, every=every: turn % every == 0, [0, 1]) for every in (2, 5, 20)),  # slower
        (lambda turn: turn < 20, ALL[:22]),  # it stops, and is given up after one wait in vain
        (lambda turn: not 20 <= turn < 25, [*ALL[:22], *ALL[34:]]),  # again after 9 of 10
    ],
)
def test_a_source_that_shares_every_stamp_is_waited_for(inputs, shares, waits):
    """Odometry comes at 50 Hz; ``waits`` lists the turns on which it waits for a goal."""
    found = []
    for turn in ALL:
        at = 1.0 + 0.02 * turn
        inputs.update('odom', odometry(at), at)
        if not inputs.complete:
            found.append(turn)
        if shares(turn):
            inputs.update('goal', goal(at, x=at), at)
            assert inputs.complete
            assert targets(inputs, ahead(inputs, 1), at)[0, 0] == at
    assert found == waits


# --- goals


def test_a_forecast_from_outside_is_used_while_it_is_fresh(inputs):
    inputs.update('goal', goal(0.0), 0.0)
    inputs.update('odom', odometry(0.0), 0.0)
    inputs.update('goal_path', path(0.0, [(k, 1.0) for k in range(5)]), 0.0)
    wanted = [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]]
    np.testing.assert_allclose(targets(inputs, ahead(inputs, 3), 0.5), wanted)
    between = targets(inputs, ahead(inputs, 2, 0.05), 0.5)  # as for a plan that starts later
    np.testing.assert_allclose(between, [[1.5, 1.0], [2.5, 1.0]])
    held = targets(inputs, np.array([-1.0, 99.0]), 0.5)  # held at its ends
    np.testing.assert_allclose(held, [[0.0, 1.0], [4.0, 1.0]])
    np.testing.assert_array_equal(targets(inputs, ahead(inputs, 1), 1.5), [[5.0, 0.0]])


def test_the_goal_is_turned_as_its_pose_or_the_last_of_a_fresh_path(inputs):
    assert inputs.snapshot(0.0).wanted is None
    inputs.update('goal', oriented(goal(0.0), np.sqrt(0.5), 0, 0, np.sqrt(0.5)), 0.0)
    np.testing.assert_allclose(inputs.snapshot(0.0).wanted, [[0.0, -1.0], [1.0, 0.0]], atol=1e-9)
    inputs.update('goal_path', oriented(path(0.0, [(0.0, 0.0), (1.0, 1.0)]), 0, 0, 0, 1), 0.0)
    np.testing.assert_allclose(inputs.snapshot(0.5).wanted, -np.eye(2), atol=1e-9)
    np.testing.assert_allclose(inputs.snapshot(1.5).wanted, [[0.0, -1.0], [1.0, 0.0]], atol=1e-9)


def test_a_goal_that_has_no_yaw_is_refused_only_where_one_is_asked_for(inputs):
    assert inputs.update('goal', oriented(goal(1.0), *UPRIGHT), 0.0) == ''
    assert inputs.snapshot(0.0).wanted is None
    inputs.adopt(settings(**{'weights.attitude': 0.5}))
    inputs.update('odom', odometry(1.0), 0.0)
    assert inputs.missing == 'a goal with a yaw on goal or goal_path'
    refusal = inputs.update('goal', oriented(goal(2.0), *UPRIGHT), 0.1)
    assert refusal.startswith('goal refused: pose.orientation is that of a vertical x axis')
    assert inputs.update('goal', goal(3.0), 0.1) == ''
    assert inputs.missing == ''


@pytest.mark.parametrize('before', [None, 'typed', 'stamped'])
def test_a_goal_typed_without_a_stamp_or_a_frame_is_of_the_moment_it_comes(inputs, before):
    inputs.update('odom', stamped(odometry, 0.0), 0.0, clock(0.0))
    if before is not None:
        first = typed(1.0) if before == 'typed' else stamped(goal, 0.0, 1.0)
        assert inputs.update('goal', first, 0.0, clock(0.0)) == ''
    assert inputs.update('goal', typed(2.0), 0.1, clock(0.1)) == ''
    assert inputs.untimed == ''
    assert inputs.latest['goal'].value.time == inputs.odometry.value.time
    np.testing.assert_array_equal(targets(inputs, ahead(inputs, 2), 0.1), [[2.0, 0.0]] * 2)
    assert stale(inputs, 'goal', 1.0, clock(1.0)) == ''
    assert stale(inputs, 'goal', 1.2, clock(1.2)) == '1.10 s old'
    assert inputs.update('goal', stamped(goal, 1.2, 3.0), 1.2, clock(1.2)) == ''
    assert inputs.latest['goal'].timed


def test_typed_goals_and_one_kept_over_a_fresh_start_show_no_motion():
    """When the goal got there is unknown, so that no velocity may be derived from it."""
    moving = Inputs(settings(goal_prediction='velocity'))
    moving.update('odom', odometry(1.0), 1.0)
    for at, message in ((1.0, typed(2.0)), (1.5, typed(4.0)), (9.0, goal(9.0, 6.0))):
        moving.update('odom', odometry(at + 0.1), at)
        assert moving.update('goal', message, at) == ''
        held = [[message.pose.position.x, 0.0]]
        np.testing.assert_array_equal(targets(moving, np.array([19.0]), at), held)
    moving.start_afresh()
    assert moving.missing == 'odometry on odom'
    moving.update('odom', odometry(0.5), 9.1)
    np.testing.assert_array_equal(targets(moving, np.array([19.0]), 9.1), held)
    assert moving.update('goal', goal(0.6, 8.0), 9.2) == ''  # with any stamp
    np.testing.assert_array_equal(targets(moving, np.array([19.0]), 9.2), [[8.0, 0.0]])
    sent(moving, 1.0, 1.1, 1.2)  # a stream soon sends its next goal, or has stopped
    moving.start_afresh()
    assert moving.missing == 'odometry on odom and a goal on goal or goal_path'


def test_a_goal_that_jumps_is_refused_until_the_old_one_is_stale(limited, inputs):
    assert limited.update('goal', goal(1.0, x=5.0), 0.0) == ''
    assert limited.update('goal', goal(1.1, x=5.5), 0.1) == ''
    refusal = limited.update('goal', goal(1.2, x=9.0), 0.2)
    assert 'goal jump is 3.5 m; allowed: at most goal_jump_limit, 0.5 m' in refusal
    assert limited.refused == {'goal: goal jump': 1}
    assert limited.latest['goal'].value.position[0] == 5.5
    assert limited.update('goal', goal(2.2, x=9.0), 1.2) == ''  # it has really moved
    np.testing.assert_array_equal(limited.forecast.at(np.array([9.9])), [[9.0, 0.0]])
    assert inputs.update('goal', goal(1.0, x=5.0), 0.0) == ''
    assert inputs.update('goal', goal(1.1, x=-900.0), 0.1) == ''  # unlimited by default


def test_a_path_that_jumps_is_refused_and_one_that_really_moved_leaves_the_goal(limited):
    def along(seconds, x):
        return path(seconds, [(x + 0.1 * k, 0.0) for k in range(20)])

    assert limited.update('goal_path', along(1.0, 5.0), 0.0) == ''
    assert limited.update('goal_path', along(1.2, 5.2), 0.2) == ''  # on the path
    assert 'goal jump is 2 m' in limited.update('goal_path', along(1.4, 7.4), 0.4)
    limited.update('odom', odometry(1.0), 0.0)
    limited.update('goal', goal(2.4, x=5.0), 1.4)
    assert limited.update('goal_path', path(2.5, [(20.0, 0.0)]), 1.5) == ''
    np.testing.assert_array_equal(targets(limited, ahead(limited, 1), 2.7), [[5.0, 0.0]])
