# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Machine code and general methods agree; needs numba, as an installation with [fast] has."""

import json
import os
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
from problems import floor, goals, rotation, state, weights

from orbimpc_ros.mpc import kernels
from orbimpc_ros.mpc.check import floor_margin
from orbimpc_ros.mpc.geometry.orbitopes import margin, matrix
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels import riccati as chain
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.cost import position_weights
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Problem, Weights
from orbimpc_ros.mpc.search import engine
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.solve.annulus_newton import NOTHING, AnnulusNewton
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.hull_riccati import HullRiccati
from orbimpc_ros.mpc.solve.request import Request

pytestmark = pytest.mark.skipif(
    not COMPILED, reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these"
)
FLOORS = [('polygon', 0.5477, 4), ('polygon', 0.5, 6), ('polygon', 0.45, 3)]


def random_problem(rng, shape):
    chosen = replace(weights(rng), length=0.0)
    return Problem(
        horizon=int(rng.integers(1, 7)),
        translation_order=int(rng.integers(1, 3)),
        floor=floor(*shape),
        weights=chosen,
    )


@pytest.mark.parametrize('seed', range(12))
@pytest.mark.parametrize('shape', FLOORS)
def test_planar_search_finds_and_proves_what_the_general_one_does(seed, shape):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, shape)
    assert Engine.solves(problem)
    fast, general = Engine(problem, 1e-6), DisjunctiveSearch(problem, 1e-6)
    for _ in range(5):
        start = state(rng, problem, full_speed=False)
        targets = goals(rng, problem, distance=10.0 ** rng.uniform(-1, 3))
        found, expected = (
            fast.solve(Request(start, targets)),
            general.solve(Request(start, targets)),
        )
        cost = trajectory_of(problem, start, targets, found.x).cost
        assert found.cost == pytest.approx(cost, rel=1e-9, abs=1e-12)
        assert found.cost == pytest.approx(expected.cost, rel=3e-6, abs=1e-8)
        assert found.lower_bound <= found.cost
        assert found.lower_bound >= expected.lower_bound * (1 - 3e-6) - 1e-8


def test_a_search_that_runs_out_of_room_has_a_legal_plan_and_its_bound():
    rng = np.random.default_rng(3)
    problem = Problem(horizon=6, floor=floor('polygon', 0.6, 6))
    few, many = Engine(problem, 1e-6), Engine(problem, 1e-6)
    few._most, cut_short = 3, 0
    for _ in range(10):
        request = Request(*passing(rng, problem))
        early, late = few.solve(request), many.solve(request)
        assert early.nodes <= 3
        assert early.lower_bound <= late.lower_bound * (1 + 1e-9)
        assert late.cost * (1 - 1e-4) <= early.cost
        assert floor_margin(problem, early.x).min() >= -1e-9
        cut_short += early.lower_bound < late.lower_bound * (1 - 1e-3)
    assert cut_short


def test_a_search_in_slices_proves_what_a_whole_one_does():
    rng = np.random.default_rng(11)
    problem = Problem(horizon=6, floor=floor('polygon', 0.6, 6))
    for _ in range(20):
        start, targets = passing(rng, problem)
        planar = Engine(problem, 1e-6)
        whole = planar.solve(Request(start, targets))
        sliced = planar.solve(Request(start, targets, out_of_time=lambda: False))
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(engine, 'SLICE', 1.0)
            each = planar.solve(Request(start, targets, out_of_time=lambda: False))
        assert (whole.cost, whole.nodes) == (sliced.cost, sliced.nodes)
        assert each.cost == pytest.approx(whole.cost, rel=1e-6)
        assert each.cost - each.lower_bound <= 1e-6 * each.cost


@pytest.mark.parametrize('shape', [('polygon', 0.6, 6), ('polygon', 0.5, 4)])
def test_an_interrupted_search_returns_a_legal_plan_and_its_bound(monkeypatch, shape):
    monkeypatch.setattr(engine, 'SLICE', 1.0)
    rng = np.random.default_rng(12)
    problem = Problem(horizon=8, floor=floor(*shape))
    planar = Engine(problem, 1e-6)
    for polls in (1, 2, 5, 20):
        start, targets = passing(rng, problem)
        left = iter(range(polls))
        found = planar.solve(
            Request(start, targets, out_of_time=lambda left=left: next(left, None) is None)
        )
        proved = planar.solve(Request(start, targets))
        assert -np.inf < found.lower_bound <= proved.cost * (1 + 1e-9)
        assert proved.lower_bound <= found.cost < np.inf
        assert floor_margin(problem, found.x).min() >= -1e-9
        assert np.linalg.norm(found.x, axis=1).max() <= 1.0 + 1e-9


