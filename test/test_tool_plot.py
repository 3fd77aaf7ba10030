# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Pictures of flights: what they show, and what is written."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from bags import GOLDEN, made_up
from matplotlib.colors import to_rgb
from PIL import Image

from orbimpc_ros.tool import animation, demo, figures, history, plot, settings, style, summary
from orbimpc_ros.tool.settings import config

STILL = {'trajectory.png', 'data.png'}


@pytest.fixture(scope='module')
def caught():
    return replace(history.of_bag(GOLDEN / 'retrieval'), captured=True)


def flight(name, positions, *changes):
    """Return a flight of a scenario."""
    return made_up(positions, settings.resolve(config(f'{name}.yaml'), changes))


def line(end, count):
    return np.linspace([0.0, 0.0, 0.0], end, count)


def paths(flown):
    return figures.of_runs(flown)['trajectory.png']


def labels(figure):
    return {text.get_text() for legend in figure.legends for text in legend.get_texts()}


def charts(figure):
    return {axes.get_title(loc='left'): axes for axes in figure.axes}


# --- the command


@pytest.mark.parametrize('name', ['spacecraft', 'obstacles', 'lander'])
def test_every_scenario_is_drawn(tool, tmp_path, name):
    out = tmp_path / 'deep' / name
    code, printed, _ = tool('plot', GOLDEN / name, '-o', out, '--no-animation')
    assert code == 0
    assert {file.name for file in out.iterdir()} == STILL
    assert printed == f'written: trajectory.png, data.png in {out}\n'
    for file in out.iterdir():
        with Image.open(file) as image:
            assert min(image.size) >= 1000
            assert np.ptp(np.asarray(image.convert('L'))) > 200


