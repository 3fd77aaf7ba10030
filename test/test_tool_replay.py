# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Golden bags as regression tests, and the differences that a replay must report."""

import importlib
import math
from dataclasses import replace
from functools import partial, reduce

import numpy as np
import pytest
from bags import GOLDEN, changed, rewritten, ros2_bag, write
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, QuaternionStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry
from planners import odometry, tf
from planners import settings as settings_of
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.mpc.geometry.rotations import from_quaternion
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.outcome import Cause
from orbimpc_ros.mpc.plan import stop
from orbimpc_ros.mpc.problem import Ball
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Frames, Stamp, shown
from orbimpc_ros.ros.transforms import TF
from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.bags import Message, fields
from orbimpc_ros.tool.history import of_bag
from orbimpc_ros.tool.offline import OfflinePlanner
from orbimpc_ros.tool.replay import (
    RecordedTick,
    Recording,
    distance,
    published,
    recorded_command,
    recording_of,
    replayed,
    tolerance,
)

# Not the rope: near it, the last bits of NumPy's sums decide whether a search finds a plan.
ANSWERS = ('/cmd_vel', '/tick', '/rotation')
FLIGHTS = (
    *('retrieval', 'dubins', 'spacecraft', 'obstacles', 'multirotor'),
    *('disturbed', 'faulty', 'fixed_wing', 'lander', 'cessna', 'servicer'),
)
RETRIEVAL = GOLDEN / 'retrieval'


@pytest.fixture
def replay(tool):
    return partial(tool, 'replay')


def without(*topics):
    return lambda each: None if each.topic in topics else each


# --- golden bags


def quickly(name):
    """Return a flight's name as a parameter, skipped if plain Python would search for minutes."""
    reason = 'searched for minutes in plain Python: pip install numba'
    slow = name in ('fixed_wing', 'cessna') and not COMPILED
    return pytest.param(name, marks=pytest.mark.skipif(slow, reason=reason))


@pytest.mark.parametrize('name', [quickly(each) for each in FLIGHTS])
def test_a_golden_bag_is_answered_as_it_was(replay, name):
    if name == 'multirotor' and not COMPILED:
        # Near the goal costs are tiny, and the general program is off by 5e-6 of them.
        pytest.skip("numba is not installed: pip install 'orbimpc_ros[fast]' runs this")
    code, out, err = replay(GOLDEN / name)
    assert code == 0, out + err
    assert out.endswith('differences   none\n')
    assert err == ''


# --- differences that must be reported


def nudged(path, amount):
    """Return a change that adds ``amount`` to a number in a message."""
    *way, last = path.split('.')

    def change(message):
        holder = reduce(getattr, way, message)
        setattr(holder, last, getattr(holder, last) + amount)

    return change


def reported(key, value):
    """Return a change of a value that a tick reports."""

    def change(message):
        next(pair for pair in message.status[0].values if pair.key == key).value = value

    return change


# A change of the messages at 7 s, and the difference expected from it, if any.
SPOILT = {
    'speed': (TwistStamped, nudged('twist.linear.x', 2e-4), 'speed'),
    'a little speed': (TwistStamped, nudged('twist.linear.x', 0.5e-4), ''),
    'rate': (TwistStamped, nudged('twist.angular.z', 2e-3), 'body_rate'),
    'rotation': (QuaternionStamped, nudged('quaternion.x', 1e-3), 'rotation'),
    'objective': (DiagnosticArray, reported('objective', '1.0'), 'objective'),
    'gap': (DiagnosticArray, reported('gap', '0.5'), 'gap'),
    'a word for a number': (DiagnosticArray, reported('gap', '"NaN"'), ''),  # not compared
    'no number': (DiagnosticArray, reported('solve_time_ms', 'NaN'), ''),
    'no count': (DiagnosticArray, reported('goal_counts', '{"goal": 0.5, "obstacles": 1}'), ''),
    'no end of digits': (DiagnosticArray, reported('advanced', '9' * 400), ''),
    'no end of lists': (DiagnosticArray, reported('nodes', '[' * 100_000), ''),
    'status': (DiagnosticArray, reported('status', 'feasible'), 'status'),
    'fallback': (DiagnosticArray, reported('fallback', 'shifted plan'), 'fallback'),
    'odometry': (Odometry, nudged('pose.pose.orientation.w', 7.0), 'status optimal -> failed'),
}
TOPICS = {
    TwistStamped: '/cmd_vel',
    QuaternionStamped: '/rotation',
    DiagnosticArray: '/tick',
    Odometry: '/odom',
}