@pytest.mark.parametrize('seed', range(10))
def test_weights_far_apart_do_not_stop_a_search(seed):
    """A polygon of few steps, against every choice of faces by the general program."""
    rng = np.random.default_rng(seed)
    chosen = Weights(*10.0 ** rng.uniform(-6, 6, 2), 0.0, 10.0 ** rng.uniform(-6, 6))
    chosen = replace(chosen, input=[chosen.input, 0.0][seed % 2])
    problem = Problem(horizon=2, floor=floor('polygon', 0.6, 4), weights=chosen)
    start, targets = state(rng, problem), goals(rng, problem, distance=1.0)
    found = Engine(problem, 1e-6).solve(Request(start, targets))
    best = best_by_grid(problem, start, targets)
    assert found.lower_bound <= best * (1 + 1e-9) + 1e-9
    assert found.cost <= best * (1 + 1e-3)
    assert found.cost - found.lower_bound <= 1e-4 * found.cost + 1e-9


def best_by_grid(problem, start, targets, count=120):
    """The least cost over headings on a polar grid with the floor's faces and the rim on it."""
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    size = np.linspace(problem.floor.fraction, 1.0, 30)
    grid = np.stack([np.outer(size, f(angle)).ravel() for f in (np.cos, np.sin)], axis=1)
    grid = grid[floor_margin(problem, grid) >= 0.0]
    condensed = Condensed(problem)
    q, c = condensed.affine(start, targets)
    h = condensed.hessian
    own = [0.5 * h[k, k] * np.sum(grid * grid, axis=1) + grid @ q[k] for k in (0, 1)]
    return float((own[0][:, None] + own[1] + h[0, 1] * grid @ grid.T).min()) + c


def test_plain_python_finds_what_machine_code_does(tmp_path):
    script = tmp_path / 'solve.py'
    script.write_text(PLAIN)
    ours, theirs = (
        json.loads(
            subprocess.run(
                [sys.executable, str(script)],
                env={**os.environ, 'NUMBA_DISABLE_JIT': disabled},
                capture_output=True,
                check=True,
                text=True,
            ).stdout
        )
        for disabled in ('0', '1')
    )
    assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-12)


PLAIN = """
import json, numpy as np
from orbimpc_ros.mpc.solve.annulus_newton import AnnulusNewton
from orbimpc_ros.mpc.solve.hull_riccati import HullRiccati
from orbimpc_ros.mpc.check import floor_margin
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.problem import Floor, Problem, State, Weights
at = Request(State.at([0.0, 0.0], np.eye(2)), np.tile([0.4, 0.3], (3, 1)))
high = Request(State.at(np.zeros(3), np.eye(3)), np.tile([0.4, 0.3, 0.2], (3, 1)))
seen = Weights(input=0.0)
found = [
    AnnulusNewton(Problem(horizon=3, floor=Floor('circle', 4, 0.6)), 1e-6).solve(at),
    AnnulusNewton(Problem(3, horizon=3, weights=seen, floor=Floor('circle')), 1e-6).solve(high),
    Engine(Problem(horizon=3, floor=Floor('polygon', 4, 0.6)), 1e-6).solve(at),
    HullRiccati(Problem(horizon=3), 1e-6).solve(at),
]
print(json.dumps([number for each in found for number in (each.cost, each.lower_bound)]))
"""


def passing(rng, problem):
    """Return a start, and a goal that passes by: plans on either side cost nearly the same."""
    start = state(rng, problem)
    along = np.outer(np.arange(1, problem.horizon + 1), rng.uniform(-0.8, 0.8, 2))
    return start, start.position + rng.uniform(-1.0, 1.0, 2) + along


def tick_of(circle, start, targets, out_of_time=None):
    return circle._tick(Request(start, targets, out_of_time=out_of_time))


