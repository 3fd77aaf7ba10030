# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc study``: fly many random tasks of one vehicle, and report how they end.

The report is a table, with a plot of the share caught over time. The results are saved in a file, a
line for each flight, so that an interrupted study can resume.

A study file names a parameter file, and has a rule for each random parameter:

- a range ``[low, high]``; ``{x: range, y: range}`` for a vector; ``{towards: range, length:
  range}`` for a vector in the plane by its angle [rad] and length; ``{turned: length}`` for a
  vector of this length in a random direction; ``{heading: range}`` for an attitude in the plane;
  ``{turned: any}`` for a random attitude in space; ``{whole: n}`` for a whole number below n.
- ``{bodies: n, at: vector, when: range, speed: range, radius: range, clear: distance}``: n discs
  of constant velocity in random directions. Each passes a random point at a random time, and its
  edge starts at least a distance clear of the origin.
- ``{gates: [x, ...], radius: [r, ...], middle: range, gap: range}``: walls of four static discs
  each, across the x axis, with a gap around a middle.

It is based (``config``) on a file in ``config/``, or at a path from the study file such as
``./boat.yaml``: a parameter file, or another study, to which it adds its values and rules.

A parameter file without rules is a study, too: every flight draws the direction of the goal, the
phase of its swing, the initial heading and the noise seed. If the planner compensates for lags,
the vehicle has them. Without ``max_ticks`` there is time for four times the way to the goal.
"""

from __future__ import annotations

import ctypes
import json
import math
import multiprocessing
import os
import signal
import sys
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from orbimpc_ros import __version__
from orbimpc_ros.mpc.arrays import Array, fields_of, whole
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.tool import files, settings
from orbimpc_ros.tool.files import folder_at, new_folder, why
from orbimpc_ros.tool.offline import OURS, Row, baselines, flown
from orbimpc_ros.tool.plot import Panel, draw_panel, in_both_looks
from orbimpc_ros.tool.processes import ProgressLine, interruptions
from orbimpc_ros.tool.settings import Values, config

MOST_RUNS, LARGEST_SEED, MOST_WORKERS = 1_000_000, 2**63 - 1, 1024
OUT, FLIGHTS, REPORT, PICTURE = 'out', 'flights.jsonl', 'report.md', 'caught.png'
Rule = Any
FIELDS = {'about': str, 'config': str, 'set': list, 'draw': dict}  # of a study file, and types
MOST_TRIES = 10_000  # to draw a body that is clear of the origin
LARGEST_DRAWN = 2**31 - 1  # for seeds of the noise
PATIENCE = 5.0  # [s] for a scheduler to answer, and for its first worker
GLANCE = 0.2  # [s] between checks for a signal
Key = tuple[str, int]  # controller, and number of a flight
Job = tuple[str, str, int, Values]  # arguments of :func:`flown`
Rows = Mapping[str, Sequence[Row]]  # by controller, flights in the same order


def run(
    file: str,
    runs: int,
    seed: int,
    controllers: str,
    changes: Sequence[str],
    out: str | None,
    *,
    resume: bool,
    cluster: str | None,
    workers: int | None,
) -> int:
    """Fly the remaining flights, then report.

    Raises:
        KeyboardInterrupt: a signal arrived; the results so far are kept.
    """
    whole(runs, '--runs', 1, MOST_RUNS)
    whole(seed, '--seed', 0, LARGEST_SEED)
    if workers is not None:
        whole(workers, '--workers', 1, MOST_WORKERS)
        if cluster is not None:
            raise BadInput('--workers', workers, 'only without --cluster, which has its own')
    if resume and out is None:
        raise BadInput('--resume', 'without -o DIR', 'the folder of the study to continue')
    draws, names = draws_of(file, changes), _controllers(controllers)
    about = {
        'version': __version__,
        'seed': seed,
        'values': draws.values,
        'rules': draws.rules,
        'tuned': {n: baselines().tuned_of(draws.name).get(n, {}) for n in names if n != OURS},
    }
    folder = _folder(out, draws.name, resume)
    done = rows_of(folder / FLIGHTS, about, resumed=resume)
    jobs = [
        (draws.name, name, index, draws.of(seed, index))
        for index in range(runs)
        for name in names
        if (name, index) not in done
    ]
    if jobs:
        _fly(done, jobs, folder / FLIGHTS, runs * len(names), cluster, workers)
    rows = {name: [done[name, k] for k in range(runs)] for name in names}
    text = report(draws, rows)
    (folder / REPORT).write_text(text, encoding='utf-8')
    draw(draws, rows, folder / PICTURE)
    print(text, end='')
    return 0


def _folder(out: str | None, name: str, resumed: bool) -> Path:
    if out is None:
        return new_folder(OUT, name)
    folder = Path(out) if resumed else folder_at(Path(out))
    if not resumed and any(folder.iterdir()):
        raise BadInput(out, 'a folder with files', 'a new or an empty folder, or --resume')
    return folder


def _controllers(listed: str) -> list[str]:
    names = listed.split(',')
    available = [OURS] if names == [OURS] else [OURS, *baselines().BASELINES]
    if not {*names} <= {*available} or len({*names}) < len(names):
        raise BadInput('--controllers', listed, f'each of {",".join(available)} at most once')
    return names


def _fly(
    rows: dict[Key, Row],
    jobs: Sequence[Job],
    file: Path,
    total: int,
    cluster: str | None,
    count: int | None,
) -> None:
    """Fly the remaining flights of a total; save each as soon as it is over."""
    done, progress = total - len(jobs), ProgressLine(total)
    with (
        interruptions() as received,
        workers(cluster, count) as pool,
        file.open('a', buffering=1) as out,
    ):
        progress.show(done, f'{done} of {total} flights')
        for row in each_flown(pool, jobs, lambda: not received):
            rows[row['controller'], row['index']] = row
            out.write(json.dumps(row) + '\n')
            done += 1
            progress.show(done, f'{done} of {total} flights')
    progress.close()
    if done < total:
        print(f'kept {done} of {total} flights in {file.parent}; --resume continues them')
        raise KeyboardInterrupt


def rows_of(file: Path, about: dict[str, Any], *, resumed: bool) -> dict[Key, Row]:
    """Return the rows in a study's file, which is created or resumed.

    Args:
        file: of the study; a truncated last line is removed.
        about: specification of the study, in JSON's types.
        resumed: whether the file is resumed.

    Raises:
        BadInput: the file is of another study, is damaged, or is missing.
    """
    if not resumed:
        file.write_text(json.dumps(about) + '\n')
        return {}
    try:
        lines = file.read_bytes().rpartition(b'\n')[0]
        head, *rows = map(json.loads, lines.splitlines())
        differ = [n for n in about if head.get(n) != json.loads(json.dumps(about[n]))]
        kept = {(row['controller'], row['index']): row for row in rows}
    except OSError as error:
        raise BadInput.stating(str(file), why(error), 'a study to continue is needed') from None
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        raise BadInput(str(file), 'damaged', 'the results of a study') from None
    if differ:
        raise BadInput(str(file), f'a study with other {", ".join(differ)}', 'the same')
    os.truncate(file, len(lines) + 1)
    return kept


def each_flown(pool: Executor, jobs: Sequence[Job], going: Callable[[], bool]) -> Iterator[Row]:
    """Yield the rows of flights as they are completed, as long as ``going()``.

    Raises:
        OrbimpcError: a flight ended with an error, or its process did.
    """
    pending: set[Future[Row]] = {pool.submit(flown, *job) for job in jobs}
    try:
        while pending and going():
            done, pending = wait(pending, GLANCE, FIRST_COMPLETED)
            for future in done:
                yield future.result()
    except OrbimpcError:
        raise
    except Exception as error:  # any error of a worker or of its connection
        raise OrbimpcError(f'a flight failed: {type(error).__name__}: {error}') from error
    finally:
        for future in pending:
            future.cancel()


@contextmanager
def workers(cluster: str | None, count: int | None) -> Iterator[Executor]:
    """Yield an executor: processes on this machine, or the workers of a Dask cluster.

    Args:
        cluster: address of a running scheduler, such as ``tcp://host:8786``; None for this machine.
        count: processes on this machine; by default one per core.

    Raises:
        BadInput: no scheduler answers, or it has no workers.
    """
    if cluster is None:
        threads = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'), '1')
        os.environ.update(threads)  # processes take all cores: threads would compete
        with ProcessPoolExecutor(count, multiprocessing.get_context('spawn'), _follow) as pool:
            yield pool
        return
    import distributed

    try:
        client = distributed.Client(cluster, timeout=PATIENCE)
        client.wait_for_workers(1, timeout=PATIENCE)
    except Exception as error:  # of any kind, with which it takes what another server answers
        tried = f'{cluster} ({type(error).__name__})'
        raise BadInput('--cluster', tried, 'the address of a scheduler with workers') from None
    with client:
        yield client.get_executor(pure=False)


def _follow() -> None:
    """Leave Ctrl-C to the parent process, and end with it even if it is killed, on Linux."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG


