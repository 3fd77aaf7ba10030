# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Markers of obstacles and plans of other vehicles: the resulting hazards, and refusals."""

import math
from collections import Counter

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Pose
from planners import FRAMES, goal, odometry, settings
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Ball, Box
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp, header, read_obstacle, shown
from orbimpc_ros.ros.planner.core import Inputs, others
from orbimpc_ros.ros.topics import resolving

CUBE, SPHERE, CYLINDER = Marker.CUBE, Marker.SPHERE, Marker.CYLINDER
OTHER = '/uav2/plan'


def marker(seconds=1.0, place=(0.0, 0.0, 0.0), number=0, kind=SPHERE, **more):
    """Return a marker; ``size`` has its three extents, ``turned`` is its attitude."""
    found = Marker(header=header(round(seconds * 1e9), 'odom'), ns='a', id=number, type=kind)
    found.pose = messages.pose(np.array(place), more.pop('turned', np.eye(3)))
    found.scale = messages.vector(np.array(more.pop('size', (1.0, 1.0, 1.0))))
    for name, value in more.items():
        setattr(found, name, value)
    return found


def array(*markers):
    return MarkerArray(markers=list(markers))


def body_of(given, dimension):
    _, seen = read_obstacle(given, dimension, FRAMES)
    return seen.body


@pytest.fixture
def inputs():
    given = settings(avoid=(OTHER,), avoid_radius=1.0, forward=20.0)
    return Inputs(given)


def hazards(inputs, at=1.0):
    return inputs.traffic(at).hazards(at)


# --- shapes


