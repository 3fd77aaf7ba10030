# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A replay from its arguments to its exit code: ticks made anew, compared, and summed up."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters import PlannerSettings, planner_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import resolved
from orbimpc_ros.tool.replay.difference import UNITS, Comparison, compared, shown
from orbimpc_ros.tool.replay.recording import Recording, published, recording_of
from orbimpc_ros.tool.replay.resolving import ReplayedTick, replayed
from orbimpc_ros.tool.settings import Values
from orbimpc_ros.tool.summary import lines

LINES = 20  # differences printed one by one
SAME, DIFFERENT = 0, 1


def run(args: argparse.Namespace) -> int:
    """Replay, print, and return the exit code."""
    begun = time.perf_counter()
    values = _values(Path(args.bag), args.namespace, args.params, args.set)
    recording, planner = _opened(Path(args.bag), args.namespace, values)
    if args.tick is not None:
        return _show(recording, planner, values, args)
    answers = list(_replayed(recording, planner, values))
    found = compared(answers, planner)
    refused = sum(len(each.refusals) for each in answers)
    counts = Counter(each.quantity for each in found)
    differences = [each for each in found if each.differs]
    for each in differences[:LINES]:
        print(each)
    if len(differences) > LINES:
        print(f'... and {len(differences) - LINES} more')
    elapsed = time.perf_counter() - begun
    rows = {
        'replayed': f'{len(answers)} ticks of {recording.path} in {elapsed:.2f} s',
        'inputs': f'{recording.received}, {refused} refused',
        'compared': ', '.join(f'{n} {quantity}' for quantity, n in counts.items()),
        'differences': _summary(differences),
    }
    print(lines(rows))
    return DIFFERENT if differences else SAME


def ticks_of(path: Path, params: str | None, namespace: str) -> Iterator[ReplayedTick]:
    """Yield the ticks of a bag, made anew with the parameters that it was made with.

    Args:
        path: of the bag.
        params: a file of parameters, for a bag without notes of them.
        namespace: of the vehicle.
    """
    values = _values(path, namespace, params, [])
    yield from _replayed(*_opened(path, namespace, values), values)


def _values(path: Path, namespace: str, params: str | None, changes: Sequence[str]) -> Values:
    """Return every parameter's value: as given, or as noted in the bag by its recorder."""
    if params is not None:
        return settings.resolve(Path(params), changes)
    noted = settings.of_bag(path, namespace)
    if noted is None and not changes:
        missing = 'no notes of its parameters'
        raise BadInput.stating(str(path), missing, 'give --params FILE or --set')
    return settings.changed(settings.read('{}') if noted is None else noted, changes)


def _opened(path: Path, namespace: str, values: Values) -> tuple[Recording, PlannerSettings]:
    planner = planner_settings(values)
    return recording_of(path, namespace, resolved(planner, namespace)), planner


def _replayed(
    recording: Recording, planner: PlannerSettings, values: Values
) -> Iterator[ReplayedTick]:
    return replayed(recording, planner, bool(values.get('use_sim_time', recording.simulated)))


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


def _show(
    recording: Recording, planner: PlannerSettings, values: Values, args: argparse.Namespace
) -> int:
    """Print one tick, recorded and replayed side by side; return the exit code."""
    number, count = args.tick, len(recording.answers)
    if not 0 <= number < count:
        raise BadInput('--tick', number, f'0 to {count - 1}')
    recording = replace(recording, answers=recording.answers[: number + 1])
    answers = list(_replayed(recording, planner, values))
    found = [each for each in compared(answers, planner) if each.tick == number]
    then, now = answers[-1].recorded.answer, published(answers[-1].messages)
    print(f'{f"tick {number} at {found[0].time:.3f} s":<20}{"recorded":<26}replayed')
    for each in found:
        unit = f' [{UNITS[each.quantity]}]' if each.quantity in UNITS else ''
        mark = '  differs' if each.differs else ''
        pair = f'{shown(each.recorded, 4):<26}{shown(each.replayed, 4)}'
        print(f'{each.quantity + unit:<20}{pair}{mark}')
    if then.reason or now.reason:
        print(lines({'recorded': shown(then.reason), 'replayed': shown(now.reason)}))
    for refusal in answers[-1].refusals:
        print(refusal)
    return DIFFERENT if any(each.differs for each in found) else SAME