@pytest.mark.parametrize(('kind', 'change', 'said'), SPOILT.values(), ids=SPOILT)
def test_what_was_answered_is_compared_within_its_tolerance(replay, tmp_path, kind, change, said):
    """Ticks after the changed one must agree with the recording again."""

    def apply(message):
        if message.header.stamp.sec == 7:
            change(message)

    path = rewritten(RETRIEVAL, tmp_path / 'bag', changed(TOPICS[kind], kind, apply))
    code, out, _ = replay(path)
    assert code == bool(said)
    if said:
        lines = out.splitlines()
        assert any(each.startswith(f'tick 7 at 7.000 s: {said}') for each in lines)
        assert {each.split()[1] for each in lines if each.startswith('tick')} == {'7'}
        assert 'in 1 ticks; worst ' in ' '.join(out.split())
    if kind is Odometry:
        assert 'odom refused: pose.orientation' in replay(path, '--tick', 7)[1]


@pytest.mark.parametrize('amount', [1e-3, 1e308, math.inf])  # the latter are no thrusts at all
def test_one_difference_does_not_cause_all_that_follow(replay, tmp_path, amount):
    """The applied thrust, which odometry lacks, is taken from the recorded command."""

    def change(message):
        if message.header.stamp.sec == 4:
            message.wrench.force.x += amount

    source = GOLDEN / 'spacecraft'
    path = rewritten(source, tmp_path / 'bag', changed('/cmd_thrust', WrenchStamped, change))
    code, out, _ = replay(path)
    assert code == 1
    ticks = {int(line.split()[1]) for line in out.splitlines() if line.startswith('tick')}
    assert ticks <= {4, 5}  # its own tick, and the next one, from another thrust


def overtaken(raw):
    """Send two more goals before each answered one; the counts say that neither was taken."""
    for each in raw:
        for before in (2, 1) if each.topic == '/goal' and each.stamp > 0 else ():
            message = deserialize_message(each.data, PoseStamped)
            message.header.stamp = messages.time_message(each.stamp - before)
            message.pose.position.x += before
            yield each._replace(data=serialize_message(message), sent=each.sent - before)
        yield each


def early(raw):
    """Send each goal before the previous answer, which by send times would have known it."""
    for each in raw:
        later = {'/goal': -500_000_000}.get(each.topic, 700_000_000 * (each.topic in ANSWERS))
        yield each._replace(sent=max(1, each.sent + later))


def repeated(raw):
    yield from raw
    yield from (e._replace(sent=e.sent + 10_000_000) for e in raw if e.topic in ANSWERS)


def halved(raw):
    """Yield odometry as from ArduPilot: a pose, and a twist in world axes."""
    for each in raw:
        if each.topic != '/odom':
            yield each
            continue
        odometry = deserialize_message(each.data, Odometry)
        pose = PoseStamped(header=odometry.header, pose=odometry.pose.pose)
        twist = TwistStamped(header=odometry.header, twist=odometry.twist.twist)
        q, v = pose.pose.orientation, twist.twist.linear
        turned = from_quaternion(np.array([q.w, q.x, q.y, q.z]), 3)
        twist.twist.linear = messages.vector(turned @ [v.x, v.y, v.z])
        for topic, half in (('/pose', pose), ('/twist', twist)):
            kind = f'geometry_msgs/msg/{type(half).__name__}'
            yield each._replace(topic=topic, type=kind, data=serialize_message(half))


HALVES = ('--set', 'odometry=pose_twist', '--set', 'velocity_frame=world')


@pytest.mark.parametrize(
    ('name', 'rewrite', 'words', 'inputs'),
    [
        ('obstacles', overtaken, (), 4 * 30 - 2),
        ('retrieval', early, (), 2 * 26),
        ('retrieval', repeated, (), 2 * 26),
        ('retrieval', halved, HALVES, 2 * 26),
    ],
)
def test_what_is_sent_otherwise_is_answered_as_it_was(
    replay, tmp_path, name, rewrite, words, inputs
):
    raw = bags.raw(GOLDEN / name)
    path = write(tmp_path / 'bag', list(rewrite(raw)), bags.notes(GOLDEN / name))
    code, out, _ = replay(path, *words)
    assert code == 0, out
    assert f'replayed      {sum(each.topic == "/odom" for each in raw)} ticks' in out
    assert f'inputs        {inputs}, 0 refused' in out
    assert len(of_bag(path).times) >= 26  # plots can read it, too