# --- random parameters


@dataclass(frozen=True)
class Draws:
    """The parameters of a study's flights, fixed and random."""

    name: str  # of the study
    about: str  # the task, in one line
    values: Values  # the parameters common to all flights
    rules: Mapping[str, Rule]  # for random parameters, by name

    def of(self, seed: int, index: int) -> Values:
        """Return all parameters of a flight; each random one has its own random stream."""
        values = dict(self.values)
        for name, rule in self.rules.items():
            own = index, zlib.crc32(name.encode())
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=own))
            try:
                values[name] = settings.ROWS[name].typed(_drawn(rule, rng))
            except BadInput:
                raise
            except (AttributeError, IndexError, KeyError, TypeError, ValueError):
                raise BadInput(f'draw: {name}', rule, 'a rule of docs/recording.md') from None
        return values

    @property
    def limit(self) -> float:
        """Return the longest duration of a flight [s]."""
        return float(self.values['max_ticks'] * _tick(self.values))


def _tick(values: Values) -> float:
    """Return the duration of a tick: a step of the simulator, or a period of odometry [s]."""
    simulated = settings.of_sim(values)
    rate = simulated['odom_rate']
    return float(1.0 / rate if rate else simulated['step'])


def draws_of(name: str, changes: Sequence[str] = ()) -> Draws:
    """Return the draws of a study file or a parameter file.

    Args:
        name: a path, or the name of a file in ``config/studies`` or ``config``, without its ending.
        changes: ``name=value``; parameters set here are not drawn.

    Raises:
        BadInput: there is no such file, it is malformed, or a change is not allowed.
    """
    content = _content(_file(name))
    values = settings.resolve(content['config'], [*map(str, content['set']), *changes])
    fixed = settings.named(changes)
    rules = content['draw']
    if rules is None:
        values, rules = _lasting(values, fixed), _default_rules(values)
    free = {
        parameter: rule
        for parameter, rule in rules.items()
        if not {parameter, parameter.removeprefix(settings.OF_SIM)} & fixed
    }
    title = Path(name).stem if name.endswith('.yaml') else name
    draws = Draws(title, content['about'], values, free)
    for parameter in free:
        if parameter not in settings.ROWS:
            raise BadInput.unknown('parameter', parameter, settings.ROWS, f'{name}: draw')
    settings.changed(draws.of(0, 0), ())
    return draws


