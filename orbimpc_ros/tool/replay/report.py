# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A replay from its arguments to its exit code: ticks made anew, compared, and summed up."""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters import PlannerSettings, planner_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import resolved
from orbimpc_ros.tool.replay.accept import accept
from orbimpc_ros.tool.replay.coverage import Coverage, coverage
from orbimpc_ros.tool.replay.difference import UNITS, Comparison, compared, shown
from orbimpc_ros.tool.replay.recording import Recording, published, recording_of
from orbimpc_ros.tool.replay.resolving import ReplayedTick, replayed
from orbimpc_ros.tool.summary import lines

LINES = 20  # differences printed one by one
SAME, DIFFERENT = 0, 1


def run(args: argparse.Namespace) -> int:
    """Replay, print, and return the exit code."""
    begun = time.perf_counter()
    values = _values(Path(args.bag), args.namespace, args.params, args.set)
    recording, planner = _opened(Path(args.bag), args.namespace, values)
    if args.tick is not None:
        wanted = _tick(args, len(recording.answers))
        recording = replace(recording, answers=recording.answers[: wanted + 1])
    answers = list(_replayed(recording, planner, values))
    found = compared(answers, planner)
    if args.tick is not None:
        found = [each for each in found if each.tick == args.tick]
        _show(answers[-1], found)
        return DIFFERENT if any(each.differs for each in found) else SAME
    whole = coverage(recording, planner)
    _print(recording, found, answers, whole, time.perf_counter() - begun)
    if args.update:
        accept(recording, answers, values)
        print(f'accepted      {recording.path}')
        return SAME
    lacking = whole.unanswered > _may_be_unanswered(recording, planner)
    differs = any(each.differs for each in found)
    return DIFFERENT if differs or lacking or whole.orphans else SAME


def ticks_of(path: Path, params: str | None, namespace: str) -> Iterator[ReplayedTick]:
    """Yield the ticks of a bag, made anew with the parameters that it was made with.

    Args:
        path: of the bag.
        params: a file of parameters, for a bag without notes of them.
        namespace: of the vehicle.
    """
    values = _values(path, namespace, params, [])
    yield from _replayed(*_opened(path, namespace, values), values)


def _opened(
    path: Path, namespace: str, values: settings.Values
) -> tuple[Recording, PlannerSettings]:
    planner = planner_settings(values)
    return recording_of(path, namespace, resolved(planner, namespace)), planner


def _replayed(
    recording: Recording, planner: PlannerSettings, values: settings.Values
) -> Iterator[ReplayedTick]:
    return replayed(recording, planner, bool(values.get('use_sim_time', recording.simulated)))


def _may_be_unanswered(recording: Recording, planner: PlannerSettings) -> float:
    """Return how many odometry messages may be without an answer.

    In lock-step each is waited for. Elsewhere a busy planner passes over some, and a timer's
    answers only the last before each tick.
    """
    return 0 if recording.simulated and planner.trigger == 'odom' else math.inf


def _tick(args: argparse.Namespace, count: int) -> int:
    """Return the number of the tick asked for.

    Raises:
        BadInput: there is no such tick, or the command would accept what it does not show.
    """
    if args.update:
        raise BadInput.stating('--update', 'given with --tick', 'give one of the two')
    if not 0 <= args.tick < count:
        raise BadInput('--tick', args.tick, f'0 to {count - 1}')
    return int(args.tick)


def _values(
    path: Path, namespace: str, params: str | None, changes: Sequence[str]
) -> settings.Values:
    """Return every parameter's value: as given, or as noted in the bag by whoever recorded it."""
    if params is not None:
        return settings.resolve(Path(params), changes)
    noted = settings.of_bag(path, namespace)
    if noted is None and not changes:
        raise BadInput.stating(
            str(path), 'no notes of its parameters', 'give --params FILE or --set'
        )
    return settings.changed(settings.read('{}') if noted is None else noted, changes)


def _print(
    recording: Recording,
    found: Sequence[Comparison],
    answers: Sequence[ReplayedTick],
    whole: Coverage,
    elapsed: float,
) -> None:
    differences = [each for each in found if each.differs]
    for each in differences[:LINES]:
        print(each)
    if len(differences) > LINES:
        print(f'... and {len(differences) - LINES} more')
    refused = sum(len(each.refusals) for each in answers)
    counts = Counter(each.quantity for each in found)
    rows = {
        'replayed': f'{len(answers)} ticks of {recording.path} in {elapsed:.2f} s',
        'inputs': f'{recording.received}, {refused} refused',
        'unanswered': str(whole),
        'compared': ', '.join(f'{n} {quantity}' for quantity, n in counts.items()),
        'differences': _summary(differences),
    }
    print(lines(rows))


def _summary(differences: Sequence[Comparison]) -> str:
    if not differences:
        return 'none'
    worst: dict[str, Comparison] = {}
    for each in differences:
        if each.quantity not in worst or each.apart > worst[each.quantity].apart:
            worst[each.quantity] = each
    ticks = len({each.tick for each in differences})
    parts = ', '.join(f'{name} at tick {each.tick}' for name, each in worst.items())
    return f'{len(differences)} in {ticks} ticks; worst {parts}'


def _show(tick: ReplayedTick, found: Sequence[Comparison]) -> None:
    """Print one tick, recorded and replayed side by side."""
    then, now = tick.recorded.answer, published(tick.messages)
    print(f'{f"tick {found[0].tick} at {found[0].time:.3f} s":<20}{"recorded":<26}replayed')
    for each in found:
        unit = f' [{UNITS[each.quantity]}]' if each.quantity in UNITS else ''
        mark = '  differs' if each.differs else ''
        values = f'{shown(each.recorded, 4):<26}{shown(each.replayed, 4)}'
        print(f'{each.quantity + unit:<20}{values}{mark}')
    if then.reason or now.reason:
        print(lines({'recorded': shown(then.reason), 'replayed': shown(now.reason)}))
    for refusal in tick.refusals:
        print(refusal)
