# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Pictures of bags: what is written, what is never replaced, and what can be told apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from orbimpc_ros.tool import cli, figures, history, plot, style
from orbimpc_ros.tool.figures import animation, scene, space
from orbimpc_ros.tool.figures.charts import story
from orbimpc_ros.tool.figures.numbers import COMPONENTS, series
from orbimpc_ros.tool.topics import absent

GOLDEN = Path(__file__).parent / 'golden'
STILL = {'trajectory.png', 'data.png', 'solver.png'}
OF_RETRIEVALS = STILL | {'moments.png'}


@pytest.fixture(scope='module')
def caught():
    return replace(history.of_bag(GOLDEN / 'retrieval'), captured=True)


def run(capsys, *words):
    """Return the exit code and the lines on stdout and stderr."""
    code = cli.main(['plot', *map(str, words)])
    told = capsys.readouterr()
    return code, told.out.splitlines(), told.err.splitlines()


@pytest.mark.parametrize(
    ('name', 'expected'),
    [('dubins', STILL), ('spacecraft', STILL), ('obstacles', OF_RETRIEVALS)],
)
def test_every_scenario_is_drawn(capsys, tmp_path, name, expected):
    out = tmp_path / 'deep' / name
    code, told, _ = run(capsys, GOLDEN / name, '-o', out, '--no-animation')
    assert code == 0
    assert {file.name for file in out.iterdir()} == expected
    assert len(told) == 1
    assert all(file in told[0] for file in expected)
    assert str(out) in told[0]
    for file in out.iterdir():
        with Image.open(file) as image:
            assert min(image.size) >= 1000
            assert np.ptp(np.asarray(image.convert('L'))) > 200