@pytest.mark.parametrize('fraction', [np.sqrt(0.3), 1.0])
def test_arcs_prove_what_multipliers_do_not(fraction):
    rng = np.random.default_rng(5)
    problem = Problem(floor=floor('circle', fraction))
    circle = AnnulusNewton(problem, 1e-6)
    doubtful = 0
    for _ in range(150):
        start, targets = passing(rng, problem)
        tick = tick_of(circle, start, targets)
        multipliers = circle._from_dual(tick, circle._from_hull(tick, NOTHING))
        doubtful += not circle.settles(multipliers)
        found = circle._by_arcs(tick, circle._from_hull(tick, NOTHING))
        assert circle.settles(found)
        far = rng.normal(size=(1, 5, 2))
        known = circle._from(tick, NOTHING, far, 100)
        assert found.lower_bound <= known.cost * (1 + 1e-9)
        assert found.cost <= known.cost * (1 + 9.1e-5)
        assert multipliers.lower_bound <= known.cost * (1 + 1e-9)
    assert doubtful > 0


def doubtful_case(problem, circle):
    rng = np.random.default_rng(5)
    while True:
        start, targets = passing(rng, problem)
        tick = tick_of(circle, start, targets)
        found = circle._from_hull(tick, NOTHING)
        if not circle.settles(found):
            return start, targets, tick, found


def test_a_search_over_arcs_leads_from_a_poor_plan_to_a_better_one():
    problem = Problem(floor=floor('circle', 1.0))
    circle = AnnulusNewton(problem, 1e-6)
    _, _, tick, best = doubtful_case(problem, circle)
    x = np.tile([1.0, 0.0], (5, 1))
    cost = float(np.sum(x * (0.5 * circle._condensed.hessian @ x + tick.q))) + tick.constant
    assert cost > best.cost * 1.01
    found = circle._by_arcs(tick, replace(best, x=x, cost=cost, lower_bound=-np.inf))
    assert circle.settles(found)
    assert found.cost <= best.cost * (1 + 9.1e-5)


def test_the_bound_of_a_search_over_arcs_holds_with_path_length():
    rng = np.random.default_rng(6)
    problem = Problem(floor=floor('circle', 0.6), weights=Weights(length=1.0))
    circle = AnnulusNewton(problem, 1e-6)
    for _ in range(40):
        start, targets = passing(rng, problem)
        tick = tick_of(circle, start, targets)
        best = circle._headings(tick)
        bound = circle._by_arcs(tick, replace(best, lower_bound=-np.inf)).lower_bound
        assert 0.0 < bound <= best.cost * (1 + 1e-9)
        length = circle._annulus.length
        without_length = best.cost - float(length @ np.linalg.norm(best.x, axis=1))
        assert bound > without_length - 0.4 * length.sum()


