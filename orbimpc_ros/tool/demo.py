"""``orbimpc demo``: planner and simulator as processes over DDS, a bag, a summary, a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput

if TYPE_CHECKING:
    from orbimpc_ros.tool.history import History
    from orbimpc_ros.tool.processes import Interruptions, Process
    from orbimpc_ros.tool.recorder import Recorder
    from orbimpc_ros.tool.settings import Values

SCENARIOS = ('retrieval', 'retrieval3d', 'dubins', 'spacecraft')
# The paper shows the Dubins car with and without minimum speed. Flights of a demo, by name.
VARIANTS = {'dubins': {'none': ('floor.shape=none',), 'polygon': ('floor.shape=polygon',)}}
OF_A_DEMO = {'exit_when_done': True, 'wait_subscribers': 2}
SPIN = 0.05  # [s]
QUIET, LAST_WORDS = 0.1, 1.0  # [s] without a message, and at most, until the bag is complete


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
    flights = _flights(args.scenario, args.set)
    folder = new_folder(args.out, args.scenario)
    places = {name: folder / name if name else folder for name in flights}
    for name, values in flights.items():
        places[name].mkdir(exist_ok=True)
        fly(values, places[name])
    return report(folder, places)


def _flights(scenario: str, changes: list[str]) -> dict[str, Values]:
    """Return the parameters of each flight of a demo, by name; a single one has none.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    from orbimpc_ros.tool import settings
    from orbimpc_ros.tool.share import config

    variants = VARIANTS.get(scenario, {'': ()})
    if any(change.startswith('floor.shape=') for change in changes):
        variants = {'': ()}
    file = config(f'{scenario}.yaml')
    return {
        name: settings.resolve(file, [*changes, *variant]) | OF_A_DEMO
        for name, variant in variants.items()
    }


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
    from orbimpc_ros.tool.recorder import Recorder
    from orbimpc_ros.tool.topics import topics_of

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


def report(folder: Path, places: Mapping[str, Path]) -> int:
    """Sum up the flights of a demo from their bags, draw pictures, and return the exit code.

    Args:
        folder: takes the pictures.
        places: of the flights' bags, by name.
    """
    from orbimpc_ros.tool import figures, history, summary

    flown = {name: history.of_bag(place / 'bag') for name, place in places.items()}
    for name, each in flown.items():
        print(f'{name}:\n{summary.text(each)}' if name else summary.text(each))
    for place in places.values():
        print(f'bag           {place / "bag"}')
    if any(each.values['finish'] == 'arrival' for each in flown.values()):
        print(_arrivals(flown))
    for name, figure in figures.of_runs(flown).items():
        figures.save(figure, folder / name)
        label = 'picture' if name == figures.TRAJECTORY else Path(name).stem
        print(f'{label:<14}{folder / name}')
    return 0 if all(each.captured for each in flown.values()) else 1


def _arrivals(flown: Mapping[str, History]) -> str:
    """Return a table of errors at arrival: of the flights and, unflown, under the true floor."""
    from orbimpc_ros.tool import arrivals

    columns = {
        arrivals.title(run.values): arrivals.column(run.values, run) for run in flown.values()
    }
    if len(flown) > 1:
        values = next(iter(flown.values())).values | {'floor.shape': 'circle'}
        columns[arrivals.title(values)] = arrivals.column(values)
    return arrivals.table(columns)
