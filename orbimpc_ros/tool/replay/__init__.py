# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc replay``: a bag's inputs solved again, tick by tick, and compared with its outputs."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.arguments import add_namespace, add_set

if TYPE_CHECKING:
    from orbimpc_ros.ros.parameters.planner import PlannerSettings
    from orbimpc_ros.tool.replay.difference import Comparison
    from orbimpc_ros.tool.replay.recording import Recording
    from orbimpc_ros.tool.replay.resolving import ReplayedTick

LINES = 20  # differences printed one by one
SAME, DIFFERENT = 0, 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('bag', metavar='BAG', help='its folder, .mcap or .db3 file')
    parser.add_argument(
        '--params', metavar='FILE', help='parameters; by default those that the bag was made with'
    )
    add_set(parser, 'override a parameter: what if?')
    parser.add_argument(
        '--tick', type=int, metavar='K', help='show this tick alone, recorded and replayed'
    )
    add_namespace(parser)


def run(args: argparse.Namespace) -> int:
    """Solve a bag's inputs again, compare, report; 0 if nothing differs beyond the tolerances."""
    from orbimpc_ros.tool.replay.difference import compared
    from orbimpc_ros.tool.replay.resolving import replayed

    begun, path = time.perf_counter(), Path(args.bag)
    recording, planner, simulated = opened(path, args.namespace, args.params, args.set)
    if args.tick is not None:
        if not 0 <= args.tick < len(recording.answers):
            raise BadInput('--tick', args.tick, f'0 to {len(recording.answers) - 1}')
        recording = replace(recording, answers=recording.answers[: args.tick + 1])
    answers = list(replayed(recording, planner, simulated))
    found = list(compared(answers, planner))
    if args.tick is not None:
        found = [each for each in found if each.tick == args.tick]
        _show(answers[-1], found)
    else:
        inputs = f'{recording.received}, {sum(len(each.refusals) for each in answers)} refused'
        took = f'in {time.perf_counter() - begun:.2f} s'
        _sum_up(f'{len(answers)} ticks of {path} {took}', inputs, found)
    return DIFFERENT if any(each.differs for each in found) else SAME


def opened(
    path: Path, namespace: str, params: str | None, changes: Sequence[str] = ()
) -> tuple[Recording, PlannerSettings, bool]:
    """Return what a bag holds, the planner's settings, and whether its time was simulated.

    The settings are those that are given, or noted in the bag by its recorder.
    """
    from orbimpc_ros.ros.parameters.planner import planner_settings  # --help is without ROS
    from orbimpc_ros.tool import settings
    from orbimpc_ros.tool.offline import resolved
    from orbimpc_ros.tool.replay.recording import recording_of

    if params is not None:
        values = settings.resolve(Path(params), changes)
    else:
        noted = settings.of_bag(path, namespace)
        if noted is None and not changes:
            missing = 'no notes of its parameters'
            raise BadInput.stating(str(path), missing, 'give --params FILE or --set')
        values = settings.changed(settings.read('{}') if noted is None else noted, changes)
    planner = planner_settings(values)
    recording = recording_of(path, namespace, resolved(planner, namespace))
    return recording, planner, bool(values.get('use_sim_time', recording.simulated))


def _sum_up(replayed: str, inputs: str, found: Sequence[Comparison]) -> None:
    """Print differences one by one, and how many there are of what."""
    from orbimpc_ros.tool.summary import lines

    differences = [each for each in found if each.differs]
    for each in differences[:LINES]:
        print(each)
    if len(differences) > LINES:
        print(f'... and {len(differences) - LINES} more')
    worst = {each.quantity: each for each in sorted(differences, key=lambda each: each.apart)}
    ticks = len({each.tick for each in differences})
    parts = ', '.join(f'{name} at tick {each.tick}' for name, each in worst.items())
    counts = Counter(each.quantity for each in found)
    rows = {
        'replayed': replayed,
        'inputs': inputs,
        'compared': ', '.join(f'{n} {quantity}' for quantity, n in counts.items()),
        'differences': f'{len(differences)} in {ticks} ticks; worst {parts}' if worst else 'none',
    }
    print(lines(rows))


def _show(tick: ReplayedTick, found: Sequence[Comparison]) -> None:
    """Print one tick, recorded and replayed side by side."""
    from orbimpc_ros.tool.replay.difference import UNITS, shown
    from orbimpc_ros.tool.replay.recording import published

    title = f'tick {found[0].tick} at {found[0].time:.3f} s'
    print(f'{title:<20}{"recorded":<26}replayed')
    for each in found:
        unit = f' [{UNITS[each.quantity]}]' if each.quantity in UNITS else ''
        mark = '  differs' if each.differs else ''
        pair = f'{shown(each.recorded, 4):<26}{shown(each.replayed, 4)}'
        print(f'{each.quantity + unit:<20}{pair}{mark}')
    answers = {'recorded': tick.recorded.answer, 'replayed': published(tick.messages)}
    reasons = {name: each.get('reason', '') for name, each in answers.items()}
    if any(reasons.values()):
        print('\n'.join(f'{name:<14}{shown(each)}' for name, each in reasons.items()))
    for refusal in tick.refusals:
        print(refusal)
