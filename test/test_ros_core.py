# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The core of a planner without its node: safe commands, held plans, compensation, final checks."""

import itertools
import random
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planners import FRAMES, settings
from planners import odometry as odometry_message
from stepping import odometry, targets

from orbimpc_ros.loop import planner as planners
from orbimpc_ros.loop.fallback import CIRCLE_STEPS, safe_command
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.check import flaw
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.outcome import Cause, Fallback, Reason, Status
from orbimpc_ros.mpc.plan import stop
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.problem.floor import largest_fraction
from orbimpc_ros.mpc.proof.document import WORD, parsed, verified
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import ERROR, OK, SECOND, WARN, Stamp
from orbimpc_ros.ros.planner.core import Core, planner_of
from orbimpc_ros.ros.planner.outputs import condition, report_messages, values
from orbimpc_ros.ros.process import NodeClock
from orbimpc_ros.tool.offline import OfflinePlanner


class Driven(OfflinePlanner):
    """A planner without its node; the test sets the arrival times and stamps of its inputs."""

    def __init__(self, simulated=False, limits=None, **changes):
        given = settings(**{'step': 0.1} | changes)
        Core.__init__(self, given, planner_of(given), simulated=simulated, **(limits or {}))

    def odometry(self, at, now, position=(0.0, 0.0)):
        self.sense(now, odometry(position), at)

    def goal(self, at, now, x=5.0, y=1.0):
        self.sense(now, GoalObservation(at, np.array([x, y])), at)

    def tick(self, now=0.0, at=None, position=(0.0, 0.0), **goal):
        """Return the report on odometry and a goal that arrive now, stamped ``at`` or now."""
        at = now if at is None else at
        self.odometry(at, now, position)
        self.goal(at, now, **goal)
        return self.report(now)

    def messages(self, report, at=1.0, **given):
        """Return the messages published for a report on odometry of a time; all by default."""
        known = self.settings, Stamp(stamp(at), FRAMES), report, '/planner'
        return dict(report_messages(*known, **given))

    def safe(self, cause=Cause.DISABLED):
        return self.decide(0.0, stop=Reason(cause, 'a test wants it'))


def stamp(seconds):
    return OfflinePlanner.epoch + round(seconds * SECOND)


def flown_on(driven):
    """Yield the reports on nine odometry messages, of which only the first comes with a goal."""
    driven.goal(0.0, 0.0)
    for k in range(9):
        driven.odometry(0.1 * k, 0.1 * k, position=(0.1 * k, 0.0))
        yield driven.report(0.1 * k)


def test_a_stale_goal_holds_the_last_plan_and_then_stops():
    driven = Driven(goal_timeout=0.5)
    answers = [*flown_on(driven)]
    fallbacks = [answer.fallback for answer in answers]
    assert fallbacks == [''] * 6 + ['shifted plan'] * 2 + ['safe command']
    assert answers[6].reason == 'the goal is 0.60 s old'
    assert [values(answers[k])['cause'] for k in (0, 6)] == ['', 'goal']
    assert values(driven.safe(Cause.SOURCES))['cause'] == 'sources'
    assert answers[6].solve_time_ms == 0.0  # no problem was solved
    assert answers[6].command.speed_fraction > 0.5
    assert answers[8].command.speed_fraction == 0.0


def test_the_state_is_advanced_by_the_age_of_odometry():
    driven, blind = Driven(), Driven(delay_compensation=False)
    for each in (driven, blind):
        each.tick()
        each.odometry(0.1, 0.18, position=(0.1, 0.0))
    answer, other = driven.report(0.18), blind.report(0.18)
    assert other.advanced == 0.0
    np.testing.assert_allclose(other.plan.positions[0], [0.1, 0.0])
    took = driven.expected
    assert answer.advanced == pytest.approx(0.08 + took, abs=0.05)
    assert answer.advanced >= 0.08 - 1e-6
    moved = answer.plan.positions[0] - [0.1, 0.0]
    assert np.linalg.norm(moved) == pytest.approx(answer.advanced, rel=1e-3)  # at 1 m/s
    begun = driven.messages(answer, 0.1)['plan'].poses[0].header.stamp
    assert begun.sec * SECOND + begun.nanosec >= stamp(0.18) - 1000
    other = Driven()  # of another clock, whose stamps say nothing of the delay
    other.inputs.update('odom', odometry_message(1.0), 1.0, stamp(1.0))
    other.goal(1.0, 1.0)
    assert other.report(1.05).advanced == 0.0


