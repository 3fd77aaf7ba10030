# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The picture of the bench: whose times are whose."""

from matplotlib.backends.backend_agg import FigureCanvasAgg

from benchmarks.bench.interleaved import OURS
from benchmarks.bench.picture import side_by_side
from benchmarks.bench.results import LATE, BenchRow

TIMES = '\N{MULTIPLICATION SIGN}'


def test_times_side_by_side_say_whose_they_are_and_where_they_were_cut_off():
    rows = [
        BenchRow('hull', OURS, 9, p50_ms=0.1, p99_ms=0.2, ratio_p50=1.0),
        BenchRow('hull', 'SCIP', 9, p50_ms=6e4, p99_ms=6e4, ratio_p50=720.0, capped=9),
        BenchRow('hull', 'Gurobi', 9, p50_ms=10.0, p99_ms=20.0, ratio_p50=100.0),
        BenchRow(f'planners: {LATE}', OURS, 9, p50_ms=4.0, p99_ms=9.0, objective=0.0),
    ]
    figure = side_by_side(rows)
    axes = figure.axes[0]
    assert {text.get_text() for text in axes.texts} == {f'> 720 {TIMES}', f'100 {TIMES}'}
    names = [text.get_text() for text in axes.get_yticklabels()]
    assert names == [f'planners: {OURS}', 'hull: Gurobi', 'hull: SCIP', f'hull: {OURS}']
    assert sum(len(legend.get_texts()) for legend in figure.legends) == 2
    FigureCanvasAgg(figure).draw()
    for text in axes.texts:
        assert all(axes.bbox.contains(*at) for at in text.get_window_extent().corners())
