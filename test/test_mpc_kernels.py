"""Machine code and general methods agree; needs numba, as an installation with [fast] has."""

from dataclasses import replace

import numpy as np
import pytest
from problems import floor, goals, state, weights

from orbimpc_ros.mpc.condensed import Condensed, position_weights
from orbimpc_ros.mpc.floors import fast
from orbimpc_ros.mpc.floors.cells import arcs, faces
from orbimpc_ros.mpc.floors.circle import Circle
from orbimpc_ros.mpc.floors.fast import Fast
from orbimpc_ros.mpc.hull import Hull
from orbimpc_ros.mpc.kernels import COMPILED, cells, chain
from orbimpc_ros.mpc.kernels.annulus import certified
from orbimpc_ros.mpc.orbitopes import margin, matrix
from orbimpc_ros.mpc.planar import Planar
from orbimpc_ros.mpc.problem import Problem, Weights
from orbimpc_ros.mpc.search import Search
from orbimpc_ros.mpc.trajectory import trajectory_of

pytestmark = pytest.mark.skipif(
    not COMPILED, reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these"
)
FLOORS = [('polygon', 0.5477, 4), ('polygon', 0.5, 6), ('polygon', 0.45, 3), ('none', 0.5, 4)]


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
    assert Planar.solves(problem)
    fast, general = Planar(problem, 1e-6), Search(problem, 1e-6)
    for _ in range(5):
        start = state(rng, problem, full_speed=False)
        targets = goals(rng, problem, distance=10.0 ** rng.uniform(-1, 3))
        found, expected = fast.solve(start, targets), general.solve(start, targets)
        cost = trajectory_of(problem, start, targets, found.x).cost
        assert found.cost == pytest.approx(cost, rel=1e-9, abs=1e-12)
        assert found.cost == pytest.approx(expected.cost, rel=3e-6, abs=1e-8)
        assert found.lower_bound <= found.cost
        assert found.lower_bound >= expected.lower_bound * (1 - 3e-6) - 1e-8


def test_a_search_that_runs_out_of_room_is_finished_by_the_next():
    rng = np.random.default_rng(3)
    problem = Problem(horizon=6, floor=floor('polygon', 0.6, 6))
    start = state(rng, problem)
    targets = np.tile(start.position, (6, 1))
    condensed = Condensed(problem)
    q, c = condensed.affine(start, targets)
    inverse, hexagon = np.linalg.inv(condensed.hessian), faces(6, 0.6)

    def run(room):
        return cells.branch_and_bound(
            condensed.hessian, inverse, q, c, *hexagon, np.inf, 1e-6, room
        )

    _, _, bound, nodes, complete = run(3)
    assert not complete
    assert nodes == 3
    _, value, proved, _, complete = run(4000)
    assert complete
    assert bound <= proved <= value


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize('seed', range(15))
def test_fast_and_general_circle_agree(seed, order):
    rng = np.random.default_rng(seed)
    fraction = [0.3, np.sqrt(0.3), 1.0][seed % 3]
    problem = Problem(
        horizon=5,
        translation_order=order,
        weights=weights(rng),
        floor=floor('circle', fraction),
    )
    assert Fast.solves(problem)
    circle = Circle(problem, 1e-6)
    for _ in range(4):
        start, targets = state(rng, problem), goals(rng, problem, distance=1.0)
        found = circle.solve(start, targets)
        circle._annulus.bind(start, targets)
        point = circle._annulus.stationary(found.x)
        assert point is not None
        assert found.cost == pytest.approx(point.cost, rel=1e-7, abs=1e-9)
        assert found.lower_bound <= found.cost
        proved = point.cost - point.lower_bound < 1e-7 * abs(point.cost)
        if proved:  # the two certificates do not depend on each other's code
            assert found.cost - found.lower_bound <= 1e-6 * abs(found.cost)


def passing(rng, problem):
    """Return a start, and a goal that passes by: plans on either side cost nearly the same."""
    start = state(rng, problem)
    along = np.outer(np.arange(1, problem.horizon + 1), rng.uniform(-0.8, 0.8, 2))
    return start, start.position + rng.uniform(-1.0, 1.0, 2) + along


