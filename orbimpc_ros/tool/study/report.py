"""The report of a study: a table for people, who won where, and the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from orbimpc_ros.tool.measure.machine import machine, versions
from orbimpc_ros.tool.study.pilots import NONLINEAR, ORBITOPE
from orbimpc_ros.tool.study.plan import Study
from orbimpc_ros.tool.study.score import Score, frequencies, scores, versus
from orbimpc_ros.tool.study.settings import SETTINGS, Span
from orbimpc_ros.tool.study.store import Store
from orbimpc_ros.tool.study.trial import CHEAPER

REPORT, PICTURE = 'report.md', 'study.png'
Table = Sequence[Sequence[str]]


def report(store: Store) -> bool:
    """Write report and picture into the study's folder, print the table.

    Returns:
        whether IPOPT found a plan that costs less than one of the planner's.
    """
    from orbimpc_ros.tool.study.picture import draw

    rows, study = store.result(), store.study
    found = scores(rows, study.controllers)
    draw(study, found, frequencies(rows, study.controllers[0]), store.folder / PICTURE)
    text = '\n'.join(_lines(study, found))
    (store.folder / REPORT).write_text(text)
    print(text)
    for name, file in (('report', REPORT), ('picture', PICTURE), ('rows', 'runs.parquet')):
        print(f'{name:<9}{store.folder / file}')
    ours = found.get(ORBITOPE)
    return ours is not None and ours.excess > CHEAPER


def _lines(study: Study, found: dict[str, Score]) -> Iterator[str]:
    draws = f'{study.runs} run{"s" if study.runs != 1 else ""}'
    yield f'# Study: {draws}, seed {study.seed}, forecast `{study.forecast}`\n'
    yield from _markdown(_table(found))
    yield ''
    if ORBITOPE in found:
        yield from _verdicts(found)
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
        ('tick, p50 / p99 [ms]', *(_quantiles(score.tick_ms) for score in each)),
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
        yield from _markdown([('', 'sooner', 'alike', 'later'), *map(_versus(ours), rivals)])
        yield ''
    if NONLINEAR in found and ours.compared:
        yield (
            f'On {ours.compared} ticks IPOPT solved the very problem that the planner solved: '
            f'{ours.cheaper / ours.compared:.1%} of its plans cost more, and the planner never '
            f'cost more than {max(0.0, ours.excess):.0e} (relative) above it.\n'
            if ours.excess <= CHEAPER
            else f'On a tick IPOPT found a plan that is cheaper by {ours.excess:.1e} (relative).\n'
        )


def _versus(ours: Score):
    def row(theirs: Score) -> tuple[str, ...]:
        shares = (f'{share:.1%}' for share in versus(ours, theirs))
        return (f'`{ours.name}` than `{theirs.name}`', *shares)

    return row


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
