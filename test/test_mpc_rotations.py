# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of the rotation groups and of the projections onto them."""

import numpy as np
import pytest
from problems import rotation

from orbimpc_ros.mpc.geometry import rotations as so

SEEDS = range(60)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', SEEDS)
def test_exp_reaches_the_group_and_log_returns(n, seed):
    rng = np.random.default_rng(seed)
    q = rotation(rng, n)
    phi = so.log(q)
    assert np.allclose(q.T @ q, np.eye(n), atol=1e-12)
    assert np.linalg.det(q) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(phi) <= np.pi + 1e-9
    assert np.allclose(so.exp(phi), q, atol=1e-12)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', SEEDS)
def test_log_inverts_exp_below_half_a_turn(n, seed):
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=1 if n == 2 else 3)
    phi *= 10.0 ** rng.uniform(-13, 0) * 3.1 / np.linalg.norm(phi)
    assert np.allclose(so.log(so.exp(phi)), phi, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('n', [2, 3])
def test_exp_turns_at_the_rate_of_its_tangent(n):
    rng = np.random.default_rng(0)
    omega, h = rng.normal(size=1 if n == 2 else 3), 1e-6
    derivative = (so.exp(h * omega) - so.exp(-h * omega)) / (2 * h)
    assert np.allclose(derivative, so.skew(omega), atol=1e-8)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', SEEDS)
def test_nearest_is_nearer_than_any_other_rotation(n, seed):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(n, n))
    if n == 2:
        matrix = np.array([[matrix[0, 0], -matrix[1, 0]], [matrix[1, 0], matrix[0, 0]]])
    best = so.nearest(matrix)
    assert np.linalg.det(best) == pytest.approx(1.0, abs=1e-12)
    distance = np.linalg.norm(matrix - best)
    for _ in range(50):
        step = so.exp(rng.normal(size=1 if n == 2 else 3) * 10.0 ** rng.uniform(-3, 0.5))
        assert np.linalg.norm(matrix - best @ step) >= distance - 1e-12


def test_nearest_is_a_rotation_where_the_papers_formula_gives_a_reflection():
    matrix = -np.eye(3) / 3
    u, _, vt = np.linalg.svd(matrix)
    assert np.linalg.det(u @ vt) == pytest.approx(-1.0)
    assert np.linalg.det(so.nearest(matrix)) == pytest.approx(1.0)


@pytest.mark.parametrize('seed', SEEDS)
def test_thrust_aligned_keeps_the_axis_and_finds_the_best_roll(seed):
    rng = np.random.default_rng(seed)
    mix = rng.dirichlet(np.ones(4))
    matrix = sum(w * rotation(rng, 3) for w in mix)
    q = so.project_all(matrix[None], np.eye(3), 'thrust_aligned')[0][0]
    heading = matrix[:, 0]
    assert np.allclose(q.T @ q, np.eye(3), atol=1e-12)
    assert np.linalg.det(q) == pytest.approx(1.0, abs=1e-12)
    assert np.allclose(np.linalg.norm(heading) * q[:, 0], heading, atol=1e-12)
    distance = np.linalg.norm(matrix - q)
    for roll in np.linspace(-np.pi, np.pi, 41):
        assert np.linalg.norm(matrix - q @ so.exp(np.array([roll, 0, 0]))) >= distance - 1e-12


@pytest.mark.parametrize('how', ['nearest', 'thrust_aligned'])
@pytest.mark.parametrize('n', [2, 3])
def test_heading_is_held_where_it_is_undefined(n, how):
    rng = np.random.default_rng(1)
    first, *points = (rotation(rng, n) for _ in range(6))
    still = np.diag([0.0, 1.0, 0.0]) if n == 3 else np.zeros((2, 2))
    given = np.array([still, 0.5 * points[1], still, still, 0.7 * points[4]])
    projected, held = so.project_all(given, first, how)
    assert held.tolist() == [True, False, True, True, False]
    expected = [first, points[1], points[1], points[1], points[4]]
    np.testing.assert_allclose(projected, expected, atol=1e-12)


def test_any_roll_will_do_where_all_fit_as_well():
    flat = np.diag([0.3, 0.0, 0.0]) @ rotation(np.random.default_rng(2), 3)
    flat[:, 1:] = 0.0
    (q,), _ = so.project_all(flat[None], np.eye(3), 'thrust_aligned')
    assert np.allclose(q.T @ q, np.eye(3), atol=1e-12)
    assert np.linalg.det(q) == pytest.approx(1.0, abs=1e-12)
    assert np.allclose(q[:, 0] * np.linalg.norm(flat[:, 0]), flat[:, 0], atol=1e-12)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', SEEDS)
def test_quaternions_are_unit_and_return(n, seed):
    q = rotation(np.random.default_rng(seed), n)
    quaternion = so.to_quaternion(q)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)
    assert np.allclose(so.from_quaternion(quaternion, n), q, atol=1e-12)


def test_planar_rotation_of_a_tilted_body_is_its_heading_from_above():
    pitch, yaw = so.exp(np.array([0.0, 0.4, 0.0])), so.exp(np.array([0.0, 0.0, 1.1]))
    seen = so.from_quaternion(so.to_quaternion(yaw @ pitch), 2)
    assert np.allclose(seen, so.exp(np.array([1.1])), atol=1e-12)


@pytest.mark.parametrize('seed', SEEDS)
def test_turning_onto_an_axis_gets_there_by_the_shortest_way(seed):
    rng = np.random.default_rng(seed)
    q, goal = rotation(rng, 3), rotation(rng, 3)[:, 0]
    goal = {0: q[:, 0], 1: -q[:, 0]}.get(seed, goal)
    turned = so.turned_onto(q, goal)
    assert np.allclose(turned[:, 0], goal, atol=1e-9)
    assert np.allclose(turned.T @ turned, np.eye(3), atol=1e-12)
    between = np.arccos(np.clip(q[:, 0] @ goal, -1, 1))
    assert np.linalg.norm(so.log(q.T @ turned)) == pytest.approx(between, abs=1e-6)