@pytest.mark.parametrize('fraction', [np.sqrt(0.3), 1.0])
def test_arcs_prove_what_multipliers_do_not(monkeypatch, fraction):
    rng = np.random.default_rng(5)
    problem = Problem(floor=floor('circle', fraction))
    solver, condensed = Fast(problem, 1e-6), Condensed(problem)
    doubtful = 0
    for _ in range(150):
        start, targets = passing(rng, problem)
        with monkeypatch.context() as patched:
            patched.setattr(fast, 'ROOMS', ())
            doubtful += not solver.settles(solver.solve(start, targets))
        found = solver.solve(start, targets)
        assert solver.settles(found)
        assert found.cost - found.lower_bound <= 5.1e-5 * found.cost
        q, c = condensed.affine(start, targets)
        far = rng.normal(size=(1, 5, 2))
        _, cost, _, _ = certified(condensed.hessian, q, c, np.zeros(5), fraction, 0.0, far, 100)
        assert found.lower_bound <= (cost + c) * (1 + 1e-9)
        assert found.cost <= (cost + c) * (1 + 1e-6)
    assert doubtful > 5


def doubtful_case(problem, solver):
    rng = np.random.default_rng(5)
    while True:
        start, targets = passing(rng, problem)
        q, c = solver._condensed.affine(start, targets)
        found = solver._search(q, c, [])
        if not solver.settles(found):
            return start, targets, q, c, found


def test_a_search_over_arcs_leads_from_a_poor_plan_to_a_better_one():
    problem = Problem(floor=floor('circle', 1.0))
    solver = Fast(problem, 1e-6)
    _, _, q, c, best = doubtful_case(problem, solver)
    x = np.tile([1.0, 0.0], (5, 1))
    cost = float(np.sum(x * (0.5 * solver._condensed.hessian @ x + q))) + c
    assert cost > best.cost * 1.01
    found = replace(best, x=x, cost=cost, lower_bound=-np.inf)
    for room in fast.ROOMS:
        found = solver._searched_by_arcs(q, c, found, room)
    assert solver.settles(found)
    assert found.cost <= best.cost * (1 + 1e-6)


def test_the_bound_of_a_search_over_arcs_holds_with_path_length():
    rng = np.random.default_rng(6)
    problem = Problem(floor=floor('circle', 0.6), weights=Weights(length=1.0))
    solver = Fast(problem, 1e-6)
    for _ in range(40):
        start, targets = passing(rng, problem)
        q, c = solver._condensed.affine(start, targets)
        best = solver._search(q, c, [])
        bound = solver._searched_by_arcs(q, c, replace(best, lower_bound=-np.inf), 2000).lower_bound
        assert 0.0 < bound <= best.cost * (1 + 1e-9)
        without_length = best.cost - float(solver._length @ np.linalg.norm(best.x, axis=1))
        assert bound > without_length - 0.4 * solver._length.sum()


def test_a_search_over_arcs_ends_in_time(monkeypatch):
    problem = Problem(floor=floor('circle', 1.0))
    solver = Fast(problem, 1e-6)
    start, targets, _, _, doubtful = doubtful_case(problem, solver)
    monkeypatch.setattr(fast, 'ROOMS', (10, 10, 25_000))
    polled = []
    found = solver.solve(start, targets, None, lambda: polled.append(1) or len(polled) == 2)
    assert len(polled) == 2
    assert not solver.settles(found)
    assert doubtful.lower_bound <= found.lower_bound <= found.cost <= doubtful.cost


def test_arcs_and_their_halves_cover_the_floor():
    rng = np.random.default_rng(2)
    table = arcs(0.6)
    points = rng.normal(size=(500, 2))
    points *= (rng.uniform(0.6, 1.0, 500) / np.linalg.norm(points, axis=1))[:, None]
    beyond = points @ table.normals.T >= table.bounds - 1e-12
    assert beyond[:, : table.roots].any(axis=1).all()
    angles = np.arctan2(points[:, 1], points[:, 0])
    middles = np.arctan2(table.normals[:, 1], table.normals[:, 0])
    off = np.abs((angles[:, None] - middles + np.pi) % (2 * np.pi) - np.pi)
    over = off <= np.arccos(table.bounds / 0.6) + 1e-12  # the arcs whose sector a point is in
    assert (beyond | ~over).all()
    whole = table.halves > 0
    first = table.halves[whole]
    assert (over[:, whole] == (over[:, first] | over[:, first + 1])).all()
    assert (table.bounds[first] > table.bounds[whole]).all()
    assert sorted({*range(len(first) * 2 + 4)} - {*range(4)}) == sorted([*first, *(first + 1)])