def test_velocities_in_the_world_are_plotted_in_the_world(tmp_path):
    values, raw = settings.changed(settings.of_bag(RETRIEVAL), HALVES[1::2]), bags.raw(RETRIEVAL)
    path = write(tmp_path / 'bag', list(halved(raw)), {'parameters': settings.text(values)})
    np.testing.assert_allclose(of_bag(path).velocities, of_bag(RETRIEVAL).velocities, atol=1e-9)


def test_a_recorded_rate_is_about_the_vehicles_own_axes():
    known, rate = settings_of(dimension=3, thrust_axis='z'), np.array([0.1, 0.2, 0.3])
    message = messages.twist_message(Stamp(0, known.frames), 1.0, rate)
    command = recorded_command(known, stop(np.eye(3)), published({'cmd_vel': message}))
    np.testing.assert_allclose(command.body_rate, rate)


def test_a_lost_goal_is_known_by_what_the_tick_says_not_by_its_words(replay, tmp_path, monkeypatch):
    """A plan held without a solve is recognised by fields of its tick, not by its reason."""
    monkeypatch.syspath_prepend(str(GOLDEN))
    make = importlib.import_module('make')
    hidden = ('faults.occlusion_length=4.0', 'goal_timeout=1.5', 'max_ticks=12')
    monkeypatch.setitem(make.FLIGHTS, 'hidden', ('retrieval', hidden))
    make.make('hidden', tmp_path / 'hidden')
    held = []

    def reworded(message):
        values = {pair.key: pair for pair in message.status[0].values}
        if values['reason'].value.startswith('the goal is'):
            held.append(values['fallback'].value)
            values['reason'].value = 'nobody has seen it for a while'

    change = changed('/tick', DiagnosticArray, reworded)
    path = rewritten(tmp_path / 'hidden', tmp_path / 'bag', change)
    assert 'shifted plan' in held
    code, out, _ = replay(path)
    assert code == 0, out


def test_a_planner_that_starts_afresh_is_known_by_the_cause_not_by_its_words():
    """Its inputs are forgotten, so that the next answer has no odometry."""
    recording = recording_of(RETRIEVAL)
    first = recording.answers[0]
    forgotten, kept = (Cause.AFRESH, Cause.RESET), (Cause.DISABLED, 'sabotage', None)
    for cause in (*forgotten, *kept):
        fallback = 'safe command' if cause in forgotten else ''
        said = {'cause': cause, 'reason': 'starting afresh or not', 'solve_time_ms': 0.0}
        answers = (first, replace(first, answer=said), first)
        ticks = replayed(replace(recording, answers=answers))
        *_, last = (each.answer for each in ticks)
        assert last['fallback'] == fallback


AHEAD, ASIDE = (
    np.array([1.0, 0.0, 0.0, 0.0]),
    np.array([1.0, 0.0, 0.0, 0.01]) / math.hypot(1.0, 0.01),
)
PROVED = {'status': 'optimal', 'gap': 0.0, 'bound_checked': True}
CHECKED = {'bound_checked': True}
WORD = {'status': 'feasible', 'gap': 1.0, 'bound_checked': False}


def turn(rate):
    return {'body_rate': np.array([0.0, 0.0, rate])}


def pointing(*thrust, of=AHEAD):
    return {'rotation': of, 'speed_fraction': thrust}


def costing(objective, gap=None):
    return {'objective': objective, 'gap': gap}