def test_the_goal_is_where_it_will_be_when_the_advanced_plan_gets_there():
    driven = Driven(goal_prediction='velocity')
    for at in (0.0, 0.1):
        answer = driven.tick(at + 0.05, at, x=5.0 + at)
    ahead = 0.1 + answer.advanced + 0.1 * np.arange(1, 6)
    np.testing.assert_allclose(answer.goals[:, 0], 5.0 + ahead, atol=1e-4)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize(
    ('kind', 'order', 'speed'),
    [('stop', 1, 0.0), ('hold_rate_zero', 1, 0.7), ('hold_rate_zero', 2, 0.0)],  # order 2 coasts
)
def test_what_stops_or_goes_straight_on_does_not_turn(kind, order, speed, n):
    rates = 1 if n == 2 else 3
    attitude = exp(np.full(rates, 0.4))
    command = safe_command(kind, Problem(n, translation_order=order), attitude, 0.7)
    assert (command.speed_fraction, command.body_rate.tolist()) == (speed, [0.0] * rates)
    np.testing.assert_array_equal(command.rotation, attitude)


def floored(dimension, shape, draw):
    """Return a random problem with a floor, and with a rate limit in half of the draws."""
    faces = draw.choice([3, 4, 8]) if dimension == 2 else draw.choice([6, 12, 20])
    fraction = draw.uniform(0.1, 1.0)
    if shape == 'polygon':
        fraction *= largest_fraction(dimension, faces)
    step = draw.uniform(0.05, 2.0)
    rate = draw.choice([0.0, draw.uniform(0.01, 1.0) * np.pi / step])
    floor = Floor(shape, faces, fraction)
    return Problem(dimension, step=step, max_rate=rate, floor=floor)


@pytest.mark.parametrize('kind', ['hold_rate_zero', 'loiter'])
@pytest.mark.parametrize('shape', ['polygon', 'circle'])
@pytest.mark.parametrize('n', [2, 3])
def test_no_safe_command_goes_below_the_floor_or_beyond_a_limit(n, shape, kind):
    draw = random.Random(f'{n} {shape} {kind}')
    for _ in range(100):
        problem = floored(n, shape, draw)
        attitude = exp(np.array([draw.uniform(-3.0, 3.0) for _ in range(1 if n == 2 else 3)]))
        command = safe_command(kind, problem, attitude, draw.choice([0.0, draw.random(), 1.0]))
        assert flaw(problem, command) == ''
        headings = [attitude[:, 0], command.rotation[:, 0]]
        for heading in headings if (shape, kind) == ('polygon', 'loiter') else ():
            beyond = normals(n, problem.floor.faces) @ (command.speed_fraction * heading)
            assert beyond.max() >= problem.floor.fraction - 1e-9


def test_the_safe_command_circles_with_a_floor_and_hovers_under_gravity_unless_it_is_given():
    craft = {'dimension': 3, 'translation_order': 2, 'forward': 20.0}
    assert settings(**craft).safe_command == 'stop'
    assert settings(**craft, gravity=9.81).safe_command == 'hover'
    assert settings(**craft, gravity=9.81, safe_command='stop').safe_command == 'stop'
    for shape, order, given, wanted in (
        ('none', 1, 'auto', 'stop'),
        ('circle', 1, 'auto', 'loiter'),
        ('polygon', 1, 'auto', 'loiter'),
        ('circle', 2, 'auto', 'stop'),  # without drag a stop means coasting
        ('circle', 1, 'stop', 'stop'),
        ('circle', 1, 'hold_rate_zero', 'hold_rate_zero'),
    ):
        changes = {'floor.shape': shape, 'translation_order': order, 'safe_command': given}
        assert settings(**changes).safe_command == wanted