def test_bounds_hold_whatever_the_number_of_starts():
    rng = np.random.default_rng(0)
    problem = Problem(floor=floor('circle', 0.6))
    condensed = Condensed(problem)
    for _ in range(50):
        start, targets = state(rng, problem), goals(rng, problem, distance=0.5)
        q, c = condensed.affine(start, targets)
        starts = np.ones((1, 5, 2))

        def run(more, q=q, c=c, starts=starts):
            return certified(condensed.hessian, q, c, np.zeros(5), 0.6, 0.0, starts, more)

        bounds = [run(more)[2] for more in (0, 5, 40)]
        costs = [run(more)[1] for more in (0, 5, 40)]
        assert bounds[0] <= bounds[1] <= bounds[2] <= costs[2] + 1e-9
        assert costs[2] <= costs[1] <= costs[0]


def test_without_numba_the_general_methods_take_over(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.planar.COMPILED', False)
    monkeypatch.setattr('orbimpc_ros.mpc.floors.fast.COMPILED', False)
    assert not Planar.solves(Problem())
    problem = Problem(floor=floor('circle', 0.5))
    assert not Fast.solves(problem)
    circle = Circle(problem, 1e-6)
    rng = np.random.default_rng(0)
    start, targets = state(rng, problem), goals(rng, problem)
    slow = circle.solve(start, targets)
    monkeypatch.undo()
    fast = Circle(problem, 1e-6).solve(start, targets)
    assert slow.cost == pytest.approx(fast.cost, rel=1e-6)


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
    assert Hull.solves(problem)
    fast, general = Hull(problem, 1e-6), Search(problem, 1e-6)
    for distance in (0.0, 1.0, 0.5 * horizon, 1e4):
        start = state(rng, problem, full_speed=False)
        targets = goals(rng, problem, distance=distance)
        found, expected = fast.solve(start, targets), general.solve(start, targets)
        cost = trajectory_of(problem, start, targets, found.x).cost
        assert found.cost == pytest.approx(cost, rel=1e-9, abs=1e-12)
        assert found.cost == pytest.approx(expected.cost, rel=1e-6, abs=1e-8)
        assert found.lower_bound == pytest.approx(found.cost, rel=1e-8, abs=1e-9)
        assert margin(matrix(found.x)).min() > -1e-8
    assert fast._general._search is None  # nothing was left to the general search


def test_a_bound_on_the_hull_holds_for_any_multipliers():
    rng = np.random.default_rng(5)
    problem = Problem(horizon=6, floor=floor('none'))
    start, targets = state(rng, problem), goals(rng, problem)
    optimum = Hull(problem, 1e-6).solve(start, targets).cost
    seen = targets - start.position
    along = np.array([[1.0, 1.0], [0.0, 1.0]])
    first = np.array([np.zeros(2), start.rotation[:, 0]])
    turning, weights_ = 2.0 * problem.weights.input, position_weights(problem)
    room = np.zeros((6, 2, 2)), np.empty((6, 2, 2, 2)), np.empty((6, 2)), np.empty((6, 2))
    for scale in (0.0, 0.1, 1.0, 10.0, 100.0):
        held = scale * rng.normal(size=(6, 2))
        assert chain._dual(along, first, turning, weights_, seen, held, *room) <= optimum + 1e-9


def test_who_has_a_deadline_gets_the_best_so_far_with_its_bound(monkeypatch):
    rng = np.random.default_rng(3)
    problem = Problem(horizon=6, floor=floor('polygon', 0.6, 6))
    start = state(rng, problem)
    targets = np.tile(start.position, (6, 1))
    proved = Planar(problem, 1e-6).solve(start, targets)
    room = proved.nodes - 5
    monkeypatch.setattr('orbimpc_ros.mpc.planar.NODES', (room,))
    planar = Planar(problem, 1e-6)
    hasty = planar.solve(start, targets, None, lambda: False)
    assert hasty.lower_bound <= proved.cost <= hasty.cost < np.inf
    assert hasty.nodes == room
    assert planar.solve(start, targets).cost == pytest.approx(proved.cost, rel=1e-6)