def _file(name: str) -> Path:
    studies = config('studies/fixed_wing.yaml').parent
    for file in (Path(name), studies / f'{name}.yaml', studies.parent / f'{name}.yaml'):
        if file.is_file():
            return file
    names = ', '.join(sorted(file.stem for file in studies.glob('*.yaml')))
    raise BadInput('FILE', name, f'a parameter file, or one of {names}')


def _content(file: Path, *above: Path) -> Values:
    """Return the fields of a study file, with those of the file that it is based on.

    A parameter file is a study without rules. Files ``above`` are based on this one.
    """
    content = files.read(str(file))
    if isinstance(content, dict) and 'draw' not in content:
        stated = dict(settings.parameters_of(content, str(file)))
        lags = any(value for name, value in stated.items() if name.startswith('response.'))
        vehicle = ['vehicle=continuous'] if lags and 'vehicle' not in stated else []
        about = f'goals all around, as in {file.name}'
        return {'about': about, 'config': file, 'set': vehicle, 'draw': None}
    fields = fields_of(content, str(file), FIELDS)
    for name, kind in FIELDS.items():
        if not isinstance(fields[name], kind):
            raise BadInput(f'{file}: {name}', fields[name], f'a {kind.__name__}')
    named = fields['config']
    base = file.parent / named if '/' in named else config(named)
    if base.resolve() in (file.resolve(), *above):
        raise BadInput(f'{file}: config', named, 'a file that is not based on this one')
    below = _content(base, file.resolve(), *above)
    rules, changes = (below['draw'] or {}) | fields['draw'], below['set'] + fields['set']
    return {'about': fields['about'], 'config': below['config'], 'set': changes, 'draw': rules}


