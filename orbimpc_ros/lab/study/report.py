# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The report of a study: a table for people, who won where, and the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from orbimpc_ros.lab.machine import machine, versions
from orbimpc_ros.lab.study.controllers import ORBITOPE
from orbimpc_ros.lab.study.design import Study
from orbimpc_ros.lab.study.score import Score, frequencies, scores, versus
from orbimpc_ros.lab.study.settings import SETTINGS, Span
from orbimpc_ros.lab.study.store import Store
from orbimpc_ros.lab.study.trial import CHEAPER

REPORT, PICTURE = 'report.md', 'study.png'
Table = Sequence[Sequence[str]]


def report(store: Store) -> bool:
    """Write report and picture into the study's folder, print the table.

    Returns:
        whether IPOPT found a plan that costs less than one of the planner's.
    """
    from orbimpc_ros.lab.study.picture import draw

    rows, study = store.result(), store.study
    found = scores(rows, study.controllers)
    draw(study, found, frequencies(rows, study.controllers[0]), store.folder / PICTURE)
    result = '\n'.join(_result(study, found))
    (store.folder / REPORT).write_text('\n'.join([result, *_circumstances(study)]) + '\n')
    print(result)
    for name, file in (('report', REPORT), ('picture', PICTURE), ('rows', 'runs.parquet')):
        print(f'{name:<9}{store.folder / file}')
    ours = found.get(ORBITOPE)
    return ours is not None and ours.excess > CHEAPER


def _result(study: Study, found: dict[str, Score]) -> Iterator[str]:
    draws = f'{study.runs} run{"s" if study.runs != 1 else ""}'
    yield f'# Study: {draws}, seed {study.seed}, forecast `{study.forecast}`\n'
    yield from _markdown(_table(found))
    yield ''
    if ORBITOPE in found:
        yield from _verdicts(found)


def _circumstances(study: Study) -> Iterator[str]:
    yield f'![Catches, times and costs]({PICTURE})\n'
    yield '## Settings\n'
    yield from _markdown([('setting', 'drawn from'), *_settings(study)])
    yield f'\nMeasured on {_where()}.'


def _table(found: dict[str, Score]) -> Table:
    head = ('', *(f'`{name}`' for name in found))
    each = found.values()
    return [
        head,
        ('caught', *(f'{score.rate:.1%}' for score in each)),
        ('ticks to the catch, median', *(_ticks(score.within(0.5)) for score in each)),
        ('ticks within which 90 % are caught', *(_ticks(score.within(0.9)) for score in each)),
        ('worst run: closest approach [m]', *(f'{score.closest.max():.2f}' for score in each)),
        ('turned per run, median [rad]', *(f'{np.median(score.turned):.1f}' for score in each)),
        ('tick, p50 / p99 [ms of processor time]', *(_quantiles(score.tick_ms) for score in each)),
        ('forecast, p50 / p99 [ms]', *(_quantiles(score.forecast_ms) for score in each)),
        ('ticks proved optimal', *(_certified(score) for score in each)),
        ('ticks without a plan', *(f'{score.fallbacks / score.flown:.2%}' for score in each)),
        ('projection loss, worst [m]', *(f'{score.loss:.0e}' for score in each)),
    ]


def _ticks(value: float) -> str:
    return f'{value:.0f}' if math.isfinite(value) else 'never'


def _quantiles(values: np.ndarray) -> str:
    half, most = np.quantile(values, [0.5, 0.99])
    return f'{half:.2f} / {most:.2f}'


def _certified(score: Score) -> str:
    return f'{score.certified:.1%}' if score.name == ORBITOPE else 'no proof'


def _markdown(table: Table) -> Iterator[str]:
    for place, row in enumerate(table):
        yield f'| {" | ".join(row)} |'
        if place == 0:
            yield '|' + ' --- |' * len(row)


def _verdicts(found: dict[str, Score]) -> Iterator[str]:
    """Say run by run who was sooner, and tick by tick who was cheaper."""
    ours = found[ORBITOPE]
    rivals = [score for name, score in found.items() if name != ORBITOPE]
    if rivals:
        yield '## Run by run, on the same ropes with the same forecasts\n'
        duels = (_versus(ours, rival) for rival in rivals)
        yield from _markdown([('', 'sooner', 'alike', 'later'), *duels])
        yield ''
    if ours.compared:
        yield _against_ipopt(ours) + '\n'


def _against_ipopt(ours: Score) -> str:
    if ours.excess > CHEAPER:
        return f'On a tick IPOPT found a plan that is cheaper by {ours.excess:.1e} (relative).'
    return (
        f'On {ours.compared} ticks IPOPT solved the same problem as the planner: none of its plans '
        f'was cheaper (by over {CHEAPER:g}), {ours.cheaper / ours.compared:.1%} cost more.'
    )


def _versus(ours: Score, theirs: Score) -> tuple[str, ...]:
    shares = (f'{share:.1%}' for share in versus(ours, theirs))
    return (f'`{ours.name}` than `{theirs.name}`', *shares)


def _settings(study: Study) -> Iterator[tuple[str, str]]:
    for setting in SETTINGS:
        value = study.settings[setting.name]
        shown = value if isinstance(value, str) else _span(value)
        yield f'`{setting.name}`', f'{shown} {setting.unit}'.rstrip()


def _span(value: Span) -> str:
    low, high = value
    return f'{low:.4g}' if low == high else f'[{low:.4g}, {high:.4g}]'


def _where() -> str:
    at, kept = machine(), versions()
    used = ('python', 'numpy', 'numba', 'clarabel', 'casadi')
    return (
        f'{at["cores"]} cores ({at["processor"] or "of unknown make"}), '
        f'load {at["load_1min"]:.1f}; '
        + ', '.join(f'{name} {kept[name] or "absent"}' for name in used)
    )