@pytest.mark.parametrize('kind', ['auto', 'hold_rate_zero', 'stop'])
def test_every_road_to_a_safe_command_keeps_to_the_floor(kind, monkeypatch):
    driven = Driven(**{'floor.shape': 'circle', 'safe_command': kind, 'goal_timeout': 0.5})
    answers = [driven.safe(Cause.WAITING)]
    answers += flown_on(driven)  # planned, shifted, then without a plan
    answers.append(driven.safe())
    driven.start_afresh()
    answers.append(driven.safe(Cause.AFRESH))
    # A flaw missed by the planner's own check of its plan.
    honest = planners.command_of
    slow = lambda *arguments: replace(honest(*arguments), speed_fraction=0.1)  # noqa: E731
    monkeypatch.setattr(planners, 'command_of', slow)
    monkeypatch.setattr(planners, 'command_violations', lambda *_: [])
    answers.append(driven.tick(2.0))
    assert answers[-1].reason.startswith('not sent: a speed fraction of 0.1 is below')
    fallbacks = [answer.fallback for answer in answers]
    assert fallbacks.count('safe command') == 5
    assert fallbacks.count('shifted plan') == 2
    for answer in answers:
        below = answer.command.speed_fraction < np.sqrt(0.3) * (1.0 - 1e-9)
        assert below == (kind == 'stop' and answer.fallback == 'safe command')


def test_a_command_that_was_not_sent_is_not_the_speed_to_hold():
    driven = Driven(safe_command='hold_rate_zero')
    driven.odometry(0.0, 0.0)
    driven.goal(0.0, 0.0)
    planned = driven.decide(0.0, stamp(0.0))
    assert planned.command.speed_fraction > 0.5
    assert driven.safe().command.speed_fraction == 0.0
    driven.planner.sent(planned.command, stamp(0.0) / SECOND)
    held = driven.safe().command.speed_fraction
    assert held == planned.command.speed_fraction


@pytest.mark.parametrize('n', [2, 3])
def test_loiter_closes_a_level_circle_at_the_least_speed(n):
    problem = Problem(n, step=0.5, floor=Floor('circle', fraction=0.6))
    attitude, place, places = np.eye(n), np.zeros(n), []
    for _ in range(CIRCLE_STEPS):
        command = safe_command('loiter', problem, attitude, 0.0)
        assert command.speed_fraction == 0.6
        place = place + command.speed_fraction * attitude[:, 0]
        attitude = attitude @ exp(problem.step * command.body_rate)
        np.testing.assert_allclose(attitude, command.rotation, atol=1e-12)
        places.append(place)
    np.testing.assert_allclose(place, 0.0, atol=1e-9)
    assert np.ptp([p[-1] for p in places]) == 0.0 or n == 2


def test_an_unknown_wind_is_estimated_planned_with_and_told():
    """The vehicle, with a lag in speed, drifts in a crosswind on its way to a far goal."""
    driven = Driven(disturbance='estimated', **{'response.speed': 0.1})
    wind, position, last = np.array([0.0, 0.3]), np.zeros(2), None
    for k in range(150):
        now = 0.1 * k
        report = driven.tick(now, position=tuple(position), x=1e3)
        share = 0.0 if last is None else last
        wanted = report.command.speed_fraction
        left = (share - wanted) * np.exp(-1.0)
        position = position + 0.1 * wind + [0.1 * wanted + 0.1 * (share - wanted - left), 0.0]
        last = wanted + left
    np.testing.assert_allclose(report.disturbance, wind, atol=0.01)
    np.testing.assert_array_equal(report.state.disturbance, report.disturbance)
    assert values(report)['disturbance'] == tuple(report.disturbance)
    assert 0.0 <= values(report)['innovation'] < 1.0
    driven.start_afresh()
    assert driven.tick(now + 0.1).disturbance == pytest.approx(wind, abs=0.01)
    driven.planner.start_afresh(wind=True)
    assert not driven.tick(now + 0.2).disturbance.any()
    given = values(Driven(wind=(0.1, -0.2, 0.0)).tick())
    assert given['disturbance'] == (0.1, -0.2)
    assert np.isnan(given['innovation'])


