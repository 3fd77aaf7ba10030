# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc replay``: a bag as a regression test, whose inputs are answered again tick by tick.

Plans are solved again, but timing is taken from the recording. So are ticks without a plan (an
input was stale, the planner was disabled) and the command published on the previous tick, so that
one difference does not cause differences in all later ticks.
"""

from __future__ import annotations

import itertools
import math
import time
from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, to_quaternion
from orbimpc_ros.mpc.outcome import Cause, Reason, Status
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.ros import topics
from orbimpc_ros.ros.messages import SECOND, pushed
from orbimpc_ros.ros.parameters.planner import PlannerSettings, planner_settings
from orbimpc_ros.ros.planner.core import GOALS, READ, TRANSFORMS, Inputs, others
from orbimpc_ros.ros.topics import resolving
from orbimpc_ros.tool import bags, history, settings
from orbimpc_ros.tool.bags import Message, fields, point
from orbimpc_ros.tool.offline import OfflinePlanner

CLOCK = '/clock'
INPUTS = tuple(topic.name for topic in topics.INPUTS)
COMPARED = tuple(topic.name for topic in topics.OUTPUTS if not topic.name.startswith('plan'))
NEEDED = ('odom',), ('goal', 'goal_path'), ('tick', 'cmd_vel')
Answer = dict[str, Any]  # values published on a tick; unknown ones are absent
LINES = 20  # differences printed individually
# Solver versions, with and without numba, agree on an optimum within these tolerances. The
# objective is flat at its optimum: it agrees more closely than the command that attains it.
SPEED, RATE, ANGLE = 1e-4, 1e-3, 1e-3  # of full speed or thrust; [rad/s]; [rad]
OBJECTIVE, ROUNDING = 1e-6, 1e-7  # relative; absolute near zero
UNITS = {'speed': 'm/s', 'force': 'N', 'body_rate': 'rad/s', 'rotation': 'rad'}
PLANNED = Status.OPTIMAL, Status.FEASIBLE
TEXTS, TURNS = ('status', 'fallback'), ('body_rate', 'rotation')
QUANTITIES = (*TEXTS, 'speed', 'force', *TURNS, 'objective', 'gap')


def run(
    bag: str, params: str | None, changes: Sequence[str], tick: int | None, namespace: str
) -> int:
    """Replay a bag and report differences; return 0 if all are within the tolerances."""
    begun, path = time.perf_counter(), Path(bag)
    recording = recording_of(path, namespace, params, changes, tick)
    answers = list(replayed(recording))
    comparisons = list(compared(answers, recording.settings))
    if tick is not None:
        comparisons = [each for each in comparisons if each.tick == tick]
        _show(tick, answers[-1], comparisons)
    else:
        received = sum(each.topic != CLOCK for each in recording.inputs)
        inputs = f'{received}, {sum(len(each.refusals) for each in answers)} refused'
        took = f'in {time.perf_counter() - begun:.2f} s'
        _sum_up(f'{len(answers)} ticks of {path} {took}', inputs, comparisons)
    return int(any(each.differs for each in comparisons))


def _sum_up(replayed: str, inputs: str, comparisons: Sequence[Comparison]) -> None:
    """Print the first differences, and a summary by quantity."""
    differences = [each for each in comparisons if each.differs]
    for each in differences[:LINES]:
        print(each)
    if len(differences) > LINES:
        print(f'... and {len(differences) - LINES} more')
    worst = {each.quantity: each for each in sorted(differences, key=lambda each: each.apart)}
    ticks = len({each.tick for each in differences})
    parts = ', '.join(f'{name} at tick {each.tick}' for name, each in worst.items())
    counts = Counter(each.quantity for each in comparisons)
    rows = {
        'replayed': replayed,
        'inputs': inputs,
        'compared': ', '.join(f'{n} {quantity}' for quantity, n in counts.items()),
        'differences': f'{len(differences)} in {ticks} ticks; worst {parts}' if worst else 'none',
    }
    print(history.lines(rows))


def _show(number: int, tick: ReplayedTick, comparisons: Sequence[Comparison]) -> None:
    """Print one tick, recorded and replayed side by side."""
    title = f'tick {number} at {tick.recorded.stamp / SECOND:.3f} s'
    width = max(20, len(title) + 2)  # of a date more than of simulated time
    print(f'{title:<{width}}{"recorded":<26}replayed')
    for each in comparisons:
        unit = f' [{UNITS[each.quantity]}]' if each.quantity in UNITS else ''
        mark = '  differs' if each.differs else ''
        pair = f'{shown(each.recorded, 4):<26}{shown(each.replayed, 4)}'
        print(f'{each.quantity + unit:<{width}}{pair}{mark}')
    reasons = [each.get('reason', '') for each in (tick.recorded.answer, tick.answer)]
    if any(reasons):
        print('recorded      {}\nreplayed      {}'.format(*map(shown, reasons)))
    for refusal in tick.refusals:
        print(refusal)


# --- what was recorded


def published(messages: Mapping[str, Any]) -> Answer:
    """Return the values in messages by topic: the fields of ``tick`` by name, and the command.

    The latter has the ``speed`` [m/s], ``body_rate``, shape (3,) [rad/s], ``force`` [N] and
    ``rotation``, a quaternion, shape (4,).
    """
    values: Answer = {}
    if 'cmd_vel' in messages:
        twist = messages['cmd_vel'].twist
        values |= {'speed': pushed(twist.linear), 'body_rate': point(twist.angular)}
    if 'cmd_thrust' in messages:
        values['force'] = pushed(messages['cmd_thrust'].wrench.force)
    if 'rotation' in messages:
        q = messages['rotation'].quaternion
        values['rotation'] = np.array([q.w, q.x, q.y, q.z])
    return values | (fields(messages['tick']) if 'tick' in messages else {})


@dataclass(frozen=True)
class RecordedTick:
    """A recorded tick of the planner."""

    stamp: int  # of the odometry that it answers [ns]
    sent: int  # when its first message was sent, by the clock of the inputs [ns]
    answer: Answer  # the values in its messages

    @property
    def solved(self) -> bool:
        """Return whether a solver was called, as far as is known."""
        return self.answer.get('solve_time_ms') != 0.0

    @property
    def planned(self) -> bool:
        """Return whether the answer is based on odometry and goals, as far as is known.

        If every goal is stale, it continues the previous plan without a solve, and still lists goal
        stamps; a safe command for any other reason lists none.
        """
        return self.solved or bool(self.answer.get('goal_stamps'))


@dataclass(frozen=True)
class Recording:
    """The inputs and answers of one planner in a bag."""

    namespace: str  # of the vehicle, such as ``/uav1``
    settings: PlannerSettings  # of the planner
    simulated: bool  # whether its time came from ``/clock``
    inputs: tuple[Message, ...]  # with their own stamps, in the order of sending
    answers: tuple[RecordedTick, ...]  # in the order of sending


def recording_of(
    path: Path,
    namespace: str = '',
    params: str | None = None,
    changes: Sequence[str] = (),
    tick: int | None = None,
) -> Recording:
    """Return the recording of a vehicle's planner, in its namespace.

    Args:
        path: path of the bag.
        namespace: such as ``/uav1``.
        params: file of the planner's parameters, if not those noted in the bag.
        changes: ``name=value``, of these parameters.
        tick: number of the last one to read; None for all.

    Raises:
        BadInput: no bag, or not one with odometry, a goal and the planner's answers, or there are
            no parameters, or no such tick.
    """
    if params is None and not changes and not bags.notes(path):
        raise BadInput.stating(str(path), 'no notes of its parameters', 'give --params FILE')
    values = settings.of_bag(path, namespace, params)
    values = settings.changed(values, changes, simulated=False)
    planner = planner_settings(values)
    read = (*INPUTS, *COMPARED, CLOCK, *TRANSFORMS, *others(planner, resolving(namespace)))
    messages = bags.of_vehicle(path, namespace, read, NEEDED)
    inputs = tuple(each for each in messages if each.topic not in COMPARED)
    outputs = (each for each in messages if each.topic in COMPARED)
    answers = sorted(_answers(outputs), key=lambda each: each.sent)
    if tick is not None and not 0 <= tick < len(answers):
        raise BadInput('--tick', tick, f'0 to {len(answers) - 1}')
    simulated = values.get('use_sim_time', any(each.topic == CLOCK for each in inputs))
    last = len(answers) if tick is None else tick + 1
    return Recording(namespace, planner, bool(simulated), inputs, tuple(answers[:last]))


def _answers(sent: Iterable[Message]) -> Iterator[RecordedTick]:
    """Yield every answer, of at most one message per topic; repeated answers count once."""
    by_stamp: dict[int, list[dict[str, Message]]] = defaultdict(lambda: [{}, {}])
    for each in sent:
        groups = by_stamp[each.stamp]
        if each.topic in groups[-1]:
            groups.append({})
        groups[-1][each.topic] = each
    for stamp, groups in by_stamp.items():
        for before, now in itertools.pairwise(groups):
            earlier = {topic: each.data for topic, each in before.items()}
            if any(earlier.get(topic) != each.data for topic, each in now.items()):
                contents = {topic: each.content for topic, each in now.items()}
                begun = min(each.sent for each in now.values())
                yield RecordedTick(stamp, begun, published(contents))


# --- its inputs, answered again


@dataclass(frozen=True)
class ReplayedTick:
    """A tick answered again."""

    recorded: RecordedTick  # the recorded answer
    answer: Answer  # the answer of the replay
    refusals: tuple[str, ...]  # validation errors of inputs since the previous tick
    decision: Decision  # behind the answer of the replay


def replayed(recording: Recording) -> Iterator[ReplayedTick]:
    """Yield a tick for each that was recorded, with inputs as the planner received them."""
    settings, simulated = recording.settings, recording.simulated
    planner = OfflinePlanner(settings, f'{recording.namespace}/planner')
    planner.inputs.lag = settings.step if simulated else 0.0
    # Whether a goal could be transformed is not recorded.
    frame = '' if settings.tf or settings.transforms else settings.frame_id
    probed = replace(settings, goal_prediction='hold', frame_id=frame)
    inputs, clock, counts = list(recording.inputs), None, dict[str, int]()
    for recorded in recording.answers:
        sent = inputs[: bisect_right(inputs, recorded.sent, key=lambda each: each.sent)]
        until = _until(sent, recorded)
        came = [each for each in sent if each.sent <= until[each.topic]]
        inputs[: len(sent)] = [each for each in sent if each.sent > until[each.topic]]
        counted = recorded.answer.get('goal_counts', {})
        lost, refusals = _lost(came, counts, counted, probed), list[str]()
        counts |= counted
        for each in came:
            if each.topic == CLOCK:
                clock = each.stamp
            elif each not in lost:
                now, ros = each.sent / SECOND, clock if simulated else each.sent
                refusals.append(planner.inputs.update(each.topic, each.content, now, ros))
        delay = 0.0 if simulated else (recorded.sent - recorded.stamp) / SECOND
        decision = _decision(planner, recorded, delay)
        answer = published(planner.messages(decision, recorded.stamp))
        delay = recorded.answer.get('sent', delay)
        at = (recorded.stamp + round(delay * SECOND)) / SECOND
        planner.planner.sent(recorded_command(settings, decision.command, recorded.answer), at)
        yield ReplayedTick(recorded, answer, tuple(filter(None, refusals)), decision)


def _decision(planner: OfflinePlanner, recorded: RecordedTick, delay: float) -> Decision:
    """Decide again; ``delay`` [s] is the age of the odometry if the tick tells none."""
    answer, stop = recorded.answer, None
    word = answer.get('cause')
    cause = Cause(word) if word in list(Cause) else Cause.NONE
    if cause in (Cause.AFRESH, Cause.RESET):
        planner.start_afresh(wind=cause is Cause.RESET)
    if not recorded.planned:
        stop = Reason(cause, answer.get('reason', ''))
    elif planner.stamp != recorded.stamp:
        stop = Reason(Cause.WAITING, 'its odometry was refused, or a goal is missing')
    ros = recorded.stamp + round(answer.get('advanced', delay) * SECOND)
    return planner.decide(recorded.sent / SECOND, ros, stop)


def recorded_command(settings: PlannerSettings, command: Command, answer: Answer) -> Command:
    """Return a command with the speed or thrust and the body rate of an answer, if possible."""
    problem = settings.problem
    name, weight = ('force', settings.mass) if problem.inertial else ('speed', 1.0)
    if name in answer:
        share = answer[name] / (weight * problem.forward)
        command = replace(command, speed_fraction=min(1.0, max(0.0, share)))  # 0 for NaN
    if np.isfinite(answer.get('body_rate', math.nan)).all():
        turned = settings.frames.turned(answer['body_rate'])
        command = replace(command, body_rate=turned[-len(command.body_rate) :].copy())
    return command


def _lost(
    came: Sequence[Message], before: Answer, now: Answer, settings: PlannerSettings
) -> list[Message]:
    """Return the goals that the planner never received, from its counts ``before`` and ``now``.

    Its queues hold one message: of several acceptable goals, it received the newest.
    """
    lost: list[Message] = []
    for topic in now.keys() & GOALS:
        probe, goals = Inputs(settings), [each for each in came if each.topic == topic]
        good = [each for each in goals if not probe.update(topic, each.content, 0.0)]
        lost += good[: max(0, len(good) - (now[topic] - before.get(topic, 0)))]
    return lost


def _until(sent: Sequence[Message], recorded: RecordedTick) -> dict[str, int]:
    """Return the time of sending of the last input that a tick used, by topic [ns].

    The stamps in a tick identify its input messages. For inputs without stamps there, the times of
    sending decide, which ignores the transport delay.
    """
    answer, topics = recorded.answer, {each.topic for each in sent}

    def last(topic: str, stamp: int | None) -> int:
        """Return when the last message with a stamp was sent [ns]; -1 if there is none."""
        times = (each.sent for each in sent if each.topic == topic and each.stamp == stamp)
        return max(times, default=-1)

    measured = last('odom', recorded.stamp)
    # If times are mere stamps, a solve seems to take no time: inputs before the odometry count.
    begun = max(recorded.sent - round(1e6 * answer.get('solve_time_ms', 0.0)), measured)
    until = dict.fromkeys(topics, begun)
    if measured >= 0 or recorded.solved:  # else the odometry belongs to an earlier answer
        until['odom'] = measured
    stamps = answer.get('goal_stamps', {})
    if recorded.planned:  # other ticks have no stamps of traffic
        traffic = dict.fromkeys(topics - {*READ, *TRANSFORMS, CLOCK}, None)
        stamps = traffic | answer.get('traffic_stamps', {}) | stamps
    return until | {topic: last(topic, stamp) for topic, stamp in stamps.items()}


# --- differences, and how large they may be


class Comparison(NamedTuple):
    """One quantity of one tick, recorded and replayed."""

    tick: int  # its number
    time: float  # its stamp [s]
    quantity: str  # one of :data:`QUANTITIES`
    recorded: Any  # its value
    replayed: Any  # its value
    apart: float  # distance of the values; infinite if one is missing or words differ
    allowed: float  # largest distance allowed

    @property
    def differs(self) -> bool:
        """Return whether the distance exceeds what is allowed."""
        return not self.apart <= self.allowed

    def __str__(self) -> str:
        unit = UNITS.get(self.quantity, '')
        values = f'{shown(self.recorded)} -> {shown(self.replayed)} {unit}'.rstrip()
        off = f': off by {self.apart:.2g}, allowed {self.allowed:.2g}'
        where = f'tick {self.tick} at {self.time:.3f} s: {self.quantity} {values}'
        return where + (off if math.isfinite(self.apart) else '')


def compared(ticks: Sequence[ReplayedTick], settings: PlannerSettings) -> Iterator[Comparison]:
    """Yield the comparisons of all ticks: one for every quantity that was recorded."""
    for tick, each in enumerate(ticks):
        then, now = each.recorded.answer, each.answer
        for quantity in QUANTITIES:
            before, after = then.get(quantity), now.get(quantity)
            if before is not None:
                apart = distance(quantity, before, after, settings.problem.step)
                allowed = tolerance(quantity, settings, then, now)
                time = each.recorded.stamp / SECOND
                yield Comparison(tick, time, quantity, before, after, apart, allowed)


def tolerance(quantity: str, settings: PlannerSettings, *answers: Answer) -> float:
    """Return the tolerance of a quantity between answers; words must be equal.

    Exact proofs use the time left after the command, and a bound without one is not published:
    unless both answers have one, gaps and ``optimal`` versus ``feasible`` are not compared. Nor
    are two gaps that both remain open: if a search ends before its proof is complete, rounding
    decides which nodes were explored last. If two gaps agree within their tolerance, on both sides
    of that of ``optimal``, so do the statuses.

    A plan determines attitude as a direction of thrust. The smaller the thrust, the less its
    direction matters, and the less precise it is: a turn's tolerance is divided by the share.
    """
    problem, least_gap = settings.problem, settings.gap_tolerance
    gaps = [each['gap'] for each in answers if each.get('gap') is not None]
    planned = all(each.get('status') in PLANNED for each in answers)
    proved = all(each.get('bound_checked', True) for each in answers)
    if quantity in ('status', 'gap') and planned and not proved:
        return math.inf
    complete = len(gaps) == len(answers)
    if quantity == 'status' and planned and complete:
        at_the_limit = min(gaps) <= least_gap < max(gaps) <= min(gaps) + least_gap
        return math.inf if at_the_limit else 0.0
    if quantity == 'gap':
        left_open = complete and all(least_gap < gap < math.inf for gap in gaps)
        return math.inf if left_open else least_gap
    if quantity == 'objective':  # searches may end at different plans within their gaps
        return max(OBJECTIVE, min(max(gaps, default=0.0), least_gap))
    if quantity in TURNS:  # the command depends on these steps of the plan
        steps = slice(1, problem.rotation_order + 1)
        shares = itertools.chain(*(each.get('speed_fraction', [])[steps] for each in answers))
        least = min([1.0, *shares])
        return (RATE if quantity == 'body_rate' else ANGLE) / least if least > 0.0 else math.inf
    full = {'speed': problem.forward, 'force': problem.forward * settings.mass}
    return SPEED * full.get(quantity, 0.0)


@np.errstate(all='ignore')  # recorded numbers may be of any size
def distance(quantity: str, before: Any, now: Any, step: float) -> float:
    """Return the distance between two values of a quantity; body rates are held for a step [s]."""
    if now is None:
        return math.inf
    if quantity in TEXTS:
        return 0.0 if before == now else math.inf
    if quantity == 'rotation':
        return _turned(before, now)
    if quantity == 'body_rate':
        # Compared as rotations: half a turn to the left equals half a turn to the right.
        return _turned(*(to_quaternion(exp(step * rate)) for rate in (before, now))) / step
    if before == now or (math.isnan(before) and math.isnan(now)):  # both infinite, or unknown
        return 0.0
    scale = max(abs(before), ROUNDING / OBJECTIVE) if quantity == 'objective' else 1.0
    apart = abs(before - now) / scale
    return math.inf if math.isnan(apart) else apart


def _turned(before: Any, now: Any) -> float:
    """Return the angle between two quaternions [rad]; q and -q are the same rotation."""
    aligned = now if before @ now >= 0.0 else -now
    half = float(np.linalg.norm(before - aligned)) / 2.0
    return math.inf if math.isnan(half) else 4.0 * math.asin(min(1.0, half))


def shown(value: Any, digits: int = 6) -> str:
    """Return a value as text for comparison by eye; arrays with the given number of digits."""
    if value is None:
        return 'none'
    if isinstance(value, str):
        return value or '-'
    if isinstance(value, (int, float)):
        return f'{value:.9g}'
    return '(' + ', '.join(f'{each:.{digits}g}' for each in value) + ')'
