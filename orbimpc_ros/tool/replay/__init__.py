"""``orbimpc replay``: a bag's inputs solved again, tick by tick, and compared with its outputs."""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput

if TYPE_CHECKING:
    from orbimpc_ros.ros.parameters import PlannerSettings
    from orbimpc_ros.tool.io.settings import Values
    from orbimpc_ros.tool.replay.coverage import Coverage
    from orbimpc_ros.tool.replay.difference import Comparison, Tolerances
    from orbimpc_ros.tool.replay.recording import Recording
    from orbimpc_ros.tool.replay.resolving import Replayed

LINES = 20  # differences told one by one
SAME, DIFFERENT = 0, 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('bag', metavar='BAG', help='its folder, .mcap or .db3 file')
    parser.add_argument(
        '--params', metavar='FILE', help='parameters; by default those that the bag was made with'
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='override a parameter: what if? may be repeated',
    )
    parser.add_argument(
        '--tick', type=int, metavar='K', help='show this tick alone, recorded and replayed'
    )
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='of the vehicle, such as /uav1'
    )
    parser.add_argument(
        '--unanswered',
        type=int,
        metavar='N',
        help='so many odometry messages may be without an answer; by default none in lock-step, '
        'and any number elsewhere',
    )
    parser.add_argument(
        '--update', action='store_true', help="accept: replace the bag's outputs by the new ones"
    )


def run(args: argparse.Namespace) -> int:
    """Solve a bag's inputs again, compare, tell; 0 if nothing differs beyond the tolerances."""
    from orbimpc_ros.ros.parameters import planner_settings
    from orbimpc_ros.tool.replay.accept import accept
    from orbimpc_ros.tool.replay.coverage import coverage
    from orbimpc_ros.tool.replay.recording import recording_of
    from orbimpc_ros.tool.replay.resolving import before, replayed

    begun = time.perf_counter()
    path, namespace = Path(args.bag), _namespace(args.namespace)
    values = _values(path, namespace, args)
    settings = planner_settings(values)
    recording = recording_of(path, namespace)
    if args.tick is not None:
        recording = before(recording, _tick(args, len(recording.answers)))
    simulated = bool(values.get('use_sim_time', recording.simulated))
    answers = list(replayed(recording, settings, simulated))
    found = compared(answers, settings)
    if args.tick is not None:
        _show(answers[-1], [each for each in found if each.tick == args.tick])
        return DIFFERENT if any(c.differs for c in found if c.tick == args.tick) else SAME
    whole = coverage(recording, settings)
    _tell(recording, found, answers, whole, time.perf_counter() - begun)
    if args.update:
        accept(recording, answers, values)
        print(f'accepted      {path}')
        return SAME
    lacking = whole.unanswered > _may_be_unanswered(args.unanswered, recording, settings)
    differs = any(each.differs for each in found)
    return DIFFERENT if differs or lacking or whole.orphans else SAME


def _may_be_unanswered(given: int | None, recording: Recording, settings: PlannerSettings) -> float:
    """Return how many odometry messages may be without an answer.

    In lock-step each is waited for. Elsewhere a busy planner passes over some, and a timer's
    answers only the last before each tick.
    """
    if given is not None:
        return given
    return 0 if recording.simulated and settings.on_odometry else math.inf


def _namespace(given: str) -> str:
    return f'/{given.strip("/")}' if given.strip('/') else ''


def _tick(args: argparse.Namespace, count: int) -> int:
    """Return the number of the tick asked for.

    Raises:
        BadInput: there is no such tick, or the command would accept what it does not show.
    """
    if args.update:
        raise BadInput('--update', 'given with --tick', 'one of the two')
    if not 0 <= args.tick < count:
        raise BadInput('--tick', args.tick, f'0 to {count - 1}')
    return int(args.tick)


def _values(path: Path, namespace: str, args: argparse.Namespace) -> Values:
    """Return every parameter's value: as given, or as noted in the bag by whoever recorded it."""
    from orbimpc_ros.tool.io import settings

    if args.params is not None:
        return settings.resolve(Path(args.params), args.set)
    noted = settings.of_bag(path, namespace)
    if noted is None and not args.set:
        raise BadInput(str(path), 'without notes of its parameters', '--params FILE or --set')
    return settings.changed(settings.read('{}') if noted is None else noted, args.set)


def compared(replayed: Sequence[Replayed], settings: PlannerSettings) -> list[Comparison]:
    """Return the comparisons of all answers."""
    from orbimpc_ros.tool.io.stamps import SECOND
    from orbimpc_ros.tool.replay.answer import answer_of
    from orbimpc_ros.tool.replay.difference import comparisons

    tolerances = _tolerances(settings)
    return [
        comparison
        for tick, each in enumerate(replayed)
        for comparison in comparisons(
            tick,
            each.recorded.stamp / SECOND,
            each.recorded.answer,
            answer_of(each.messages),
            tolerances,
        )
    ]


def _tolerances(settings: PlannerSettings) -> Tolerances:
    from orbimpc_ros.tool.replay.difference import SPEED, Tolerances

    problem = settings.problem
    return Tolerances(
        speed=SPEED * problem.forward,
        force=SPEED * problem.forward * settings.mass,
        gap=settings.gap_tolerance,
        step=problem.step,
        order=problem.rotation_order,
    )


def _tell(
    recording: Recording,
    found: Sequence[Comparison],
    replayed: Sequence[Replayed],
    whole: Coverage,
    elapsed: float,
) -> None:
    differences = [each for each in found if each.differs]
    for each in differences[:LINES]:
        print(each)
    if len(differences) > LINES:
        print(f'... and {len(differences) - LINES} more')
    print(f'replayed      {len(replayed)} ticks of {recording.path} in {elapsed:.2f} s')
    refused = sum(len(each.refusals) for each in replayed)
    print(f'inputs        {recording.told}, {refused} refused')
    print(f'unanswered    {whole}')
    counts = Counter(each.quantity for each in found)
    print(f'compared      {", ".join(f"{n} {quantity}" for quantity, n in counts.items())}')
    print(f'differences   {_summary(differences)}')


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


def _show(replayed: Replayed, found: Sequence[Comparison]) -> None:
    """Print one tick, recorded and replayed side by side."""
    from orbimpc_ros.tool.replay.answer import answer_of
    from orbimpc_ros.tool.replay.difference import UNITS, shown

    then, now = replayed.recorded.answer, answer_of(replayed.messages)
    print(f'{f"tick {found[0].tick} at {found[0].time:.3f} s":<22}{"recorded":<34}replayed')
    for each in found:
        unit = f' [{UNITS[each.quantity]}]' if each.quantity in UNITS else ''
        mark = '   differs' if each.differs else ''
        row = f'{each.quantity + unit:<22}{shown(each.recorded):<34}{shown(each.replayed)}'
        print(row + mark)
    if then.reason or now.reason:
        print(f'{"reason":<22}{shown(then.reason):<34}{shown(now.reason)}')
    for refusal in replayed.refusals:
        print(refusal)