DIFFERENCES = {
    # Gaps that agree within their tolerance, on both sides of that of `optimal`.
    'at the limit': (
        'status',
        {**PROVED, 'gap': 2e-5},
        {**WORD, 'gap': 1.1e-4, **CHECKED},
        {},
        False,
    ),
    'beyond it': ('status', {**PROVED, 'gap': 2e-5}, {**WORD, 'gap': 1.3e-4, **CHECKED}, {}, True),
    # The tolerance of a turn grows as the thrust along it falls.
    'full thrust': ('rotation', pointing(1.0, 1.0, 1.0), pointing(of=ASIDE), {}, True),
    'no thrust': ('rotation', pointing(1.0, 0.01, 1.0), pointing(of=ASIDE), {}, False),
    'no thrust later': ('rotation', pointing(1.0, 1.0, 0.01), pointing(of=ASIDE), {}, True),
    'at order 2': (
        'rotation',
        pointing(1.0, 1.0, 0.0),
        pointing(of=ASIDE),
        {'rotation_order': 2},
        False,
    ),
    'thrust unknown': ('rotation', pointing(), pointing(of=ASIDE), {}, True),
    'the opposite quaternion': ('rotation', pointing(of=ASIDE), pointing(of=-ASIDE), {}, False),
    'half a turn': ('body_rate', turn(2 * np.pi), turn(-2 * np.pi), {'step': 0.5}, False),
    'less than that': ('body_rate', turn(2 * np.pi), turn(-2 * np.pi), {'step': 0.4}, True),
    'a small turn': ('body_rate', turn(3e-3), turn(0.0), {}, True),
    'relative': ('objective', costing(1e3), costing(1e3 + 1e-4), {}, False),
    'but near zero': ('objective', costing(0.0), costing(1e-8), {}, False),
    # Objectives may differ by their open gaps, up to the gap that counts as proved.
    'left open': ('objective', costing(1.0, 2e-5), costing(1.0 + 1e-5, 2e-5), {}, False),
    'unknown gap': ('objective', costing(1.0, math.nan), costing(1.0 + 1e-5, math.nan), {}, True),
    # Rounding decides where a search ends, not whether a proof is found.
    'both open': ('gap', {'gap': 0.5}, {'gap': 0.002}, {}, False),
    'then proved': ('gap', {'gap': 0.0}, {'gap': 0.002}, {}, True),
    'no bound': ('gap', {'gap': 0.5}, {'gap': math.inf}, {}, True),
    'no plan': ('gap', {'gap': 0.5}, {'gap': math.nan}, {}, True),
    'none twice': ('gap', {'gap': math.nan}, {'gap': math.nan}, {}, False),
    'a plan now': ('gap', {'gap': math.nan}, {'gap': 1.0}, {}, True),
    'gone': ('gap', {'gap': 1.0}, {'gap': None}, {}, True),
    # Whether there was time for an exact proof is not compared.
    'no time now': ('status', PROVED, WORD, {}, False),
    'no time then': ('gap', WORD, PROVED, {}, False),
    'time, and no proof': ('status', PROVED, WORD | {'bound_checked': True}, {}, True),
    'no plan at all': ('status', PROVED, WORD | {'status': 'failed'}, {}, True),
}


@pytest.mark.parametrize(
    ('quantity', 'before', 'now', 'given', 'differs'), DIFFERENCES.values(), ids=DIFFERENCES
)
def test_answers_differ_beyond_their_tolerances(quantity, before, now, given, differs):
    problem = settings_of(**given)
    apart = distance(quantity, before[quantity], now[quantity], problem.problem.step)
    assert (apart > tolerance(quantity, problem, before, now)) == differs


def test_many_differences_are_capped_and_summed_up(replay):
    code, out, _ = replay(RETRIEVAL, '--set', 'weights.input=0.5')
    lines = out.splitlines()
    assert code == 1
    assert sum(line.startswith('tick') for line in lines) == 20
    assert any(line.startswith('... and ') for line in lines)
    assert 'worst' in ' '.join(lines[-2:])


# --- what if


def test_what_if_shows_a_tick_side_by_side(replay):
    code, out, _ = replay(RETRIEVAL, '--tick', 12, '--set', 'weights.input=0.1')
    head, *rows = out.splitlines()
    assert code == 1
    assert head.split() == ['tick', '12', 'at', '12.000', 's', 'recorded', 'replayed']
    named = {row.split()[0]: row for row in rows}
    assert set(named) == {
        'status', 'fallback', 'speed', 'body_rate', 'rotation', 'objective', 'gap'
    }  # fmt: skip
    assert named['objective'].endswith('differs')
    assert not named['status'].endswith('differs')


# --- bags of other recorders


