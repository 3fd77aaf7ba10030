# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc study``: fly many random tasks of one vehicle, and report how they end.

The report is a table, and the share caught over time as a picture.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from orbimpc_ros import __version__
from orbimpc_ros.mpc.arrays import Array, whole
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.draws import Draws, draws_of
from orbimpc_ros.tool.figures import Panel, draw_panel, in_both_looks
from orbimpc_ros.tool.files import folder_at, new_folder
from orbimpc_ros.tool.flights import OURS, Job, Row, baselines, each_flown, key_of, rows_of, workers
from orbimpc_ros.tool.run.processes import interruptions
from orbimpc_ros.tool.run.progress import ProgressLine

MOST_RUNS, LARGEST_SEED, MOST_WORKERS = 1_000_000, 2**63 - 1, 1024
OUT, FLIGHTS, REPORT, PICTURE = 'out', 'flights.jsonl', 'report.md', 'caught.png'
Rows = Mapping[str, Sequence[Row]]  # by controller, flights in the same order
MOST_NAMED = 20
COLUMNS = (
    'controller',
    'caught (95 %)',
    'touched',
    'median [s]',
    'mean [s]',
    f'{OURS} sooner / later',
    'proved optimal',
    'without a plan',
    'tick, p50 / longest [ms]',
)


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
    """Fly what is still to be flown, then report.

    Raises:
        KeyboardInterrupt: somebody asked to stop; the results so far are kept.
    """
    whole(runs, '--runs', 1, MOST_RUNS)
    whole(seed, '--seed', 0, LARGEST_SEED)
    if workers is not None:
        whole(workers, '--workers', 1, MOST_WORKERS)
        if cluster is not None:
            raise BadInput('--workers', workers, 'only without --cluster, which has its own')
    if resume and out is None:
        raise BadInput('--resume', 'without -o DIR', 'the folder of the study to go on with')
    draws, names = draws_of(file, changes), _controllers(controllers)
    about = {
        'version': __version__,
        'seed': seed,
        'values': draws.values,
        'rules': draws.rules,
        'margin': draws.margin,
        'tuned': _tuned(names, draws.name),
    }
    folder = _folder(out, draws.name)
    flown = rows_of(folder / FLIGHTS, about, resumed=resume)
    jobs = [
        Job(draws.name, name, index, draws.of(seed, index), draws.margin)
        for index in range(runs)
        for name in names
        if (name, index) not in flown
    ]
    if jobs:
        _fly(flown, jobs, folder / FLIGHTS, runs * len(names), cluster, workers)
    rows = {name: [flown[name, k] for k in range(runs)] for name in names}
    text = report(draws, rows)
    (folder / REPORT).write_text(text)
    draw(draws, rows, folder / PICTURE)
    print(text, end='')
    return 0


def _folder(out: str | None, name: str) -> Path:
    if out is None:
        return new_folder(OUT, name)
    folder = folder_at(Path(out).resolve())
    if any(folder.iterdir()) and not (folder / FLIGHTS).exists():
        raise BadInput(str(folder), 'a folder with other files', 'a new or an empty folder')
    return folder


def _controllers(given: str) -> list[str]:
    names = given.split(',')
    known = [OURS] if names == [OURS] else [OURS, *baselines().BASELINES]
    if not {*names} <= {*known} or len({*names}) < len(names):
        raise BadInput('--controllers', given, f'each of {",".join(known)} at most once')
    return names


def _tuned(names: Sequence[str], study: str) -> dict[str, dict[str, float]]:
    """Return what baselines were tuned to for a study."""
    return {name: baselines().tuned_of(study).get(name, {}) for name in names if name != OURS}


def _fly(
    flown: dict[tuple[str, int], Row],
    jobs: Sequence[Job],
    file: Path,
    total: int,
    cluster: str | None,
    count: int | None,
) -> None:
    """Fly the flights that are lacking of a total; each is kept as soon as it is over."""
    done, progress = total - len(jobs), ProgressLine(total)
    with (
        interruptions() as received,
        workers(cluster, count) as pool,
        file.open('a', buffering=1) as out,
    ):
        progress.show(done, f'{done} of {total} flights')
        for row in each_flown(pool, jobs, lambda: not received):
            flown[key_of(row)] = row
            out.write(json.dumps(row) + '\n')
            done += 1
            progress.show(done, f'{done} of {total} flights')
    progress.close()
    if done < total:
        print(f'kept {done} of {total} flights in {file.parent}; --resume goes on with them')
        raise KeyboardInterrupt


