# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From a run to its near misses, its summary and its pictures."""

import itertools
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from bags import GOLDEN, changed, made_up, rewritten, write
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from matplotlib.colors import to_rgb
from nav_msgs.msg import Odometry
from PIL import Image

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import bags, files, history, plot, settings
from orbimpc_ros.tool.history import of_bag
from orbimpc_ros.tool.settings import config


def at_distances(distances, captured, aside=0.0, **changes):
    """Return a run whose vehicle is at given distances from a still rope, tick by tick."""
    positions = np.zeros((len(distances), 3))
    positions[:, 0], positions[:, 1] = distances, aside
    own = {'capture_radius': 0.1, 'rope.center': (0.0, 0.0, 0.0)}
    fields = {'solve_time_ms': 2.0, 'gap': 1e-6, 'fallback': '', 'speed_fraction': [1.0, 0.6, 0.6]}
    ticks = tuple((10.0 + k, fields) for k in range(len(distances)))
    values = settings.read({}) | own | changes
    return made_up(positions, values, ticks=ticks, captured=captured)


def test_passing_by_is_closest_on_the_way():
    passing = at_distances([1.0, -1.0], captured=True, aside=0.05)
    times, distances, *_ = passing.at(passing.steps)
    assert times[-1] == passing.times[-1] == pytest.approx(10.5)
    assert distances[-1] == pytest.approx(0.05)
    np.testing.assert_allclose(passing.positions[-1], [0.0, 0.05, 0.0])
    assert not at_distances([1.0, 0.5], captured=False).caught
    assert not at_distances([1.0], captured=True).caught


def test_near_misses_are_local_minima_that_came_near():
    run = at_distances([3.0, 0.15, 0.9, 0.18, 0.6, 2.0, 0.5, 2.0, 0.05], captured=True)
    times, distances, *_ = run.at(run.near_misses)
    assert distances == pytest.approx([0.15, 0.18])
    assert times == pytest.approx([11.0, 13.0])
    assert run.times[-1] == pytest.approx(18.0)
    # An engine may detect contact slightly farther from the centre than the radius.
    aside = [0.0, 0.0, 0.0, 0.13]
    touched = at_distances([3.0, 0.15, 0.9, 0.12], captured=True, aside=aside)
    assert touched.at(touched.near_misses)[0] == pytest.approx([11.0])


def test_summary_tells_the_story():
    text = history.text({'': at_distances([3.0, 0.15, 0.9, 0.05], captured=True)})
    assert 'captured at t = 3.00 s, 0.05 m from the goal' in text
    assert '1 near misses: 0.15 m at 1.0 s' in ' '.join(text.split())
    assert 'p50 2.0 ms, p99 2.0 ms, max 2.0 ms' in text
    assert '1.0e-06' in text
    without = history.text({'': replace(at_distances([1.0, 2.0], captured=False), ticks=())})
    assert 'not captured by t = 1.00 s, 2 m from the goal' in without
    assert without.count('unknown') == 2


def test_a_goal_set_by_hand_holds_until_the_next(tmp_path):
    undated = changed('/goal', PoseStamped, lambda m: setattr(m.header, 'stamp', Time()))

    def change(each):
        second = each.stamp // 10**9
        if each.topic != '/goal' or second in (0, 10):
            return undated(each)
        return None

    goals = of_bag(rewritten(GOLDEN / 'retrieval', tmp_path / 'bag', change)).ropes
    moved = np.flatnonzero(np.diff(goals, axis=0).any(axis=1))
    assert len(moved) == 1
    assert moved[0] in (8, 9)  # dated by the last odometry before it


def test_settings_are_defaults_then_file_then_changes(tmp_path):
    text = '/**: {ros__parameters: {floor: {shape: polygon, faces: 6}, step: 0.5}}'
    (tmp_path / 'parameters.yaml').write_text(text)
    changes = ['step=2', 'rope.center=[1, 2.5, 0]', 'terminal=constraint']
    values = settings.resolve(tmp_path / 'parameters.yaml', changes)
    assert (values['floor.shape'], values['floor.faces']) == ('polygon', 6)
    assert values['step'] == 2.0
    assert isinstance(values['step'], float)
    assert values['rope.center'] == (1.0, 2.5, 0.0)
    assert values['terminal'] == 'constraint'
    assert values['horizon'] == settings.ROWS['horizon'].default


OWN = """
/**: {ros__parameters: {step: 0.5, forward: 15.0, wind: [1.0, 0.0, 0.0]}}
/**/planner: {ros__parameters: {horizon: 7}}
/**/sim: {ros__parameters: {forward: 14.0, step: 0.5, wind: [3.0, 0.0, 0.0], max_ticks: 9}}
"""


def test_a_goal_is_caught_within_the_simulators_radius():
    assert at_distances([1.0], True, capture_radius=0.3).radius == 0.3
    own = {'capture_radius': 5.0, 'sim.capture_radius': 0.1}
    assert at_distances([1.0], True, **own).radius == 0.1