def _lasting(values: Values, fixed: Collection[str]) -> Values:
    """Return values with time for four times the way to the goal, unless a limit is given."""
    most, speed = 'max_ticks', values['forward']
    if most in fixed or values[most] != settings.ROWS[most].default:
        return values
    away = math.dist(values['rope.center'], values['start.position'])
    way = away / speed if values['translation_order'] == 1 else 2.0 * math.sqrt(away / speed)
    enough = min(math.ceil(4.0 * way / _tick(values)), settings.ROWS[most].high)
    return {**values, most: max(values[most], int(enough))}


def _default_rules(values: Values) -> dict[str, Rule]:
    """Return the rules for a parameter file; among obstacles the goal stays in place.

    A vehicle that moves has its goal ahead: it might not be able to return.

    Raises:
        BadInput: the goal is nearer than a step.
    """
    flat, swing = values['dimension'] == 2, {axis: [0.0, 2.0 * math.pi] for axis in 'xyz'}
    rules: dict[str, Rule] = {'rope.phase': swing, 'seed': {'whole': LARGEST_DRAWN}}
    if not (values['obstacles'] or values['traffic']):
        start, goal = values['start.position'], values['rope.center']
        step, away = values['step'] * values['forward'], math.dist(goal, start)
        if values['translation_order'] == 1 and away < step:  # such as the default for a wing
            raise BadInput('rope.center', f'{away:g} m away', f'farther than a step, {step:g} m')
        if flat or values['glide_slope']:  # as high as it is, so that the vehicle is above it
            distance, start = math.dist(goal[:2], start[:2]), (*start[:2], goal[2])
            x, y, _ = values['start.velocity']
            ahead, aside = math.atan2(y, x), 0.5 * math.pi if x or y else math.pi
            around: Rule = {'towards': [ahead - aside, ahead + aside], 'length': 2 * [distance]}
        else:
            around = {'turned': away}
        rules['rope.center'] = {'from': start, **around}
    if not values['gravity']:
        rules['start.orientation'] = {'heading': [-math.pi, math.pi]} if flat else {'turned': 'any'}
    return rules


def _drawn(rule: Rule, rng: np.random.Generator) -> Any:
    """Return a value drawn by a rule.

    Raises:
        ValueError: the rule is unknown.
    """
    match rule:
        case [low, high]:
            return float(rng.uniform(low, high))
        case {'from': begin, **rest}:
            return tuple(np.add(begin, _drawn(rest, rng)).tolist())
        case {'whole': count}:
            return int(rng.integers(count))
        case {'towards': angles, 'length': lengths}:
            angle, length = rng.uniform(*angles), rng.uniform(*lengths)
            return length * math.cos(angle), length * math.sin(angle), 0.0
        case {'heading': angles}:
            half = 0.5 * rng.uniform(*angles)
            return 0.0, 0.0, math.sin(half), math.cos(half)
        case {'turned': length}:
            drawn = rng.normal(size=4 if length == 'any' else 3)
            unit = drawn / np.linalg.norm(drawn)
            return tuple((unit if length == 'any' else length * unit).tolist())
        case {'gates': places, 'radius': radii}:
            walls = zip(places, radii, strict=True)
            return tuple(number for x, radius in walls for number in _wall(rule, x, radius, rng))
        case {'bodies': count}:
            return tuple(number for _ in range(count) for number in _body(rule, rng))
        case dict() if rule and {*rule} <= {*'xyz'}:
            return tuple(float(rng.uniform(*rule.get(axis, (0.0, 0.0)))) for axis in 'xyz')
    raise ValueError(f'unknown rule {rule}')


