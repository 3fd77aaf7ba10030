# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Pictures of demos: what they show, from runs made up for the purpose."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from benchmarks.bench.duel import OURS
from benchmarks.bench.picture import side_by_side
from benchmarks.bench.rows import LATE, BenchRow
from orbimpc_ros.tool import figures, settings
from orbimpc_ros.tool.demo.arrivals import column, planned_at_start, table, title
from orbimpc_ros.tool.demo.fleet import resolve
from orbimpc_ros.tool.figures.dubins import determinant
from orbimpc_ros.tool.figures.fleet import fleet
from orbimpc_ros.tool.figures.snapshots import PANELS, chosen_ticks
from orbimpc_ros.tool.history import History, Planned
from orbimpc_ros.tool.settings import config

TIMES = '\N{MULTIPLICATION SIGN}'


def run(name, positions, *changes, captured=True, forces=()):
    """Return a run of a scenario along positions, shape (M, 3), its nose along the way."""
    values = settings.resolve(config(f'{name}.yaml'), changes)
    count, times = len(positions), 5.0 + np.arange(len(positions))
    steps = np.diff(positions, axis=0, append=2 * positions[-1:] - positions[-2:-1])
    ropes = np.tile(values['rope.center'], (count, 1))
    return History(
        times=times,
        positions=positions,
        attitudes=np.tile(np.eye(3), (count, 1, 1)),
        velocities=steps,
        rates=np.zeros((count, 3)),
        ropes=ropes,
        plans=tuple(Planned(t, positions[k : k + 3]) for k, t in enumerate(times)),
        forces=forces,
        ticks=tuple((t, {'speed_fraction': [1.0, 0.6]}) for t in times),
        captured=captured,
        values=values,
    )


def line(end, count):
    return np.linspace([0.0, 0.0, 0.0], end, count)


def circling(count):
    """Return a way to the rope at (5, 0) and around it, passing at 0.3 m every fourth step."""
    angles = 0.5 * np.pi * np.arange(count)
    radius = np.where(np.arange(count) % 4 == 0, 0.3, 0.9)
    around = np.column_stack([5 + radius * np.cos(angles), radius * np.sin(angles), 0 * angles])
    return np.concatenate([line([4.0, 0.0, 0.0], 5), around])


def labels(figure):
    return {text.get_text() for legend in figure.legends for text in legend.get_texts()}


@pytest.mark.parametrize('count', [2, 5, 40])
def test_nine_moments_are_the_near_misses_and_the_end(count):
    flown = run('retrieval', circling(count))
    chosen = chosen_ticks(flown)
    last = len(flown.times) - 2
    assert chosen == sorted(set(chosen))
    assert chosen[-1] == last
    assert len(chosen) == min(PANELS, last + 1)
    misses = {int(np.ceil(m.time - flown.times[0])) - 1 for m in flown.near_misses}
    assert len(misses & set(chosen)) == min(len(misses), PANELS - 1)


def test_moments_show_vehicle_plan_and_rope_to_scale():
    figure = figures.of_runs({'': run('retrieval', circling(12))})['moments.png']
    assert len(figure.axes) == 9
    assert {axes.get_aspect() for axes in figure.axes} == {1.0}
    assert {'vehicle', 'plan', 'rope', 'near miss', 'caught'} <= labels(figure)
    assert 'caught' in figure.axes[-1].get_title(loc='left')


def test_the_determinant_of_the_dubins_car_is_its_speed_squared():
    flown = run('dubins', line([5.0, 10.0, 0.0], 21))
    assert np.allclose(determinant(flown), (125 / 400) * np.ones(21))
    assert np.allclose(determinant(replace(flown, values=flown.values | {'forward': 0.5})), 1.25)


def test_the_dubins_figure_compares_with_and_without_minimum_speed():
    both = {
        'none': run('dubins', line([5.0, 10.0, 0.0], 21), 'floor.shape=none'),
        'polygon': run('dubins', line([5.0, 10.0, 0.0], 21)),
    }
    (figure,) = figures.of_runs(both).values()
    paths, determinants = figure.axes
    assert paths.get_aspect() == 1.0
    assert paths.get_xlabel() == 'x [m]'
    assert determinants.get_xlabel() == 'time [s]'
    assert labels(figure) == {'no minimum speed', 'det R ≥ 0.5 by a square', 'goal at t = 20 s'}


def test_the_spacecraft_figures_show_thrust_as_it_was_applied():
    times = 5.0 + np.arange(21)
    forces = tuple((t, 0.25) for t in times)
    flown = run('spacecraft', line([5.0, 10.0, 25.0], 21), forces=forces)
    drawn = figures.of_runs({'': flown})
    assert set(drawn) == {'trajectory.png', 'data.png'}
    thrust = drawn['data.png'].axes[3].get_lines()[0]
    assert np.allclose(thrust.get_xdata(), np.arange(21))
    assert np.allclose(thrust.get_ydata(), [0.0, *[0.25] * 20])  # a step after its command
    units = [axes.get_ylabel() for axes in drawn['data.png'].axes]
    assert units == ['position [m]', 'velocity [m/s]', 'rate [rad/s]', 'thrust [N]']
    assert {'flown path', 'body x', 'body y', 'body z', 'goal'} <= labels(drawn['trajectory.png'])


def test_the_retrieval_in_space_is_drawn_to_scale():
    flown = run('retrieval3d', line([6.0, 3.0, 4.0], 9))
    (figure,) = figures.of_runs({'': flown}).values()
    space = figure.axes[0]
    limits = [np.ptp(getattr(space, f'get_{axis}lim')()) for axis in 'xyz']
    box = space.get_box_aspect()
    assert np.allclose(np.array(limits) / box, limits[0] / box[0])
    assert 'on the first pass' in figure.get_suptitle()


def test_errors_at_arrival_are_told_for_every_way_of_flying():
    flown = run('dubins', line([5.0, 10.0, 0.0], 21), 'floor.shape=none')
    told = column(flown.values, flown)
    assert list(told) == [
        'relaxed plan', 'open loop, nearest', 'open loop, thrust_aligned', 'closed loop',
    ]  # fmt: skip
    assert told['closed loop'] == '0.0e+00 m'
    unflown = {k: v for k, v in told.items() if k != 'closed loop'}
    text = table({title(flown.values): told, 'circle': unflown}).splitlines()
    assert len({len(line.split('   ')) > 1 for line in text}) == 1
    assert text[-1].endswith('-')
    assert planned_at_start(flown.values).horizon == 20


def cut(figure):
    """Return the texts in a picture's panels that are not wholly inside."""
    FigureCanvasAgg(figure).draw()
    return [
        text.get_text()
        for axes in figure.axes
        for text in axes.texts
        if not all(axes.bbox.contains(*at) for at in text.get_window_extent().corners())
    ]


@pytest.mark.parametrize('count', [2, 4, 8])
def test_every_vehicle_of_a_fleet_has_its_name_in_the_picture(count):
    values, own = resolve(count, [])
    flown = {}
    for name, each in own.items():
        caught = 0.85 * np.array(each['rope.center'])  # on the near side of the swing
        way, ropes = np.linspace(each['start.position'], caught, 30), np.tile(caught, (30, 1))
        flown[name] = replace(run('fleet', way), values=values | each, ropes=ropes)
    figure = fleet(flown)
    names = {text.get_text() for text in figure.axes[0].texts}
    assert {name.strip('/') for name in own} <= names
    assert not cut(figure)


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
    assert len(labels(figure)) == 2
    assert not cut(figure)