def test_odometry_whose_clock_was_set_back_is_learnt_from_again():
    driven, far = Driven(disturbance='estimated'), np.array([1000.0, 0.0])
    for begin, drift in ((1000.0, 0.3), (0.0, -0.3)):
        for now in 0.1 * np.arange(60):
            at, place = Stamp(round((begin + now) * SECOND), FRAMES), now * np.array([1.0, drift])
            sent = messages.odometry_message(at, odometry(place)), messages.goal_message(at, far)
            for topic, message in zip(('odom', 'goal'), sent, strict=True):
                assert driven.inputs.update(topic, message, 2000.0 - begin + now) == ''
            decision = driven.decide(2000.0 - begin + now)
            driven.planner.sent(decision.command, begin + now)
        assert decision.disturbance[1] == pytest.approx(drift, abs=0.05)


def test_a_plan_of_a_lagging_vehicle_starts_a_lag_later():
    """Its stamps include this lead, which is reported separately from the measurement's age."""
    driven = Driven(simulated=True, discretisation='exact', **{'response.rate': 0.05})
    report = driven.tick()
    assert report.led == 0.05
    assert report.advanced == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(report.state.position, [0.05, 0.0], atol=1e-6)


def turned_to(yaw, driven):
    """Return the report on a goal with an orientation."""
    message = messages.goal_message(Stamp(stamp(0.0), FRAMES), np.array([0.5, 0.2]))
    message.pose.orientation = messages.quaternion(exp(np.array([yaw])))
    driven.odometry(0.0, 0.0)
    driven.hear('goal', message, 0.0)
    return driven.report(0.0)


def test_the_goals_orientation_pulls_where_it_has_a_weight():
    ends = {}
    for weight in (0.0, 20.0):
        driven = Driven(**{'weights.attitude': weight, 'weights.input': 0.001, 'horizon': 8})
        ends[weight] = turned_to(2.0, driven).plan.rotations[-1]
    off = {weight: np.linalg.norm(end - exp(np.array([2.0]))) for weight, end in ends.items()}
    assert off[20.0] < 0.2 < off[0.0]


def test_a_catch_is_headed_along_the_goals_axis_or_the_direction_given():
    for yaw, direction in ((1.0, ()), (-2.0, (np.cos(1.0), np.sin(1.0)))):
        coned = {'approach.cone': 0.3, 'approach.direction': direction}
        driven = Driven(objective='intercept', horizon=8, **coned)
        driven.settings = replace(driven.settings, given_deadline=np.inf)
        tick = turned_to(yaw, driven)
        assert np.isfinite(tick.catch.time)
        heading = tick.plan.projected[-1, :, 0]
        assert np.arctan2(heading[1], heading[0]) == pytest.approx(1.0, abs=0.3 + 1e-6)


def test_only_what_somebody_listens_to_is_made():
    driven = Driven()
    report = driven.tick(1.0)
    everything = driven.messages(report)
    assert everything.keys() == {'tick', 'plan', 'plan_markers'}
    assert driven.messages(report, heard={'plan', 'odom'}) == {'plan': everything['plan']}
    assert driven.messages(report, heard=()) == {}


def verdict_on(driven, report):
    """Return the verdict on the certificate that a planner sends with a report; it holds."""
    sent = driven.messages(report, heard={'certificate'})['certificate']
    verdict = verified(parsed(bytes(sent.data)))
    assert verdict.holds
    return verdict