def test_a_dark_retrieval_with_its_animation(capsys, tmp_path):
    code, _, _ = run(capsys, GOLDEN / 'retrieval', '-o', tmp_path, '--dark')
    assert code == 0
    assert {file.name for file in tmp_path.iterdir()} == OF_RETRIEVALS | {plot.ANIMATION}
    dark = tuple(round(255 * part) for part in to_rgb(style.PAGE))
    for file in tmp_path.glob('*.png'):
        with Image.open(file) as image:
            assert image.convert('RGB').getpixel((0, 0)) == dark
    with Image.open(tmp_path / plot.ANIMATION) as image:
        assert image.n_frames > 50
        assert image.info['loop'] == 0
        assert image.info['duration'] == plot.FRAME
        frames = []
        for number in (0, image.n_frames // 2, image.n_frames - 1):
            image.seek(number)
            frames.append(np.asarray(image.convert('L'), dtype=int))
        image.seek(image.n_frames // 2)
        shown = np.asarray(image.convert('RGB'), dtype=int)
    assert (np.abs(frames[1] - frames[0]) > 50).sum() > 500
    assert (np.abs(frames[2] - frames[1]) > 50).sum() > 500
    for color in (style.DARK[1], style.DARK[3], style.DARK[4]):  # vehicle, rope, plan
        apart = np.abs(shown - np.array([round(255 * part) for part in to_rgb(color)])).max(axis=2)
        assert (apart <= 6).sum() > 50, color


def test_only_what_was_made_here_is_replaced(capsys, tmp_path, monkeypatch):
    small = {'trajectory.png': Figure((1, 1)), 'solver.png': Figure((1, 1))}
    monkeypatch.setattr(figures, 'of_flight', lambda *_: small)
    words = (GOLDEN / 'dubins', '-o', tmp_path, '--no-animation')
    ours, foreign = tmp_path / 'trajectory.png', tmp_path / 'solver.png'
    assert run(capsys, *words)[0] == 0
    before = ours.read_bytes()
    assert run(capsys, *words)[0] == 0
    foreign.unlink()
    Image.new('RGB', (4, 4)).save(foreign)
    kept = foreign.read_bytes()
    ours.unlink()
    code, told, complaint = run(capsys, *words)
    assert (code, told, len(complaint)) == (2, [], 1)
    assert 'solver.png' in complaint[0]
    assert foreign.read_bytes() == kept
    assert not ours.exists()  # nothing is written unless everything can be
    assert before[:4] == b'\x89PNG'
    assert not list(tmp_path.glob('.*'))


def test_what_is_no_picture_was_not_made_here(tmp_path):
    (tmp_path / 'note.png').write_text('orbimpc')
    assert not plot.made_here(tmp_path / 'note.png')


@pytest.mark.parametrize(
    ('bag', 'out', 'culprit'),
    [
        ('nowhere', 'out', 'nowhere'),
        (str(GOLDEN / 'dubins'), 'file', '--out'),
        (str(GOLDEN / 'dubins'), 'file/below', '--out'),
    ],
)
def test_bad_words_are_refused_in_one_line(capsys, tmp_path, bag, out, culprit):
    (tmp_path / 'file').write_text('mine')
    code, _, complaint = run(capsys, bag, '-o', tmp_path / out, '--no-animation')
    assert (code, len(complaint)) == (2, 1)
    assert culprit in complaint[0]
    assert [file.name for file in tmp_path.iterdir()] == ['file']


def test_the_vehicles_of_a_bag_are_named():
    complaint = str(absent(Path('bag'), '/odom', ['/uav1/odom', '/uav2/odom', '/uav2/goal']))
    assert 'without /odom' in complaint
    assert '--namespace /uav1 or /uav2' in complaint
    assert 'namespace' not in str(absent(Path('bag'), '/goal', ['/odom', '/tick']))


def test_another_vehicle_is_not_drawn(capsys, tmp_path):
    words = (GOLDEN / 'dubins', '-o', tmp_path / 'out', '--namespace', '/uav7')
    code, _, complaint = run(capsys, *words)
    assert (code, len(complaint)) == (2, 1)
    assert 'without /uav7/odom' in complaint[0]
    assert not (tmp_path / 'out').exists()


def first(run, count):
    """Return the beginning of a run."""
    parts = ('times', 'positions', 'attitudes', 'velocities', 'rates', 'ropes', 'plans', 'ticks')
    return replace(run, **{part: getattr(run, part)[:count] for part in parts})


def test_a_single_sighting_is_no_flight(capsys, tmp_path, monkeypatch, caught):
    monkeypatch.setattr(history, 'of_bag', lambda *_: first(caught, 1))
    code, _, complaint = run(capsys, 'short', '-o', tmp_path / 'out')
    assert (code, len(complaint)) == (2, 1)
    assert 'single odometry' in complaint[0]
    assert not (tmp_path / 'out').exists()


def test_frames_leave_no_look_behind(caught):
    before = style.paper()
    for _ in zip(range(3), animation.animation(caught, dark=True), strict=False):
        assert style.paper() == before != style.PAGE


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('name', ['retrieval', 'spacecraft'])
def test_short_flights_and_those_without_plans_are_drawn(name):
    flown = replace(history.of_bag(GOLDEN / name), captured=False)
    for each in (first(flown, 2), replace(flown, plans=(), ticks=(), forces=())):
        assert set(figures.of_flight(each)) >= STILL
        assert next(animation.animation(each)).shape[2] == 3


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


def test_lines_in_one_chart_differ_without_colours():
    assert len({line for _, _, line in COMPONENTS}) == 3
    assert len({line for _, _, line in space.AXES}) == 3


def test_colours_are_the_looks(caught):
    for dark, colors in ((False, style.PRINT), (True, style.DARK)):
        with figures.look(dark):
            (line, *_) = figures.solver(caught).axes[0].get_lines()
            assert to_rgb(line.get_color()) == to_rgb(colors[0])


def test_frames_pass_every_sighting_and_end_with_the_capture(caught):
    seen = list(animation.instants(caught))
    times = np.array([instant.time for instant in seen])
    assert np.all(np.diff(times) > 0)
    assert times[-1] == pytest.approx(caught.end - caught.times[0])
    for time, place in zip(caught.times[:-1] - caught.times[0], caught.positions, strict=False):
        instant = seen[int(np.argmin(np.abs(times - time)))]
        assert instant.time == pytest.approx(time)
        assert np.allclose(instant.way[-1], place)
    assert np.allclose(seen[-1].way[-1], caught.capture.vehicle)
    assert np.allclose(seen[-1].rope, caught.capture.rope)
    apart = np.linalg.norm(seen[-1].way[-1] - seen[-1].rope)
    assert apart <= caught.capture_radius


def test_the_plan_in_a_frame_starts_where_the_vehicle_was(caught):
    for instant in animation.instants(caught):
        assert np.linalg.norm(instant.plan - instant.way[-2], axis=1).min() < 1e-9


def test_a_swing_that_is_not_the_parameters_is_the_sightings(caught):
    assert len(scene.swing(caught)) > len(caught.times)
    elsewhere = replace(caught, ropes=caught.ropes + 1.0)
    assert np.array_equal(scene.swing(elsewhere), elsewhere.ropes)


def test_obstacles_are_where_the_parameters_say():
    run = history.of_bag(GOLDEN / 'obstacles')
    flat = np.reshape(run.values['obstacles'], (-1, 4))
    drawn = figures.of_runs({'': run})['trajectory.png'].axes[0].patches
    corners = [(*p.get_xy(), p.get_x() + p.get_width(), p.get_y() + p.get_height()) for p in drawn]
    for box in flat:
        assert any(np.allclose(box, corner) for corner in corners)


def test_stories(caught):
    assert story(caught).startswith('Rope caught at t = ')
    assert 'not caught' in story(replace(caught, captured=False))
    arrived = replace(history.of_bag(GOLDEN / 'spacecraft'), captured=True)
    assert story(arrived).startswith('Spacecraft arrives: ')
    assert 'm/s' in story(arrived)
    assert 'does not arrive' in story(replace(arrived, captured=False))


def test_ticks_without_a_plan_leave_holes_not_zeros(caught):
    holes = tuple(
        (time, fields | {'gap': float('nan'), 'fallback': 'safe command'} if k % 2 else fields)
        for k, (time, fields) in enumerate(caught.ticks)
    )
    run = replace(caught, ticks=holes)
    times, gaps = series(run, 'gap')
    assert len(times) == len(gaps) == (len(holes) + 1) // 2
    labels = figures.solver(run).axes[2].get_legend().get_texts()
    assert [text.get_text() for text in labels] == ['fell back']