def test_a_search_over_arcs_ends_in_time(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.solve.arc_search.SLICE', 1.0)
    problem = Problem(floor=floor('circle', 1.0))
    circle = AnnulusNewton(problem, 1e-6)
    start, targets, _, doubtful = doubtful_case(problem, circle)
    left = iter(range(2))
    tick = tick_of(circle, start, targets, lambda: next(left, None) is None)
    found = circle._by_arcs(tick, doubtful)
    assert doubtful.lower_bound <= found.lower_bound <= found.cost <= doubtful.cost
    assert circle._arcs.nodes < 5


def test_bounds_hold_whatever_the_number_of_starts():
    rng = np.random.default_rng(0)
    problem = Problem(floor=floor('circle', 0.6))
    circle = AnnulusNewton(problem, 0.0)
    for _ in range(50):
        start, targets = state(rng, problem), goals(rng, problem, distance=0.5)
        tick = tick_of(circle, start, targets)
        found = [circle._from(tick, NOTHING, np.ones((1, 5, 2)), more) for more in (0, 5, 40)]
        few, some, many = found
        assert few.lower_bound <= some.lower_bound <= many.lower_bound <= many.cost * (1 + 1e-9)
        assert many.cost <= some.cost <= few.cost


@pytest.mark.parametrize('seed', range(10))
@pytest.mark.parametrize('horizon', [1, 2, 7, 25, 60])
def test_the_hull_is_solved_whatever_the_horizon(horizon, seed):
    rng = np.random.default_rng(seed)
    problem = Problem(
        horizon=horizon,
        step=float(rng.uniform(0.2, 1.0)),
        floor=floor('none'),
        weights=replace(weights(rng), length=0.0),
    )
    assert HullRiccati.solves(problem)
    fast, general = HullRiccati(problem, 1e-6), DisjunctiveSearch(problem, 1e-6)
    for distance in (0.0, 1.0, 0.5 * horizon, 1e4):
        start = state(rng, problem, full_speed=False)
        targets = goals(rng, problem, distance=distance)
        found, expected = (
            fast.solve(Request(start, targets)),
            general.solve(Request(start, targets)),
        )
        cost = trajectory_of(problem, start, targets, found.x).cost
        assert found.cost == pytest.approx(cost, rel=1e-9, abs=1e-12)
        assert found.cost == pytest.approx(expected.cost, rel=1e-6, abs=1e-8)
        assert found.lower_bound == pytest.approx(found.cost, rel=1e-8, abs=1e-9)
        assert margin(matrix(found.x)).min() > -1e-8
    assert fast._general._search is None  # nothing was left to the general search


def test_a_bound_on_the_hull_holds_for_any_multipliers():
    rng = np.random.default_rng(5)
    problem = Problem(horizon=6, floor=floor('none'), weights=Weights(attitude=3.0))
    start, targets = state(rng, problem), goals(rng, problem)
    start = replace(start, wanted=rotation(rng, 2))
    optimum = HullRiccati(problem, 1e-6).solve(Request(start, targets)).cost
    seen = targets - start.position
    along = np.array([[1.0, 1.0], [0.0, 1.0]])
    first = np.array([np.zeros(2), start.rotation[:, 0]])
    turning, weights_ = 2.0 * problem.weights.input, position_weights(problem)
    wish = np.array([6.0, *start.wanted[:, 0]])
    asked = chain.Chain(along, first, turning, weights_, seen, wish)
    room = np.zeros((6, 2, 2)), np.empty((6, 2, 2, 2)), np.empty((6, 2)), np.empty((6, 2))
    for scale in (0.0, 0.1, 1.0, 10.0, 100.0):
        held = scale * rng.normal(size=(6, 2))
        assert chain._dual(asked, held, *room) <= optimum + 1e-9


def test_an_interrupted_hull_stays_in_its_disks_with_its_bound():
    rng = np.random.default_rng(8)
    problem = Problem(horizon=40, floor=floor('none'))
    hull = HullRiccati(problem, 1e-6)
    hull._slice = 1
    for polls in range(6):
        start, targets = state(rng, problem), goals(rng, problem, distance=20.0)
        left = iter(range(polls))
        found = hull.solve(
            Request(start, targets, out_of_time=lambda left=left: next(left, None) is None)
        )
        optimum = hull.solve(Request(start, targets))
        assert np.linalg.norm(found.x, axis=1).max() <= 1.0 + 1e-12
        assert found.lower_bound <= optimum.cost * (1 + 1e-9)
        assert found.cost >= optimum.lower_bound


ONCE = """
    import sys, time
    from pathlib import Path
    from orbimpc_ros.mpc.kernels import compiled

    @compiled
    def added(one, other):
        return one + other

    mine, others = map(Path, sys.argv[1:])
    mine.touch()
    while not others.exists():
        time.sleep(0.001)
    added(1.0, 2.0)
    print(sum(added.stats.cache_misses.values()))
"""


def test_processes_that_need_the_same_code_at_once_compile_it_once(tmp_path):
    script = tmp_path / 'once.py'
    script.write_text(textwrap.dedent(ONCE))
    command = [sys.executable, str(script)]
    options = {'cwd': tmp_path, 'stdout': subprocess.PIPE, 'text': True}
    pair = [subprocess.Popen([*command, *names], **options) for names in ('ab', 'ba')]
    assert sorted(each.communicate(timeout=60)[0] for each in pair) == ['0\n', '1\n']


def test_code_from_other_sources_is_forgotten(tmp_path):
    """Code contains what it calls in other files: one of them that changes makes all of it old."""
    source, kept = tmp_path / 'one.py', tmp_path / 'kept'
    kept.mkdir()
    source.write_text('a = 1')

    def left():
        (kept / 'one.f-1.nbi').touch()
        (kept / 'one.f-1.1.nbc').touch()
        kernels._forget_other_sources.__wrapped__(tmp_path, kept)
        return sorted(each.suffix for each in kept.iterdir() if each.suffix != '.sha256')

    assert left() == []
    assert left() == ['.nbc', '.nbi']
    source.write_text('a = 2')
    assert left() == []
    kernels._forget_other_sources.__wrapped__(tmp_path, tmp_path / 'where nobody may write')
