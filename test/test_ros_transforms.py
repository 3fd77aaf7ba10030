# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Goals, obstacles and plans in other frames: transformed, or refused in one line."""

import math
import time
from importlib.util import find_spec

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from planners import odometry, settings, tf
from stepping import targets
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Frames, Stamp
from orbimpc_ros.ros.planner.core import Inputs
from orbimpc_ros.ros.transforms import TF, TF_STATIC, between, matrix, stated

OTHER = '/uav2/plan'
QUARTER = math.pi / 2
TURNED = f'map odom 10.0 0.0 2.0 0.0 0.0 {QUARTER}'  # x of odom is y of map


def inputs(**given):
    return Inputs(settings(**{'avoid': (OTHER,), 'avoid_radius': 1.0, **given}))


def in_map(seconds):
    return Stamp(round(seconds * SECOND), Frames('map', 'base_link'))


def goal(seconds, x, y, yaw=0.0, z=0.0):
    message = messages.goal_message(in_map(seconds), np.array([x, y, z]))
    message.pose.orientation = messages.quaternion(exp(np.array([0.0, 0.0, yaw])))
    return message


def seen(seconds, place, size=(1.0, 1.0, 1.0)):
    head = messages.header(round(seconds * SECOND), 'map')
    marker = Marker(header=head, ns='a', type=Marker.CUBE)
    marker.pose = messages.pose(np.array(place), np.eye(3))
    marker.scale = messages.vector(np.array(size))
    return MarkerArray(markers=[marker])


def target(box, seconds=1.0):
    return targets(box, np.array([seconds]), 0.0)[0]


# --- laws