@pytest.mark.skipif(not COMPILED, reason='the method that leaves a certificate needs numba')
def test_a_certificate_on_the_wire_proves_the_bound_of_the_tick():
    driven = Driven(publish_certificate=True)
    report = driven.tick(1.0)
    assert verdict_on(driven, report).claimed == report.plan.lower_bound > 0.0


def test_without_time_for_a_proof_a_tick_says_whose_word_it_is():
    shown = [0.0]
    driven = Driven(limits={'clock': lambda: shown[0]}, terminal='constraint')
    answered = driven.tick(1.0)
    shown[0] = np.inf
    report = driven.proved(answered)
    assert report.status == answered.status == 'infeasible'
    assert report.command == answered.command
    assert values(report)['infeasible_checked'] is False
    assert report.reason == f'{answered.reason}; {WORD}'
    assert driven.messages(report, heard={'certificate'}) == {}


BOXES = {'obstacles': [1.5, -1.0, 2.5, 1.6, 3.0, 1.2, 4.0, 3.0], 'floor.shape': 'circle'}


@pytest.mark.parametrize('deadline', [1e-3, 0.1])
def test_in_lock_step_a_deadline_leaves_the_same_work_however_slow_the_machine_is(deadline):
    found = []
    for second in (1e-9, 10.0):  # between two readings of the clock
        limits = {'clock': itertools.count(step=second).__next__, 'counted': True}
        search = {'step': 0.5, 'horizon': 10, 'no_corner_cutting': True, 'deadline': deadline}
        driven = Driven(True, limits, **search, **BOXES)
        report = driven.tick(0.0)
        plan = driven.proved(report).plan
        found.append((plan.objective, plan.lower_bound, plan.proof.nodes))
        assert (plan.gap < 1e-6) == (deadline == 0.1)
    assert found[0] == found[1]


def test_what_is_said_of_catches_is_counted_or_refuted_on_demand_or_the_methods_word():
    shown, caught = [0.0], {'objective': 'intercept', 'capture_radius': 0.1}
    driven = Driven(limits={'clock': lambda: shown[0]}, publish_certificate=True, **caught)
    answered = driven.tick(1.0)
    assert answered.catch.bound == pytest.approx(0.6)
    assert values(answered)['catch_checked'] is True  # by distance alone
    assert driven.proved(answered) is answered
    report = driven.proved(answered, catches=True)
    assert verdict_on(driven, report).proved == pytest.approx(values(report)['catch_bound'])
    assert values(report)['catch_checked'] is True
    assert values(report)['infeasible_checked'] is False
    word = replace(answered, catch=replace(answered.catch, counted=0.1))
    assert values(word)['catch_checked'] is False
    assert values(word)['catch_bound'] == 0.1  # as far as it was checked
    refuted = values(driven.proved(word, catches=True))
    assert refuted['catch_checked'] is True
    assert refuted['catch_bound'] == values(answered)['catch_bound'] > 0.1
    shown[0] = np.inf
    late = driven.proved(word, catches=True)
    assert values(late)['catch_checked'] is False
    assert late.reason == answered.reason
    assert values(Driven().tick(1.0))['catch_checked'] is False


# --- moving goals, predicted by a bank of models


def carried(time):
    return np.array([2.0 + 0.5 * time + np.sin(1.5 * time), 1.0 - 0.2 * time + np.cos(1.5 * time)])


def watching(ticks, **changes):
    """Return a planner that has seen a swing on a carrier at 10 Hz, its report, and times ahead."""
    driven = Driven(simulated=True, **changes)
    for now in 0.1 * np.arange(1, ticks + 1):
        driven.odometry(now, now)
        driven.goal(now, now, *carried(now))
    return driven, driven.report(now), now + 0.1 * np.arange(1, 6)