# --- the report


def report(draws: Draws, rows: Rows) -> str:
    """Return the report in Markdown: a row for each controller, and which flights it missed."""
    count = len(next(iter(rows.values())))
    lines = [f'# {draws.name}: {draws.about}', '', f'{count} flights by each controller.', '']
    lines += [_cells(*COLUMNS), '|' + ' --- |' * len(COLUMNS)]
    lines += [_row(draws, name, rows) for name in rows]
    return '\n'.join([*lines, '', *_missed(rows)]) + '\n'


def times_of(draws: Draws, rows: Sequence[Row]) -> Array:
    """Return the times to the catch, the limit of a flight without one, shape (M,) [s]."""
    return np.array([row['time'] if row['caught'] else draws.limit for row in rows])


def _row(draws: Draws, name: str, rows: Rows) -> str:
    flights, times = rows[name], times_of(draws, rows[name])
    ticks = max(1, sum(row['ticks'] for row in flights))
    caught = stats.binomtest(sum(bool(row['caught']) for row in flights), len(flights))
    share = caught.proportion_ci(method='wilson')
    return _cells(
        f'`{name}`',
        f'{caught.statistic:.1%} ({share.low:.1%} to {share.high:.1%})',
        f'{np.mean([bool(row["touched"]) for row in flights]):.1%}',
        f'{np.median(times):.2f}' if caught.statistic > 0.5 else 'never',
        f'{times.mean():.2f}',
        _beside_ours(draws, name, rows),
        f'{sum(row["optimal"] for row in flights) / ticks:.1%}',
        f'{sum(row["unplanned"] for row in flights) / ticks:.1%}',
        f'{np.median([row["p50_ms"] for row in flights]):.1f} / '
        f'{max(row["longest_ms"] for row in flights):.0f}',
    )


def _beside_ours(draws: Draws, name: str, rows: Rows) -> str:
    """Compare flight by flight; one without a catch lasts as long as a flight may."""
    if name == OURS or OURS not in rows:
        return ''
    apart = times_of(draws, rows[OURS]) - times_of(draws, rows[name])
    return f'{np.mean(apart < 0.0):.0%} / {np.mean(apart > 0.0):.0%}'


def _missed(rows: Rows) -> Iterator[str]:
    """Name every flight without a catch by its number, and how it missed."""
    for name, flights in rows.items():
        lost = [f'{row["index"]} ({_how(row)})' for row in flights if not row['caught']]
        named = [*lost[:MOST_NAMED], *(['...'] if lost[MOST_NAMED:] else [])]
        yield f'- `{name}` missed {len(lost)}{": " if lost else ""}{", ".join(named)}.'


def _how(row: Row) -> str:
    if row['failed'] or row['touched']:
        return str(row['failed']) or 'collision'
    if 'missed' in row:
        return f'{row["missed"]:.3g} m at {row["speed"]:.2g} m/s'
    return f'{row["closest"]:.3g} m'


def _cells(*cells: str) -> str:
    return f'| {" | ".join(cells)} |'


def draw(draws: Draws, rows: Rows, file: Path) -> None:
    """Draw the share caught over time; write a PNG, and one for dark pages beside it."""
    lines = {}
    for name, flights in rows.items():
        times = sorted(row['time'] for row in flights if row['caught'])
        shares = np.array([*range(len(times) + 1), len(times)]) / len(flights)
        lines[name] = np.array([0.0, *times, draws.limit]), shares

    def drawn(_dark: bool) -> Figure:
        figure = Figure(figsize=(5.0, 3.8), layout='constrained')
        draw_panel(figure.subplots(), Panel(f'{draws.name}: share caught', '', lines, steps=True))
        return figure

    in_both_looks(drawn, file)