@pytest.mark.parametrize('seed', range(5))
def test_transforms_are_interpolated_from_one_end_to_the_other(seed):
    rng = np.random.default_rng(seed)
    a, b = (matrix(exp(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
    third = between(a, b, 0.3)
    for left, right in (
        (between(a, b, 0.0), a),
        (between(a, b, 1.0), b),
        (between(b, a, 0.7), third),
        (third[:3, :3] @ third[:3, :3].T, np.eye(3)),
    ):
        np.testing.assert_allclose(left, right, atol=1e-12)


def test_roll_pitch_and_yaw_are_about_fixed_axes_as_in_tf():
    found = stated([f'map odom 1 2 3 {QUARTER} 0 {QUARTER}'])['odom'].at(0, 0.0)
    np.testing.assert_allclose(found @ [0, 1, 0, 1], [1, 2, 4, 1], atol=1e-12)


def test_frames_are_joined_through_what_they_have_in_common():
    known = inputs(tf=True)
    known.update(TF_STATIC, tf(0.0, 'earth', 'map', (100.0, 0.0, 0.0)), 0.0)
    known.update(TF, tf(1.0, 'earth', 'odom', (100.0, 5.0, 0.0), QUARTER), 0.0)
    known.update(TF_STATIC, tf(0.0, 'map', 'rope', (0.0, 7.0, 0.0)), 0.0)
    found = known.transforms.move(messages.header(SECOND, 'rope'))
    np.testing.assert_allclose(found[:3, 3], [2.0, 0.0, 0.0], atol=1e-12)


# --- messages in other frames


def test_a_goal_is_moved_and_turned_by_a_stated_transform():
    box = inputs(transforms=(TURNED,), **{'weights.attitude': 1.0})
    assert box.update('goal', goal(1.0, 10.0, 4.0, yaw=QUARTER, z=5.0), 0.0) == ''
    np.testing.assert_allclose([*target(box), box.altitude], [4.0, 0.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(box.snapshot(0.0).wanted, np.eye(2), atol=1e-12)


def test_a_path_an_obstacle_and_the_plan_of_another_are_moved():
    box = inputs(transforms=(TURNED,))
    places = [np.array([10.0, 1.0]), np.array([10.0, 2.0])]
    path = messages.path_message(in_map(1.0), 1.0, map(messages.pose, places))
    assert box.update('goal_path', path, 0.0) == ''
    np.testing.assert_allclose(target(box, 1.5), [1.5, 0.0], atol=1e-12)
    box.update('odom', odometry(1.0), 0.0)
    assert box.update('obstacles', seen(1.0, (10.0, 3.0, 0.0), (2.0, 1.0, 1.0)), 0.0) == ''
    assert box.update(OTHER, path, 0.0) == ''
    cube, other = box.traffic(1.0).hazards(1.0)
    np.testing.assert_allclose(cube.body.minimum + cube.moved(np.zeros(1))[0], [2.5, -1.0])
    there = other.body.centre + other.moved(np.array([0.5]))[0]
    np.testing.assert_allclose(there, [1.5, 0.0], atol=1e-9)


def test_a_goal_sent_once_follows_the_frame_that_it_stands_in():
    box = inputs(tf=True)
    box.update(TF, tf(1.0, 'map', 'odom', (0.0, 0.0, 0.0)), 0.0)
    box.update('goal', goal(1.0, 5.0, 0.0), 0.0)
    box.update('odom', odometry(1.0), 0.0)
    np.testing.assert_allclose(target(box), [5.0, 0.0])
    box.update(TF, tf(1.5, 'map', 'odom', (2.0, 0.0, 0.0)), 0.5)
    box.update('odom', odometry(1.6), 0.6)
    np.testing.assert_allclose(target(box), [3.0, 0.0])
    assert box.displaced == ''
    box.update('odom', odometry(3.0), 2.0)
    np.testing.assert_allclose(target(box), [3.0, 0.0])
    assert box.displaced.startswith('the goal stays where it was: stale transform: map -> odom')


# --- refusals


def refusal(box, at=1.0, frame='map'):
    message = goal(at, 5.0, 0.0)
    message.header.frame_id = frame
    said = box.update('goal', message, 0.0)
    assert said.startswith('goal refused: ')
    assert '\n' not in said
    assert 'goal' not in box.latest
    return said, dict(box.refused)


def test_a_missing_a_stale_and_an_extrapolated_transform_are_told_apart_and_counted():
    said, counts = refusal(inputs())
    assert "'map'; allowed: 'odom'; for others, set tf: true, or give transforms" in said
    assert counts == {'goal: header.frame_id': 1}
    box = inputs(tf=True)
    said, counts = refusal(box)
    assert 'missing transform: none from map to odom; publish it on /tf' in said
    box.update(TF, tf(2.0, 'map', 'odom', (0.0, 0.0, 0.0)), 0.0)
    said, counts = refusal(box, 2.5)
    assert 'stale transform: map -> odom is 0.5 s older than the message; at most' in said
    said, counts = refusal(box, 1.5)
    assert 'extrapolated transform: map -> odom is known only from 0.5 s later on' in said
    wrong = 'missing', 'stale', 'extrapolated'
    assert set(counts) == {f'goal: {each} transform' for each in wrong}
    box.update(TF, tf(3.0, 'map', 'odom', (2.0, 0.0, 0.0)), 0.0)
    box.update('goal', goal(2.5, 5.0, 0.0), 0.0)
    np.testing.assert_allclose(target(box), [4.0, 0.0], atol=1e-12)  # between the stamps


def test_a_transform_out_of_order_is_passed_over_and_a_jump_of_time_forgets_all():
    box = inputs(tf=True)
    box.update(TF, tf(2.0, 'map', 'odom', (1.0, 0.0, 0.0)), 0.0)
    box.update(TF, tf(1.0, 'map', 'odom', (9.0, 0.0, 0.0)), 0.0)
    late = box.update(TF, tf(99.0, 'map', 'odom', (7.0, 0.0, 0.0)), 0.0, 2 * SECOND)
    assert 'future stamp is 97 s ahead' in late  # no later one would be in order
    box.update('goal', goal(2.0, 5.0, 0.0), 0.0)
    np.testing.assert_allclose(target(box), [4.0, 0.0])
    box.latest.clear()
    box.start_afresh()
    assert 'missing transform' in refusal(box, 2.0)[0]


@pytest.mark.parametrize('spoilt', [math.nan, 1e300])
def test_a_transform_that_is_no_number_is_refused_where_it_is_used(spoilt):
    box = inputs(tf=True)
    box.update(TF, tf(1.0, 'map', 'odom', (spoilt, 0.0, 0.0)), 0.0)
    said, counts = refusal(box)
    assert 'invalid transform: map -> odom: translation is ' in said
    assert counts == {'goal: invalid transform': 1}  # by kind: names from outside are unlimited


def test_a_frame_that_lies_in_itself_leads_nowhere():
    box = inputs(tf=True)
    box.update(TF, tf(1.0, 'a', 'odom', (0.0, 0.0, 0.0)), 0.0)
    box.update(TF, tf(1.0, 'odom', 'a', (0.0, 0.0, 0.0)), 0.0)
    assert 'missing transform' in refusal(box)[0]


@pytest.mark.parametrize('name', ['odom', '', 'b' * 999])
def test_a_transform_without_a_proper_frame_is_refused_alone(name):
    box = inputs(tf=True)
    wrong, rope = (tf(1.0, 'odom', each, np.zeros(3)) for each in (name, 'rope'))
    wrong.transforms += rope.transforms
    assert '/tf refused: frames is ' in box.update(TF, wrong, 0.0)
    assert box.transforms.move(messages.header(SECOND, 'rope')) is not None


@pytest.mark.parametrize(
    ('words', 'told'),
    [
        *((f'map odom {numbers}', '') for numbers in ('1 2 3', '0 0 0 0 0 nan', 'a b c d e f')),
        ('map map 0 0 0 0 0 0', ''),
        (TURNED.replace('map', 'earth'), 'one parent of odom'),
    ],
)
def test_a_transform_that_is_stated_badly_is_refused(words, told):
    with pytest.raises(BadInput, match=f'transforms.*{told}'):
        settings(transforms=(words, TURNED))


@pytest.mark.skipif(bool(find_spec('tf2_msgs')), reason='it is installed')
def test_tf_without_its_messages_is_refused_in_one_line(launch):
    process = launch('planner', {'tf': True})
    assert process.wait() == 2
    assert 'tf2_msgs is missing; install ros-<distro>-tf2-msgs' in process.output


def test_a_planner_hears_the_transforms_of_its_machine(launch, observer):
    found = pytest.importorskip('tf2_msgs.msg')
    process = launch('planner', {'tf': True})
    sent = observer.node.create_publisher(found.TFMessage, TF, 10)
    given = observer.node.create_publisher(PoseStamped, 'goal', 1)

    def step():
        now = time.time()
        sent.publish(found.TFMessage(transforms=tf(now, 'map', 'odom', np.zeros(3)).transforms))
        given.publish(goal(now, 1.0, 0.0))
        return 'waits for odometry' in process.output

    observer.until(step, 'a goal in map that is taken')
