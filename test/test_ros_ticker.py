"""Answers without publishing: safe commands, held plans, compensation, the last look."""

import random
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from orbimpc_ros.mpc.command import flaw
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.loop import controller as controllers
from orbimpc_ros.mpc.loop.safety import CIRCLE_STEPS, safe_command
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.problem.floor import largest_fraction
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.arrival import RosTime
from orbimpc_ros.ros.messages import SECOND, Frames, Stamp
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.planner.ticker import Ticker, prepared
from orbimpc_ros.world.vehicle import Model, launched

FRAMES = Frames('odom', 'base_link')
START = 1_700_000_000 * SECOND  # [ns]


class Told:
    """A ticker whose inputs are stamped and come when the test says."""

    def __init__(self, simulated=False, **changes):
        values = {row.name: row.default for row in PLANNER} | {'step': 0.1} | changes
        self.ticker = Ticker(*prepared(planner_settings(values)), simulated=simulated)

    def odometry(self, at, now, position=(0.0, 0.0)):
        vehicle = launched(Model(), np.array(position), np.eye(2))
        message = messages.odometry_message(Stamp(stamp(at), FRAMES), vehicle)
        assert self.ticker.inbox.take_odometry(message, now, RosTime(stamp(now))) == ''

    def goal(self, at, now, x=5.0):
        message = messages.goal_message(Stamp(stamp(at), FRAMES), np.array([x, 1.0]))
        assert self.ticker.inbox.take_goal(message, now, RosTime(stamp(now))) == ''

    def tick(self, now):
        answer = self.ticker.planned(now, RosTime(stamp(now)))
        self.ticker.went_out(answer, stamp(now) / SECOND)
        return answer


def stamp(seconds):
    return START + round(seconds * SECOND)


def test_a_stale_goal_holds_the_last_plan_and_then_stops():
    told = Told(goal_timeout=0.5)
    told.goal(0.0, 0.0)
    answers = []
    for k in range(9):
        told.odometry(0.1 * k, 0.1 * k, position=(0.1 * k, 0.0))
        answers.append(told.tick(0.1 * k))
    fallbacks = [answer.report.fallback for answer in answers]
    assert fallbacks == [''] * 6 + ['shifted plan'] * 2 + ['safe command']
    assert answers[6].report.reason == 'the goal is 0.60 s old'
    assert answers[6].report.solve_time_ms == 0.0  # nothing was solved
    assert answers[6].command.speed_fraction > 0.5
    assert answers[8].command.speed_fraction == 0.0


def test_the_state_is_advanced_by_the_age_of_odometry():
    told, blind = Told(), Told(delay_compensation=False)
    for each in (told, blind):
        each.odometry(0.0, 0.0)
        each.goal(0.0, 0.0)
        each.tick(0.0)
        each.odometry(0.1, 0.18, position=(0.1, 0.0))
    answer, other = told.tick(0.18), blind.tick(0.18)
    assert other.report.advanced == 0.0
    np.testing.assert_allclose(other.plan.positions[0], [0.1, 0.0])
    took = told.ticker.timing.expected
    assert answer.report.advanced == pytest.approx(0.08 + took, abs=0.05)
    assert answer.report.advanced >= 0.08 - 1e-6
    moved = answer.plan.positions[0] - [0.1, 0.0]
    assert np.linalg.norm(moved) == pytest.approx(answer.report.advanced, rel=1e-3)  # at 1 m/s
    path = messages.plan_message(
        Stamp(stamp(0.1), FRAMES), answer.plan, 0.1, answer.report.advanced
    )
    begun = path.poses[0].header.stamp
    assert begun.sec * SECOND + begun.nanosec >= stamp(0.18) - 1000


def test_the_goal_is_where_it_will_be_when_the_advanced_plan_gets_there():
    told = Told(goal_prediction='velocity')
    for at in (0.0, 0.1):
        told.odometry(at, at + 0.05)
        told.goal(at, at + 0.05, x=5.0 + at)
        answer = told.tick(at + 0.05)
    ahead = 0.1 + answer.report.advanced + 0.1 * np.arange(1, 6)
    np.testing.assert_allclose(answer.tick.goals[:, 0], 5.0 + ahead, atol=1e-4)


def test_without_delay_compensation_changes_no_bit():
    told, blind = Told(simulated=True), Told(simulated=True, delay_compensation=False)
    for k in range(5):
        answers = []
        for each in (told, blind):
            each.odometry(0.1 * k, 0.1 * k, position=(0.07 * k, 0.01 * k))
            each.goal(0.1 * k, 0.1 * k)
            answers.append(each.tick(0.1 * k))
        one, other = answers
        assert one.report.advanced == 0.0
        assert one.command.speed_fraction == other.command.speed_fraction
        np.testing.assert_array_equal(one.command.body_rate, other.command.body_rate)
        np.testing.assert_array_equal(one.plan.positions, other.plan.positions)


def test_stamps_of_another_clock_say_nothing_of_the_delay():
    told = Told()
    vehicle = launched(Model(), np.zeros(2), np.eye(2))
    for seconds in (1.0, 1.1):
        message = messages.odometry_message(Stamp(round(seconds * SECOND), FRAMES), vehicle)
        told.ticker.inbox.take_odometry(message, seconds, RosTime(stamp(seconds)))
        told.goal(seconds, seconds)
        assert told.tick(seconds + 0.05).report.advanced == 0.0


