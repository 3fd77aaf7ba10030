"""``orbimpc demo``: planner and simulator as processes over DDS, a bag, a summary, a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput

if TYPE_CHECKING:
    from orbimpc_ros.tool.processes import Interruptions, Process
    from orbimpc_ros.tool.recorder import Recorder
    from orbimpc_ros.tool.settings import Values

SCENARIOS = ('retrieval',)
SPIN = 0.05  # [s]
QUIET, LAST_WORDS = 0.1, 1.0  # [s] without a message, and at most, until the bag is complete
PICTURE = 'trajectory.png'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('scenario', nargs='?', default='retrieval', choices=SCENARIOS)
    parser.add_argument(
        '--out', default='out', metavar='DIR', help='takes the results (default: %(default)s)'
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='override a parameter of planner or simulator; may be repeated',
    )


def run(args: argparse.Namespace) -> int:
    """Fly, record, sum up, draw; 0 only if the job was done."""
    from orbimpc_ros.tool import settings
    from orbimpc_ros.tool.share import config

    values = settings.resolve(config(f'{args.scenario}.yaml'), args.set)
    values |= {'exit_when_done': True, 'wait_subscribers': 2}
    folder = new_folder(args.out, args.scenario)
    fly(values, folder)
    return report(folder)


def new_folder(out: str, name: str) -> Path:
    """Create ``out/name``, or ``out/name-2`` and so on: what is there stays.

    Raises:
        BadInput: it cannot be created.
    """
    for number in range(1, 10_000):
        folder = Path(out).resolve() / (name if number == 1 else f'{name}-{number}')
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            if not folder.is_dir():
                break
        except OSError as error:
            raise BadInput('--out', f'{out} ({error.strerror})', 'a folder to write to') from None
    raise BadInput('--out', out, 'a folder to write to')


def fly(values: Values, folder: Path) -> None:
    """Run planner and simulator until the simulator is done, and record what they say.

    Raises:
        ProcessFailure: a node has failed.
        KeyboardInterrupt: somebody asked to stop; the bag is complete up to then.
    """
    from orbimpc_ros.tool import discovery, processes, settings

    simulated = values['clock'] == 'lockstep'
    parameters = folder / 'parameters.yaml'
    text = settings.write(parameters, values, use_sim_time=simulated)
    print(f'ROS_DOMAIN_ID={discovery.isolate(folder)}, results in {folder}')
    with processes.Interruptions() as interruptions:
        with _nodes(parameters, folder) as (planner, sim), _recorder(folder, text) as recorder:
            _watch(planner, sim, recorder, interruptions, values)
        if interruptions.requested:
            raise KeyboardInterrupt


@contextmanager
def _nodes(parameters: Path, folder: Path) -> Iterator[tuple[Process, Process]]:
    from orbimpc_ros.tool.processes import Process

    started: list[Process] = []
    try:
        for name in ('planner', 'sim'):
            module = f'orbimpc_ros.ros.{name}'
            started.append(Process(module, parameters, folder / f'{name}.log'))
        yield started[0], started[1]
    finally:
        for process in started:
            process.stop()


@contextmanager
def _recorder(folder: Path, parameters: str) -> Iterator[Recorder]:
    from orbimpc_ros.tool.recorder import Recorder, topics_of

    recorder = Recorder(folder / 'bag', topics_of(), {'parameters': parameters})
    try:
        yield recorder
    finally:
        recorder.close()


def _watch(
    planner: Process,
    sim: Process,
    recorder: Recorder,
    interruptions: Interruptions,
    values: Values,
) -> None:
    """Record until the simulator is done or somebody asks to stop."""
    from orbimpc_ros.tool.progress import Progress

    progress = Progress(values['max_ticks'])
    while sim.running and not interruptions.requested:
        recorder.spin(SPIN)
        planner.require_health()
        ticks = recorder.counts['/tick']
        time = ticks * values['step']
        progress.show(ticks, f'tick {ticks} of at most {values["max_ticks"]}, t = {time:.0f} s')
    progress.close()
    recorder.drain(QUIET, LAST_WORDS)
    # Whether it caught anything or not, a simulator that has come to its end says so.
    if not interruptions.requested and not recorder.counts['/captured']:
        sim.require_health()


def report(folder: Path) -> int:
    """Sum up a run from its bag, draw its picture, and return the exit code."""
    from orbimpc_ros.tool import figures, history, summary

    flown = history.of_bag(folder / 'bag')
    figures.save(figures.retrieval(flown), folder / PICTURE)
    print(summary.text(flown))
    print(f'bag           {folder / "bag"}\npicture       {folder / PICTURE}')
    return 0 if flown.captured else 1