def test_a_swing_on_a_moving_carrier_is_planned_for_and_named():
    _, report, ahead = watching(100, goal_prediction='auto')
    np.testing.assert_allclose(report.goals, carried(ahead).T, atol=1e-3)
    assert values(report)['goal_model'] == 'carrier'


def test_another_forecast_begins_with_the_last_goal():
    driven, _, ahead = watching(10)
    driven.inputs.adopt(settings(step=0.1, goal_prediction='auto'))
    assert driven.inputs.heard['goal_model'] != ''
    held = np.tile(carried(1.0), (5, 1))
    np.testing.assert_allclose(targets(driven.inputs, driven.epoch / SECOND + ahead, 1.0), held)
    driven.inputs.latest.clear()
    driven.inputs.start_afresh()
    assert 'goal_model' not in driven.inputs.heard


# --- clocks, and ticks that take too long


@pytest.mark.parametrize('by', [5.0, -5.0])
def test_a_clock_that_is_set_is_told(by, monkeypatch):
    """Slewing, and a pause between two readings of the clocks, do not count as jumps."""
    told, steady, offset = [], 0.0, 1e6

    def slowly():
        nonlocal steady
        steady += 0.3 if round(steady) == 3 else 0.0
        return steady

    node = NodeClock.__new__(NodeClock)
    shown = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=(steady + offset) * SECOND))
    node._clock, node.simulated, node._offset, node._on_jump = shown, False, np.nan, told.append
    monkeypatch.setattr(time, 'monotonic', slowly)
    for k in range(10):
        steady, offset = float(k), offset + (by if k == 5 else 1e-6)
        node.look()
    np.testing.assert_allclose(told, [by], atol=1e-3)


def test_misses_and_overruns_are_counted_and_a_stray_one_is_not_expected(monkeypatch):
    times = iter([0.0, 0.01, 1.0, 1.01, 2.0, 2.3, 3.0, 3.06, 4.0, 4.01])
    driven = Driven(limits={'clock': times.__next__})
    assert driven.expected == 0.0
    decided = reported(Status.OPTIMAL)
    decided = replace(decided, state=State.at([0.0, 0.0], np.eye(2)))
    monkeypatch.setattr(driven.planner, 'step', lambda *_: decided)
    for now in range(5):
        driven.odometry(now, now)
        driven.decide(now, stamp(now))
    assert driven.counts == {'deadline misses': 2, 'overruns': 1}
    assert driven.expected == pytest.approx(0.01)


def reported(status, reason='', fallback=Fallback.NONE):
    return Decision(status, reason, None, None, stop(np.eye(2)), fallback)


def safe(reason):
    return reported(Status.FAILED, reason, Fallback.SAFE_COMMAND)


PLANNING = reported(Status.OPTIMAL)


@pytest.mark.parametrize(
    ('wrong', 'waiting', 'report', 'notices', 'expected'),
    [
        (('', ''), '', None, ('',), (OK, 'ready')),
        (('', ''), '', PLANNING, ('',), (OK, 'planning')),
        (('', ''), '', PLANNING, ('', 'odom refused'), (WARN, 'planning; odom refused')),
        (('', ''), '', reported(Status.OPTIMAL, 'far away'), (), (WARN, 'far away')),
        (('', ''), '', reported(Status.FEASIBLE, 'gap'), (), (WARN, 'gap')),
        (('', ''), '', safe('old'), ('odom refused',), (ERROR, 'old; odom refused')),
        (('', ''), 'disabled', safe('disabled'), (), (WARN, 'disabled')),
        (('two sources', ''), 'disabled', PLANNING, (), (ERROR, 'two sources')),
        (('two sources', 'mismatch'), '', None, (), (ERROR, 'two sources; mismatch')),
    ],
)
def test_the_worst_is_told(wrong, waiting, report, notices, expected):
    level, parts = condition(wrong, waiting, report, notices)
    assert (level, '; '.join(parts)) == expected