def poison(monkeypatch, **changes):
    """Let commands be made with a flaw that the controller's own check has missed."""
    honest = controllers.command_of
    made = lambda *arguments: replace(honest(*arguments), **changes)  # noqa: E731
    monkeypatch.setattr(controllers, 'command_of', made)
    monkeypatch.setattr(controllers, 'command_violations', lambda *_: [])


def test_a_command_with_a_flaw_is_not_sent(monkeypatch):
    told = Told()
    told.odometry(0.0, 0.0)
    told.goal(0.0, 0.0)
    poison(monkeypatch, body_rate=np.array([np.nan]))
    answer = told.tick(0.0)
    assert (answer.report.fallback, answer.report.status) == ('safe command', 'failed')
    assert answer.report.reason == 'not sent: the command is not finite'
    assert answer.plan is None
    assert answer.command.speed_fraction == 0.0
    assert answer.command.body_rate.tolist() == [0.0]


def test_a_tick_that_takes_too_long_is_a_miss(monkeypatch):
    told = Told(deadline=1e-9)
    told.odometry(0.0, 0.0)
    told.goal(0.0, 0.0)
    assert told.tick(0.0).report.status in ('optimal', 'feasible')  # checked: it may be flown
    assert told.ticker.timing.misses == 1


ATTITUDE = exp(np.array([0.4]))


def test_stop_neither_moves_nor_turns():
    command = safe_command('stop', Problem(), ATTITUDE, 0.7)
    assert (command.speed_fraction, command.body_rate.tolist()) == (0.0, [0.0])
    np.testing.assert_array_equal(command.rotation, ATTITUDE)


def test_hold_rate_zero_goes_straight_on():
    command = safe_command('hold_rate_zero', Problem(), ATTITUDE, 0.7)
    assert (command.speed_fraction, command.body_rate.tolist()) == (0.7, [0.0])
    np.testing.assert_array_equal(command.rotation, ATTITUDE)


def test_to_hold_the_speed_without_drag_is_to_coast():
    command = safe_command('hold_rate_zero', Problem(translation_order=2), ATTITUDE, 0.7)
    assert (command.speed_fraction, command.body_rate.tolist()) == (0.0, [0.0])


def floored(dimension, shape, draw):
    """A problem with a floor, and a rate limit on every other."""
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


def test_with_a_floor_the_safe_command_circles_unless_a_stop_is_asked_for():
    for shape, order, given, wanted in (
        ('none', 1, 'auto', 'stop'),
        ('circle', 1, 'auto', 'loiter'),
        ('polygon', 1, 'auto', 'loiter'),
        ('circle', 2, 'auto', 'stop'),  # without drag a stop is to coast
        ('circle', 1, 'stop', 'stop'),
        ('circle', 1, 'hold_rate_zero', 'hold_rate_zero'),
    ):
        changes = {'floor.shape': shape, 'translation_order': order, 'safe_command': given}
        values = {row.name: row.default for row in PLANNER} | changes
        assert planner_settings(values).safe_command == wanted


@pytest.mark.parametrize('kind', ['auto', 'hold_rate_zero', 'stop'])
def test_every_road_to_a_safe_command_keeps_to_the_floor(kind, monkeypatch):
    told = Told(**{'floor.shape': 'circle', 'safe_command': kind, 'goal_timeout': 0.5})
    answers = [told.ticker.safe('before anything is known')]
    told.goal(0.0, 0.0)
    for k in range(9):
        told.odometry(0.1 * k, 0.1 * k, position=(0.1 * k, 0.0))
        answers.append(told.tick(0.1 * k))  # planned, shifted, then without a plan
    answers.append(told.ticker.safe('disabled'))
    told.ticker.forget()
    answers.append(told.ticker.safe('starting afresh'))
    told.odometry(2.0, 2.0)
    told.goal(2.0, 2.0)
    poison(monkeypatch, speed_fraction=0.1)
    answers.append(told.tick(2.0))
    assert answers[-1].report.reason.startswith('not sent: a speed fraction of 0.1 is below')
    fallbacks = [answer.report.fallback for answer in answers]
    assert fallbacks.count('safe command') == 5
    assert fallbacks.count('shifted plan') == 2
    for answer in answers:
        below = answer.command.speed_fraction < np.sqrt(0.3) * (1.0 - 1e-9)
        assert below == (kind == 'stop' and answer.report.fallback == 'safe command')


def test_what_is_safe_at_translation_order_2_is_no_thrust_whatever_the_floor():
    told = Told(**{'floor.shape': 'circle', 'translation_order': 2})
    assert told.ticker.safe('disabled').command.speed_fraction == 0.0


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


def test_loiter_turns_no_faster_than_allowed():
    slow = safe_command('loiter', Problem(max_rate=0.1), ATTITUDE, 0.0)
    assert slow.body_rate.tolist() == [0.1]
    assert slow.speed_fraction == 1.0  # without a floor: full speed