def _wall(
    rule: Mapping[str, Any], x: float, radius: float, rng: np.random.Generator
) -> Iterator[float]:
    """Yield position, velocity and radius of the four discs of a wall."""
    middle, half = rng.uniform(*rule['middle']), 0.5 * rng.uniform(*rule['gap'])
    for side in (-1.0, 1.0):
        for away in (half + radius, half + 3.0 * radius):
            yield from (float(x), float(middle + side * away), 0.0, 0.0, radius)


def _body(rule: Mapping[str, Any], rng: np.random.Generator) -> list[float]:
    """Return position, velocity and radius of a disc that starts clear of the origin."""
    for _ in range(MOST_TRIES):
        x, y, _ = _drawn(rule['at'], rng)
        when, heading = rng.uniform(*rule['when']), rng.uniform(-math.pi, math.pi)
        speed, radius = rng.uniform(*rule['speed']), float(rng.uniform(*rule['radius']))
        u, v = speed * math.cos(heading), speed * math.sin(heading)
        begin = float(x - when * u), float(y - when * v)
        if math.hypot(*begin) > rule['clear'] + radius:
            return [*begin, float(u), float(v), radius]
    problem = f'no body starts {rule["clear"]} m clear of the origin'
    raise BadInput.stating('draw: traffic', problem, 'let them start farther away')


# --- the report


def report(draws: Draws, rows: Rows) -> str:
    """Return the report in Markdown: a table with a row for each controller."""
    table = [_row(draws, name, rows) for name in rows]
    cells = table[0], ['---'] * len(table[0]), *(each.values() for each in table)
    count = len(next(iter(rows.values())))
    title = f'# {draws.name}: {draws.about}\n\n{count} flights by each controller.\n\n'
    return title + ''.join(f'| {" | ".join(each)} |\n' for each in cells)


def times_of(draws: Draws, rows: Sequence[Row]) -> Array:
    """Return the times to the catch, or the limit for flights without one, shape (M,) [s]."""
    return np.array([row['time'] if row['caught'] else draws.limit for row in rows])


def _row(draws: Draws, name: str, rows: Rows) -> dict[str, str]:
    """Return a controller's cells by column."""
    from scipy.stats import binomtest  # takes a second to import

    flights, times = rows[name], times_of(draws, rows[name])
    ticks = max(1, sum(row['ticks'] for row in flights))
    caught = binomtest(sum(bool(row['caught']) for row in flights), len(flights))
    share = caught.proportion_ci(method='wilson')
    beside = ''
    if name != OURS and OURS in rows:
        apart = times_of(draws, rows[OURS]) - times
        beside = f'{np.mean(apart < 0.0):.0%} / {np.mean(apart > 0.0):.0%}'
    p50, longest = ([row[each] for row in flights] for each in ('p50_ms', 'longest_ms'))
    return {
        'controller': f'`{name}`',
        'caught (95 %)': f'{caught.statistic:.1%} ({share.low:.1%} to {share.high:.1%})',
        'touched': f'{np.mean([bool(row["touched"]) for row in flights]):.1%}',
        'failed': str(sum(bool(row['failed']) for row in flights)),
        'median [s]': f'{np.median(times):.2f}' if caught.statistic > 0.5 else 'never',
        'mean [s]': f'{times.mean():.2f}',
        f'{OURS} sooner / later': beside,
        'proved optimal': f'{sum(row["optimal"] for row in flights) / ticks:.1%}',
        'without a plan': f'{sum(row["unplanned"] for row in flights) / ticks:.1%}',
        'tick, p50 / longest [ms]': f'{np.median(p50):.1f} / {max(longest):.0f}',
    }


def draw(draws: Draws, rows: Rows, file: Path) -> None:
    """Plot the share caught over time as a PNG for print, and another for dark pages."""
    lines = {}
    for name, flights in rows.items():
        times = sorted(row['time'] for row in flights if row['caught'])
        shares = np.array([*range(len(times) + 1), len(times)]) / len(flights)
        lines[name] = np.array([0.0, *times, draws.limit]), shares
    for each in in_both_looks(file):
        figure = Figure(figsize=(5.0, 3.8), layout='constrained')
        draw_panel(figure.subplots(), Panel(f'{draws.name}: share caught', '', lines, steps=True))
        figure.savefig(each)