def test_a_simulator_may_have_values_of_its_own():
    """From a file or as changes, and after a round trip through a file."""
    values = settings.read(files.parse(OWN, 'own'))
    own = {name for name in values if name.startswith('sim.')}
    assert own == {'sim.forward', 'sim.step', 'sim.wind'}
    assert (values['forward'], values['step'], values['max_ticks']) == (15.0, 0.5, 9)
    told = settings.of_sim(values)
    assert (told['forward'], told['wind'], told['horizon']) == (14.0, (3.0, 0.0, 0.0), 7)
    assert not any(name.startswith('sim.') for name in told)
    assert settings.read(files.parse(settings.text(values), 'own')) == values
    for_both = settings.changed(values, ['wind=[2.0, 0.0, 0.0]'])
    assert settings.of_sim(for_both)['wind'] == for_both['wind'] == (2.0, 0.0, 0.0)
    each = ['wind=[1.0, 0.0, 0.0]', 'sim.wind=[3.0, 0.0, 0.0]']
    for changes in (each, each[::-1]):
        of_each = settings.changed(settings.read({}), changes)
        assert of_each['wind'] == (1.0, 0.0, 0.0)
        assert settings.of_sim(of_each)['wind'] == (3.0, 0.0, 0.0)
    alone = settings.changed(values, ['sim.step=0.25'])
    assert (alone['step'], settings.of_sim(alone)['step']) == (0.5, 0.25)
    with pytest.raises(BadInput, match=r'sim\.horizon'):
        settings.changed(values, ['sim.horizon=3'])


def test_repeated_odometry_and_its_answer_count_once(tmp_path):
    raw = bags.raw(GOLDEN / 'retrieval')
    again = [each for each in raw if each.topic in ('/odom', '/tick')][:6]
    found = of_bag(write(tmp_path / 'bag', [*raw, *again, *again], {}))
    assert found.times.tolist() == of_bag(GOLDEN / 'retrieval').times.tolist()
    assert found.positions.shape == found.ropes.shape == (len(found.ticks), 3) == (26, 3)


def test_what_a_planner_would_refuse_is_no_history(tmp_path):
    run = of_bag(GOLDEN / 'faulty')
    assert np.isfinite(run.positions).all()
    assert np.isfinite(run.ropes).all()
    assert (np.diff(run.times) > 0.0).all()
    assert run.times[-1] - run.times[0] == 40.0


def test_a_bag_without_anything_that_a_planner_would_take_is_refused(tmp_path):
    def turned_wrong(message):
        message.pose.pose.orientation.w = 7.0

    change = changed('/odom', Odometry, turned_wrong)
    path = rewritten(GOLDEN / 'retrieval', tmp_path / 'bag', change)
    with pytest.raises(BadInput, match='no valid odom; odometry and a goal are needed'):
        of_bag(path)


# --- pictures: their contents, and their files


STILL = {'trajectory.png', 'data.png'}


@pytest.fixture(autouse=True)
def _for_print():
    with plot.look():
        yield


@pytest.fixture(scope='module')
def caught():
    return replace(of_bag(GOLDEN / 'retrieval'), captured=True).to_the_catch()


def flight(name, positions, *changes):
    """Return a flight of a scenario along positions."""
    return made_up(positions, settings.resolve(config(f'{name}.yaml'), changes))


def line(end, count):
    return np.linspace([0.0, 0.0, 0.0], end, count)


def labels(figure):
    return {text.get_text() for legend in figure.legends for text in legend.get_texts()}


def charts(figure):
    return {axes.get_title(loc='left'): axes for axes in figure.axes}


# --- the command


def test_a_bag_without_notes_is_drawn_by_a_file(tmp_path):
    file, known = tmp_path / 'mine.yaml', bags.notes(GOLDEN / 'lander')['parameters']
    file.write_text(known)
    bag = write(tmp_path / 'bag', bags.raw(GOLDEN / 'lander'), {})
    assert of_bag(bag, '', str(file)).values == of_bag(GOLDEN / 'lander').values
    file.write_text(f'{known}\n/uav2/**: {{ros__parameters: {{step: 9.0}}}}')  # of another vehicle
    assert settings.of_bag(bag, '/uav1', str(file)) == of_bag(GOLDEN / 'lander').values


def test_a_flight_is_drawn_into_a_folder_that_is_made(tool, tmp_path):
    out = tmp_path / 'deep' / 'obstacles'
    code, printed, _ = tool('plot', GOLDEN / 'obstacles', '-o', out, '--no-animation')
    assert code == 0
    assert {file.name for file in out.iterdir()} == STILL
    assert printed == f'written: trajectory.png, data.png in {out}\n'
    for file in out.iterdir():
        with Image.open(file) as image:
            assert min(image.size) >= 1000
            assert np.ptp(np.asarray(image.convert('L'))) > 200