def inside(kind, size, rng, count=500):
    """Return points of a shape, up to its surface, in its own axes, shape (count, 3)."""
    points = rng.uniform(-1.0, 1.0, (count, 3))
    if kind == CUBE:
        points[: count // 2] = np.sign(points[: count // 2])
    elif kind == SPHERE:
        points /= np.linalg.norm(points, axis=1)[:, None]
    else:
        points[:, :2] /= np.linalg.norm(points[:, :2], axis=1)[:, None]
        points[: count // 2, 2] = np.sign(points[: count // 2, 2])
    return 0.5 * size * points


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('kind', [CUBE, SPHERE, CYLINDER])
def test_a_body_covers_its_marker_however_that_is_turned(kind, dimension):
    rng = np.random.default_rng([81, kind, dimension])
    for draw in range(60):
        size = rng.uniform(0.1, 4.0, 3)
        turned = exp(rng.uniform(-3.0, 3.0, 3)) if draw else np.eye(3)
        place = rng.uniform(-5.0, 5.0, 3)
        body = body_of(marker(place=place, kind=kind, size=size, turned=turned), dimension)
        points = place + inside(kind, size, rng) @ turned.T
        assert (body.depth(points[:, :dimension]) >= -1e-9).all()


def test_bodies_are_tight():
    box = body_of(marker(place=(1.0, 2.0, 3.0), kind=CUBE, size=(2.0, 4.0, 6.0)), 3)
    np.testing.assert_allclose([box.minimum, box.maximum], [[0.0, 0.0, 0.0], [2.0, 4.0, 6.0]])
    disc = body_of(marker(kind=CYLINDER, size=(2.0, 3.0, 9.0)), 2)
    assert (type(disc), disc.radius) == (Ball, 1.5)  # the longer axis, as seen from above
    assert body_of(marker(size=(1.0, 2.0, 3.0)), 3).radius == 1.5
    along_y = exp(np.array([math.pi / 2, 0.0, 0.0]))
    lying = body_of(marker(kind=CYLINDER, size=(1.0, 1.0, 9.0), turned=along_y), 3)
    np.testing.assert_allclose(lying.maximum - lying.minimum, [1.0, 9.0, 1.0])


@pytest.mark.parametrize('dimension', [2, 3])
def test_what_is_shown_of_a_body_is_read_as_that_body(dimension):
    bodies = (
        Ball(np.arange(1.0, dimension + 1.0), 0.7),
        Box(np.zeros(dimension), np.ones(dimension)),
    )
    for body in bodies:
        assert body_of(shown(marker(), body), dimension) == body


# --- markers added, deleted and refused


@pytest.mark.parametrize(
    ('change', 'culprit'),
    [
        ({'size': (1.0, math.nan, 1.0)}, 'scale'),
        ({'size': (1.0, -1.0, 1.0)}, 'scale'),
        ({'size': (0.0, 1.0, 1.0)}, 'scale'),
        ({'size': (1.0, 1e9, 1.0)}, 'scale'),
        ({'place': (math.nan, 0.0, 0.0)}, 'pose.position'),
        ({'place': (math.inf, 0.0, 0.0)}, 'pose.position'),
        ({'kind': Marker.ARROW}, 'type'),
        ({'action': 7}, 'action'),
        ({'header': header(10**9, 'map')}, 'header.frame_id'),
        ({'seconds': 5.0}, 'future stamp'),
        ({'seconds': 0.5, 'lifetime': Duration(nanosec=10**8)}, 'stale stamp'),
        ({'seconds': 0.0, 'lifetime': Duration(nanosec=10**8)}, 'unset stamp'),
        ({'lifetime': Duration(sec=-1)}, 'lifetime.sec'),
        ({'lifetime': Duration(nanosec=2 * 10**9)}, 'lifetime.nanosec'),
        ({'ns': 'n' * 1000}, 'ns'),
        ({'pose': Pose(orientation=messages.Quaternion(w=0.0))}, 'pose.orientation'),
    ],
)
def test_a_bad_marker_is_refused_counted_and_the_rest_goes_on(inputs, change, culprit):
    inputs.update('odom', odometry(1.0), 0.0)
    bad = marker(**{'number': 1, **change})
    refusal = inputs.update('obstacles', array(bad, marker(), bad), 0.0, 10**9)
    assert refusal.startswith(f'obstacles refused: {culprit}')
    assert refusal.endswith(' (the first of 2)')
    assert '\n' not in refusal
    assert inputs.refused == {f'obstacles: {culprit}': 2}
    assert len(hazards(inputs)) == 1


def test_a_box_thinner_than_rounding_stays_one_far_away(inputs):
    for k in (1.0, 2.0):
        inputs.update(
            'obstacles', array(marker(k, (k, 0.0, 0.0), kind=CUBE, size=(1e-12, 1, 1))), k
        )
    (hazard,) = hazards(inputs, 1e5)
    assert np.all(hazard.body.minimum < hazard.body.centre)


def test_one_place_at_a_time_for_each_name(inputs):
    twice = array(marker(place=(9.0, 0.0, 0.0)), marker(place=(5.0, 0.0, 0.0)))
    assert 'duplicate id' in inputs.update('obstacles', twice, 0.0)
    assert inputs.update('obstacles', array(marker(place=(9.0, 0.0, 0.0))), 0.0) == ''
    assert 'reordered stamp' in inputs.update('obstacles', array(marker(0.5)), 0.0)
    np.testing.assert_array_equal(hazards(inputs)[0].body.centre, [9.0, 0.0])
    assert inputs.refused == {'obstacles: duplicate id': 1, 'obstacles: reordered stamp': 1}


def test_a_jump_is_told_and_counted(inputs):
    inputs.update('obstacles', array(marker(ns='a\n')), 0.0)
    told = inputs.update('obstacles', array(marker(1.1, place=(9.0, 0.0, 0.0), ns='a\n')), 0.0)
    assert told == r"obstacles: 'a\n/0' jumped at 90 m/s: taken for a new body at rest"
    assert inputs.refused == {'obstacles: jump': 1}
    (hazard,) = hazards(inputs, 2.1)
    np.testing.assert_array_equal(hazard.body.centre, [9.0, 0.0])
    assert not hazard.moved(np.ones(1)).any()


def test_ten_thousand_markers_are_too_many_and_those_known_stay(inputs):
    crowd = array(*(marker(place=(0.01 * k, 5.0, 0.0), number=k) for k in range(10_000)))
    refusal = inputs.update('obstacles', crowd, 0.0)
    assert refusal.startswith('obstacles refused: count is 10000; allowed: 1000')
    assert len(hazards(inputs)) == 1000
    assert 'count is b/0' in inputs.update('obstacles', array(marker(ns='b')), 0.0)
    assert inputs.refused == {'obstacles: count': 2}


def test_markers_come_and_go_in_their_order(inputs):
    def left(*markers):
        assert inputs.update('obstacles', array(*markers), 0.0) == ''
        return list(inputs.bodies)

    one, every = {'action': Marker.DELETE, 'header': header(0, '')}, {'action': Marker.DELETEALL}
    assert left(*(marker(number=k) for k in (1, 2)), marker(ns='b')) == ['a/1', 'a/2', 'b/0']
    assert left(marker(number=1, **one)) == ['a/2', 'b/0']
    assert left(marker(**every), marker(number=3)) == ['b/0', 'a/3']  # of its namespace
    assert left(marker(ns='', **every)) == []


def test_a_lifetime_ends_by_the_stamps_and_what_lasts_stays_over_a_reset(inputs):
    moving = [marker(at, (at, 0.0, 0.0)) for at in (1.0, 2.0)]
    passing = marker(number=1, lifetime=Duration(sec=2))
    inputs.update('obstacles', array(*moving, passing), 0.0)
    assert [len(hazards(inputs, at)) for at in (3.0, 3.01)] == [2, 1]
    inputs.update('obstacles', array(passing), 0.0)
    inputs.start_afresh()
    (wall,) = hazards(inputs, 0.5)  # at rest where it was, although time went back
    np.testing.assert_array_equal(wall.body.centre + wall.moved(np.ones(1))[0], [2.0, 0.0])


def test_a_reset_forgets_what_moved(inputs):
    inputs.update('obstacles', array(marker(3.5), marker(1.0, number=1)), 0.0)
    # The stamp is that of the first marker.
    assert inputs.heard['traffic_stamps'] == {'obstacles': 3_500_000_000}
    everything = marker(action=Marker.DELETEALL, header=header(0, ''))
    assert inputs.update('obstacles', array(everything), 0.0) == ''
    assert inputs.heard['traffic_stamps'] == {'obstacles': 0}
    inputs.update(OTHER, plan(1.0), 0.0)
    inputs.latest.clear()
    inputs.start_afresh()
    assert inputs.traffic(1.0) is None
    assert inputs.heard['traffic_stamps'] == {}


# --- plans of other vehicles


def plan(seconds, step=0.5, speed=1.0, frame='odom'):
    stamp = Stamp(round(seconds * 1e9), Frames(frame))
    places = [np.array([speed * step * k, 3.0]) for k in range(5)]
    return messages.path_message(stamp, step, map(messages.pose, places))


def test_a_plan_is_kept_clear_of_by_the_radius_until_a_later_one(inputs):
    assert inputs.update(OTHER, plan(1.0), 0.0) == ''
    (hazard,) = hazards(inputs, 1.25)
    np.testing.assert_allclose(hazard.body.centre, [0.25, 3.0])
    assert 1.0 < hazard.body.radius <= 1.001  # plans are exact up to rounding
    assert inputs.update(OTHER, plan(1.0), 0.0) == ''
    assert 'reordered stamp' in inputs.update(OTHER, plan(0.5), 0.0)


@pytest.mark.parametrize(
    ('change', 'culprit'),
    [
        ({'frame': 'map'}, 'header.frame_id'),
        ({'step': 0.0}, 'goal_path stamps'),
        ({'speed': math.nan}, 'pose.position'),
        ({'seconds': 9.0}, 'future stamp'),
    ],
)
def test_a_bad_plan_is_refused_and_the_last_one_flown_on(inputs, change, culprit):
    inputs.update(OTHER, plan(1.0), 0.0)
    refusal = inputs.update(OTHER, plan(**{'seconds': 1.1, **change}), 0.0, 10**9)
    assert refusal.startswith(f'{OTHER} refused: {culprit}')
    assert inputs.refused == Counter({f'{OTHER}: {culprit}': 1})
    assert len(hazards(inputs)) == 1


def test_a_fleet_may_share_its_list_of_plans():
    def resolve(name):
        return name if name.startswith('/') else f'/uav1/{name}'

    given = settings(avoid=('/uav1/plan', 'plan', OTHER, OTHER, 'that/plan'), avoid_radius=1.0)
    assert others(given, resolve) == (OTHER, '/uav1/that/plan')


def test_who_shares_stamps_waits_for_those_of_lesser_names_alone():
    topics = '/a/plan', '/c/plan'
    inputs = Inputs(settings(avoid=topics, avoid_radius=1.0), resolving('/b'))
    inputs.update('goal', goal(0.5), 0.0)
    for second in (1.0, 2.0, 3.0):
        inputs.update('odom', odometry(second), second)
        assert inputs.complete == (second == 1.0)  # until stamps are known to be shared
        inputs.update('/c/plan', plan(second), second)
        assert inputs.complete == (second == 1.0)
        inputs.update('/a/plan', plan(second), second)
        assert inputs.complete == (second == 1.0)  # until the obstacles of that stamp have come
        inputs.update('obstacles', array(marker(second)), second)
        assert inputs.complete


@pytest.mark.parametrize(
    ('step', 'heard', 'waits'),
    [
        (1.0, (0.7, 1.7), True),  # it measures earlier, and its plan is on its way
        (1.0, (1.3, 2.3), False),  # it measures later, and waits itself
        (1.0, (1.0, 2.0), False),  # at the same time, and its name does not come first
        (1.0, (0.4, 1.4), False),  # it is silent
        (0.1, (2.7, 2.8), False),  # the steps are too short for waiting
    ],
)
def test_who_has_measured_before_is_waited_for_until_its_plan_is_there(step, heard, waits):
    given = settings(avoid=(OTHER,), avoid_radius=1.0, step=step)
    inputs = Inputs(given, resolving('/uav1'))
    inputs.update('goal', goal(0.5), 0.0)
    came = [(at, OTHER, plan) for at in heard] + [(at, 'odom', odometry) for at in (1.0, 2.0)]
    for at, topic, make in sorted(came, key=lambda each: each[:2]):
        inputs.update(topic, make(at), at)
        assert inputs.complete or topic == OTHER
    inputs.update('odom', odometry(3.0), 3.0)
    assert inputs.complete != waits
    inputs.update(OTHER, plan(2.9), 3.0)
    assert inputs.complete