@pytest.fixture(scope='module')
def params(tmp_path_factory):
    """Return a file of the retrieval's parameters."""
    file = tmp_path_factory.mktemp('params') / 'mine.yaml'
    file.write_text(bags.notes(RETRIEVAL)['parameters'])
    return file


def test_a_bag_without_notes_asks_for_parameters(replay, tmp_path):
    path = ros2_bag(RETRIEVAL, tmp_path / 'bag', 'sqlite3')
    code, out, err = replay(path)
    assert (code, out) == (2, '')
    assert 'give --params FILE' in err
    # Defaults except these changes: the example is the paper's retrieval.
    words = [f'--set={change}' for change in ('floor.shape=polygon', 'trigger=odom')]
    assert replay(path, *words)[0] == 0


def test_commands_are_enough_to_compare(replay, tmp_path, params):
    path = ros2_bag(RETRIEVAL, tmp_path / 'bag', 'mcap', skip=('/tick', '/rotation', '/plan'))
    code, out, _ = replay(path, '--params', params)
    assert code == 0
    assert 'compared      26 speed, 26 body_rate\n' in out


@pytest.mark.parametrize(
    ('missing', 'said'),
    [
        (('/odom',), 'without /odom'),
        (('/goal',), 'without /goal or /goal_path'),
        (('/tick', '/cmd_vel'), 'without /tick or /cmd_vel'),
    ],
)
def test_a_bag_without_what_is_needed_is_told(replay, tmp_path, missing, said):
    path = rewritten(RETRIEVAL, tmp_path / 'bag', without(*missing))
    code, out, err = replay(path)
    assert (code, out) == (2, '')
    assert err.count('\n') == 1
    assert said in err
    assert '/rotation' in err  # its topics are listed


def test_a_vehicle_of_a_fleet_is_replayed_by_its_namespace(replay, tmp_path):
    path = rewritten(
        RETRIEVAL,
        tmp_path / 'bag',
        lambda each: each if each.topic == '/clock' else each._replace(topic=f'/uav1{each.topic}'),
    )
    assert replay(path, '--namespace', 'uav1')[0] == 0
    assert replay(path, '--namespace', '/uav1')[0] == 0
    code, _, err = replay(path)
    assert code == 2
    assert 'without /odom; give --namespace /uav1' in err


def test_a_flight_in_real_time_is_replayed_however_late_its_recorder(
    replay, launch, observer, tmp_path
):
    """A lag makes the state depend on when commands were sent, which each tick tells."""
    kept = []

    def keep(topic, message, info):
        late = 0 if topic in ('/odom', '/goal') else 10 * MILLISECOND * (len(kept) % 4)
        kind = f'{type(message).__module__.partition(".")[0]}/msg/{type(message).__name__}'
        at, data = info['source_timestamp'] + late, serialize_message(message)
        kept.append(Message(topic, kind, at, at, data, None))

    for topic, kind in (('/goal', PoseStamped), *((name, kind) for kind, name in TOPICS.items())):
        observer.subscribe(kind, topic, partial(keep, topic))
    own = {'step': 0.2, 'response.speed': 0.5}
    launch('planner', {**own, 'disturbance': 'estimated', 'horizon': 8})
    observer.until_connected('/tick', '/cmd_vel')
    rope = {'rope.center': [1.5, 0.5, 0.0], 'rope.amplitude': [0.0] * 3, 'capture_radius': 1e-6}
    pace = {'clock': 'wall', 'max_ticks': 10_000, 'wait_for': 'goal, odom'}
    launch('sim', {**own, **rope, **pace, 'vehicle': 'continuous'})
    observer.until(lambda: sum(each.topic == '/tick' for each in kept) > 25)
    path = write(tmp_path / 'bag', kept, {})
    words = ('step=0.2', 'response.speed=0.5', 'disturbance=estimated', 'horizon=8')
    changes = [f'--set={word}' for word in words]
    code, out, err = replay(path, *changes)
    assert code == 0, out + err
    assert replay(path, '--tick', 9, *changes)[1].split()[4:7] == ['s', 'recorded', 'replayed']


# --- among traffic, the goal in another frame: the same hazards despite late messages


OTHER = '/uav2/plan'
MILLISECOND = 10**6