def test_a_dark_retrieval_with_its_animation(tool, tmp_path):
    before = plot.paper()
    with plot.look(dark=True):
        page, palette = plot.paper(), mpl.rcParams['axes.prop_cycle'].by_key()['color']
    assert tool('plot', GOLDEN / 'retrieval', '-o', tmp_path, '--dark')[0] == 0
    assert plot.paper() == before != page
    assert {file.name for file in tmp_path.iterdir()} == STILL | {plot.ANIMATION}
    dark = tuple(round(255 * part) for part in to_rgb(page))
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
    for color in (palette[1], palette[3], palette[4]):  # vehicle, goal, plan
        wanted = np.array([round(255 * part) for part in to_rgb(color)])
        assert (np.abs(shown[1] - wanted).max(axis=2) <= 6).sum() > 50, color


def first(flight, count):
    """Return the first ``count`` samples of a flight."""
    parts = ('times', 'positions', 'attitudes', 'velocities', 'rates', 'ropes', 'plans', 'ticks')
    return replace(flight, **{part: getattr(flight, part)[:count] for part in parts})


def test_a_single_sighting_is_no_flight(tool, tmp_path, monkeypatch, caught):
    monkeypatch.setattr('orbimpc_ros.tool.plot.of_bag', lambda *_: first(caught, 1))
    code, _, complaint = tool('plot', 'short', '-o', tmp_path / 'out')
    assert (code, complaint.count('\n')) == (2, 1)
    assert 'single odometry' in complaint


# --- paths


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('name', ['retrieval', 'spacecraft'])
def test_short_and_long_flights_and_those_without_plans_are_drawn(name, tmp_path):
    assert len([*plot.instants(flight(name, line([5.0, 1.0, 0.0], 900)))]) == plot.FRAMES + 1
    flown = replace(of_bag(GOLDEN / name), captured=False)
    for each in (first(flown, 2), replace(first(flown, 5), plans=(), ticks=())):
        assert set(plot.written({'': each}, tmp_path)) == STILL
        plot.write_gif(each, tmp_path / 'short.gif')


@pytest.mark.parametrize('captured', [True, False])
@pytest.mark.parametrize('shape', ['none', 'polygon'])
def test_paths_have_equal_axes_units_and_a_legend(caught, captured, shape):
    values = caught.values | {'floor.shape': shape}
    figure = plot.paths({'': replace(caught, captured=captured, values=values)})
    whole = figure.axes[0]
    assert whole.get_aspect() == 1.0
    assert whole.get_xlabel() == 'x [m]'
    shown = charts(figure)
    assert 'Distance to the goal [m]' in shown
    speed = shown['Share of full speed, |R e₁|']
    assert any('floor' in text.get_text() for text in speed.texts) == (shape != 'none')
    assert {'flown path', 'body x', 'near miss', 'start', "goal's way"} <= labels(figure)
    assert ('goal when caught' in labels(figure)) == captured


def test_two_flights_are_told_apart_by_name_and_dashes():
    both = {
        name: flight('dubins', line([5.0, 10.0, 0.0], 21), f'floor.shape={name}')
        for name in ('none', 'polygon')
    }
    figure = plot.paths(both)
    assert {'flown path, none', 'flown path, polygon', 'goal'} <= labels(figure)
    drawn = [each for each in figure.axes[0].get_lines() if 'flown' in each.get_label()]
    assert len({each.get_linestyle() for each in drawn}) == 2
    shares = charts(figure)['Share of full speed, |R e₁|']
    assert 'floor' in {text.get_text() for text in shares.texts}  # although the first has none


def test_a_flight_is_drawn_with_its_box():
    box = [4.0, 0.5, 5.0, 4.6]
    figure = plot.paths({'': flight('retrieval', line([5.0, 1.0, 0.0], 21), f'obstacles={box}')})
    corners = [patch.get_bbox().extents for patch in figure.axes[0].patches]
    assert any(np.allclose(box, corner) for corner in corners)


# --- numbers over time


@pytest.mark.parametrize(('name', 'limited'), [('retrieval', True), ('spacecraft', False)])
def test_motion_is_shown_with_the_limits_of_speed(name, limited):
    shown = charts(plot.data(flight(name, line([5.0, 10.0, 25.0], 21))))
    assert {'Position [m]', 'Velocity [m/s]', 'Body rates [rad/s]'} <= set(shown)
    texts = {text.get_text() for text in shown['Velocity [m/s]'].texts}
    assert ('full speed' in texts) == limited


def test_ticks_without_a_plan_leave_holes_not_zeros(caught):
    holes = tuple(
        (time, fields | {'gap': float('nan'), 'fallback': 'safe command'} if k % 2 else fields)
        for k, (time, fields) in enumerate(caught.ticks)
    )
    flown = replace(caught, ticks=holes)
    times, gaps = flown.series('gap')
    assert len(times) == len(gaps) == (len(holes) + 1) // 2
    planned, fallen = charts(plot.data(flown))['Time of each tick [ms]'].get_lines()[:2]
    assert len(planned.get_xdata()) == 2 * len(fallen.get_xdata())