def test_a_dark_retrieval_with_its_animation(tool, tmp_path):
    before = style.paper()
    assert tool('plot', GOLDEN / 'retrieval', '-o', tmp_path, '--dark')[0] == 0
    assert style.paper() == before != style.PAGE
    assert {file.name for file in tmp_path.iterdir()} == STILL | {plot.ANIMATION}
    dark = tuple(round(255 * part) for part in to_rgb(style.PAGE))
    for file in tmp_path.glob('*.png'):
        with Image.open(file) as image:
            assert image.convert('RGB').getpixel((0, 0)) == dark
    with Image.open(tmp_path / plot.ANIMATION) as image:
        assert image.n_frames > 50
        assert image.info['loop'] == 0
        shown = []
        for number in (0, image.n_frames // 2, image.n_frames - 1):
            image.seek(number)
            shown.append(np.asarray(image.convert('RGB'), dtype=int))
    for one, other in itertools.pairwise(shown):
        assert (np.abs(other - one).max(axis=2) > 50).sum() > 500
    for color in (style.DARK[1], style.DARK[3], style.DARK[4]):  # vehicle, goal, plan
        wanted = np.array([round(255 * part) for part in to_rgb(color)])
        assert (np.abs(shown[1] - wanted).max(axis=2) <= 6).sum() > 50, color


def first(flight, count):
    """Return the beginning of a flight."""
    parts = ('times', 'positions', 'attitudes', 'velocities', 'rates', 'ropes', 'plans', 'ticks')
    return replace(flight, **{part: getattr(flight, part)[:count] for part in parts})


def test_a_single_sighting_is_no_flight(tool, tmp_path, monkeypatch, caught):
    monkeypatch.setattr(history, 'of_bag', lambda *_: first(caught, 1))
    code, _, complaint = tool('plot', 'short', '-o', tmp_path / 'out')
    assert (code, complaint.count('\n')) == (2, 1)
    assert 'single odometry' in complaint


# --- paths


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('name', ['retrieval', 'spacecraft'])
def test_short_flights_and_those_without_plans_are_drawn(name, tmp_path):
    flown = replace(history.of_bag(GOLDEN / name), captured=False)
    for each in (first(flown, 2), replace(first(flown, 5), plans=(), ticks=(), forces=())):
        assert set(figures.of_runs({'': each})) == STILL
        animation.write_gif(each, tmp_path / 'short.gif')


@pytest.mark.parametrize('captured', [True, False])
@pytest.mark.parametrize('shape', ['none', 'polygon'])
def test_paths_have_equal_axes_units_and_a_legend(caught, captured, shape):
    values = caught.values | {'floor.shape': shape}
    figure = paths({'': replace(caught, captured=captured, values=values)})
    whole = figure.axes[0]
    assert whole.get_aspect() == 1.0
    assert whole.get_xlabel() == 'x [m]'
    shown = charts(figure)
    assert 'Distance to the goal [m]' in shown
    speed = shown['Share of full speed, |R e₁|']
    assert any('floor' in text.get_text() for text in speed.texts) == (shape != 'none')
    assert {'flown path', 'body x', 'near miss', 'start', "goal's way"} <= labels(figure)
    assert ('goal when caught' in labels(figure)) == captured


def test_space_is_drawn_to_scale():
    figure = paths({'': flight('retrieval3d', line([6.0, 3.0, 4.0], 9))})
    space = next(axes for axes in figure.axes if hasattr(axes, 'get_zlim'))
    limits = [np.ptp(getattr(space, f'get_{axis}lim')()) for axis in 'xyz']
    box = space.get_box_aspect()
    assert np.allclose(np.array(limits) / box, limits[0] / box[0])
    assert {'body x', 'body y', 'body z', 'goal when caught'} <= labels(figure)


def test_two_flights_are_told_apart_by_name_and_dashes():
    both = {
        name: flight('dubins', line([5.0, 10.0, 0.0], 21), f'floor.shape={name}')
        for name in ('none', 'polygon')
    }
    (figure,) = figures.of_runs(both).values()
    assert {'flown path, none', 'flown path, polygon', 'goal'} <= labels(figure)
    drawn = [each for each in figure.axes[0].get_lines() if 'flown' in each.get_label()]
    assert len({each.get_linestyle() for each in drawn}) == 2


def test_obstacles_are_where_the_parameters_say():
    flown = history.of_bag(GOLDEN / 'obstacles')
    patches = paths({'': flown}).axes[0].patches
    corners = [p.get_bbox().extents for p in patches]
    for box in np.reshape(flown.values['obstacles'], (-1, 4)):
        assert any(np.allclose(box, corner) for corner in corners)


def test_a_fleet_has_its_names_and_the_distance_of_the_closest_pair():
    values, own = demo.fleet(3, ['avoid_radius=1.0'])
    ways = ([[-3.0, 0, 0], [3.0, 0, 0]], [[0, -3.0, 0], [0, 3.2, 0]], [[9.0, 9, 0], [9.0, 8, 0]])
    flown = {
        name: replace(flight('fleet', np.linspace(*way, 31)), values=values | each)
        for (name, each), way in zip(own.items(), map(np.array, ways), strict=True)
    }
    figure = paths(flown)
    assert {name.strip('/') for name in own} <= {t.get_text() for t in figure.axes[0].texts}
    _, apart = charts(figure)['Closest pair [m]'].get_lines()[0].get_data()
    assert apart.min() == pytest.approx(0.0, abs=0.11)
    assert apart[0] == pytest.approx(np.sqrt(18.0))


def test_stories(caught):
    def story(flight):
        return summary.story({'': flight})

    assert story(caught).startswith('Captured: t = ')
    assert story(replace(caught, captured=False)) == 'Captured: no'
    arrived = replace(history.of_bag(GOLDEN / 'spacecraft'), captured=True)
    assert story(arrived).startswith('Arrived: yes, less than 1 mm from the goal at ')
    assert 'Arrived: no' in story(replace(arrived, captured=False))


# --- numbers over time


def panels(flight):
    return charts(figures.of_runs({'': flight})['data.png'])


def test_thrust_is_shown_as_it_was_applied():
    shown = panels(flight('spacecraft', line([5.0, 10.0, 25.0], 21)))
    assert {'Position [m]', 'Velocity [m/s]', 'Body rates [rad/s]', 'Thrust [N]'} <= set(shown)
    thrust = shown['Thrust [N]'].get_lines()[0]
    assert np.allclose(thrust.get_xdata(), np.arange(21))
    assert np.allclose(thrust.get_ydata(), [0.0, *[0.25] * 20])  # a step after its command


def test_tilt_is_shown_with_its_limit():
    shown = panels(history.of_bag(GOLDEN / 'lander'))['Tilt from the vertical [deg]']
    (limit,) = (each for each in shown.get_lines() if np.ptp(each.get_ydata()) == 0.0)
    assert limit.get_ydata()[0] == pytest.approx(15.0, abs=1e-3)


def test_ticks_without_a_plan_leave_holes_not_zeros(caught):
    holes = tuple(
        (time, fields | {'gap': float('nan'), 'fallback': 'safe command'} if k % 2 else fields)
        for k, (time, fields) in enumerate(caught.ticks)
    )
    flown = replace(caught, ticks=holes)
    times, gaps = flown.series('gap')
    assert len(times) == len(gaps) == (len(holes) + 1) // 2
    planned, fallen = panels(flown)['Time of each tick [ms]'].get_lines()[:2]
    assert len(planned.get_xdata()) == 2 * len(fallen.get_xdata())


def test_lines_in_one_chart_differ_without_colours():
    assert len({line for _, line in figures.LOOKS}) == len(figures.LOOKS)


def luminance(color):
    """Return the relative luminance of a colour (WCAG 2, sRGB)."""
    parts = np.array(to_rgb(color))
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize(
    ('colors', 'page', 'least'), [(style.PRINT, 'white', 2.0), (style.DARK, style.PAGE, 4.5)]
)
def test_colours_stand_out_from_the_page(colors, page, least):
    for color in colors[:-1]:  # the last is for what should not
        bright, dim = sorted((luminance(color), luminance(page)), reverse=True)
        assert (bright + 0.05) / (dim + 0.05) >= least


def test_frames_pass_every_sighting_and_end_with_the_capture(caught):
    seen = list(animation.instants(caught))
    places = np.array([instant['flown'][-1] for instant in seen])
    for place in caught.positions[:-1]:
        instant = seen[int(np.argmin(np.linalg.norm(places - place, axis=1)))]
        assert np.allclose(instant['vehicle'][0], place)
        assert np.linalg.norm(instant['plan'] - place, axis=1).min() < 1e-9
    assert np.allclose(seen[-1]['flown'][-1], caught.capture.vehicle)
    assert np.allclose(seen[-1]['goal'], caught.capture.rope)