AVOIDING = settings_of(
    avoid=('/uav1/plan', OTHER), avoid_radius=0.5, horizon=2, trigger='odom', tf=True
)


def tree(second):
    """Return the transform of a drifting frame."""
    return tf(second, 'map', 'odom', (0.5 * second, 0.3, 0.0), yaw=0.1)


def inputs(second):
    """Return the messages that come with a second's odometry, in the order of sending."""
    stamp, in_map = (Stamp(second * SECOND, Frames(each, 'base_link')) for each in ('odom', 'map'))
    away = [np.array([3.0 - 0.5 * k, -1.5]) for k in range(4)]
    ball = Ball(np.array([0.5 * second + 1.5, 1.6 - 0.3 * second]), 0.4)
    marker = shown(Marker(header=messages.header(second * SECOND, 'odom')), ball)
    found = {
        TF: tree(second),
        'obstacles': MarkerArray(markers=[marker]),
        OTHER: messages.path_message(stamp, 1.0, map(messages.pose, away)),
        'goal': messages.goal_message(in_map, np.array([9.0, 0.0])),
        'odom': odometry(second, (0.5 * second, 0.0)),
    }
    sent = second * SECOND
    return [
        Message(t, '', sent, sent + k * MILLISECOND, b'', m)
        for k, (t, m) in enumerate(found.items())
    ]


class Timed(OfflinePlanner):
    """A planner whose solves all take a millisecond."""

    def decide(self, *given):
        return replace(super().decide(*given), solve_time_ms=1.0)


def flown(late):
    """Return a recording of three ticks, and the clearance of each.

    Messages on ``late`` topics were sent before a tick and heard after it.
    """
    planner = Timed(AVOIDING, '/uav1/planner')
    told, answers, pending, clearances = [], [], [], []

    def hear(each):
        planner.inputs.update(each.topic, each.content, each.sent / SECOND, each.sent)

    for second in range(1, 4):
        for each in inputs(second):
            told.append(each)
            if each.topic in late:
                pending.append(each)
            else:
                hear(each)
        sent = second * SECOND + 50 * MILLISECOND
        decision = planner.decide(sent / SECOND, second * SECOND)
        answer = planner.messages(decision, second * SECOND)
        planner.planner.sent(decision.command, sent / SECOND)
        answers.append(RecordedTick(second * SECOND, sent, published(answer)))
        clearances.append(fields(answer['tick'])['clearance'])
        for each in pending:
            hear(each)
        pending.clear()
    return Recording('/uav1', AVOIDING, False, tuple(told), tuple(answers)), clearances


@pytest.mark.parametrize('late', [(), ('obstacles',), (OTHER,)], ids=['none', 'markers', 'plans'])
def test_the_commands_are_those_that_were_given(late):
    recording, clearances = flown(late)
    ticks = replayed(recording)
    for again, clearance in zip(ticks, clearances, strict=True):
        now, then = again.answer, again.recorded.answer
        assert again.refusals == ()
        assert now['traffic_stamps'] == then['traffic_stamps']
        assert (now['speed'], now['status']) == (then['speed'], then['status'])
        np.testing.assert_array_equal(now['body_rate'], then['body_rate'])
        assert now['clearance'] == pytest.approx(clearance, nan_ok=True)


def test_what_was_heard_late_makes_a_difference():
    """Otherwise the tests above would pass without the stamps on ``tick``."""
    assert flown(())[1] != flown(('obstacles',))[1]


def test_frames_that_are_not_heard_make_a_difference():
    deaf = replace(flown(())[0], settings=replace(AVOIDING, tf=False))
    (refused,) = next(iter(replayed(deaf))).refusals
    assert refused.startswith('/uav1/goal refused: header.frame_id')


def test_frames_are_read_from_a_bag(tmp_path):
    raw, kind = bags.raw(RETRIEVAL), 'tf2_msgs/msg/TFMessage'
    data = bytes(bags.store().serialize_cdr(tree(1), kind))
    heard = raw[0]._replace(topic=TF, type=kind, data=data)
    path = write(tmp_path / 'bag', [heard, *raw], bags.notes(RETRIEVAL))
    (found,) = (each.content for each in recording_of(path).inputs if each.topic == TF)
    assert found.transforms[0].child_frame_id == 'odom'
    assert found.transforms[0].transform.translation.x == 0.5
