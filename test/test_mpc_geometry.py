# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of rotation groups, orbitopes, projections, floors, covers of directions, and separation."""

import numpy as np
import pytest
from problems import rotation

from orbimpc_ros.mpc.geometry import rotations as so
from orbimpc_ros.mpc.geometry.faces import icosahedron, normals
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.problem.floor import largest_fraction

SEEDS = range(30)


def is_rotation(q):
    orthogonal = np.allclose(q.T @ q, np.eye(len(q)), atol=1e-12)
    return orthogonal and np.linalg.det(q) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', SEEDS)
def test_exp_and_quaternions_reach_the_group_and_return(n, seed):
    rng = np.random.default_rng(seed)
    q = rotation(rng, n)
    phi, quaternion = so.log(q), so.to_quaternion(q)
    assert is_rotation(q)
    assert np.linalg.norm(phi) <= np.pi + 1e-9
    assert np.allclose(so.exp(phi), q, atol=1e-12)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)
    assert np.allclose(so.from_quaternion(quaternion, n), q, atol=1e-12)
    less = 10.0 ** rng.uniform(-13, 0) * 3.1 * phi / np.linalg.norm(phi)
    assert np.allclose(so.log(so.exp(less)), less, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', SEEDS)
def test_nearest_is_nearer_than_any_other_rotation(n, seed):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(n, n))
    if n == 2:
        matrix = np.array([[matrix[0, 0], -matrix[1, 0]], [matrix[1, 0], matrix[0, 0]]])
    best = so.nearest(matrix)
    assert is_rotation(best)
    distance = np.linalg.norm(matrix - best)
    for _ in range(50):
        step = so.exp(rng.normal(size=1 if n == 2 else 3) * 10.0 ** rng.uniform(-3, 0.5))
        assert np.linalg.norm(matrix - best @ step) >= distance - 1e-12


@pytest.mark.parametrize('seed', SEEDS)
def test_thrust_aligned_keeps_the_axis_and_finds_the_best_roll(seed):
    rng = np.random.default_rng(seed)
    mix = rng.dirichlet(np.ones(4))
    matrix = sum(w * rotation(rng, 3) for w in mix)
    q = so.project_all(matrix[None], np.eye(3), 'thrust_aligned')[0]
    heading = matrix[:, 0]
    assert is_rotation(q)
    assert np.allclose(np.linalg.norm(heading) * q[:, 0], heading, atol=1e-12)
    distance = np.linalg.norm(matrix - q)
    for roll in np.linspace(-np.pi, np.pi, 41):
        assert np.linalg.norm(matrix - q @ so.exp(np.array([roll, 0, 0]))) >= distance - 1e-12


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
    assert is_rotation(turned)
    between = np.arccos(np.clip(q[:, 0] @ goal, -1, 1))
    assert np.linalg.norm(so.log(q.T @ turned)) == pytest.approx(between, abs=1e-6)


# --- orbitopes


@pytest.mark.parametrize('seed', SEEDS)
def test_margin_is_the_smallest_eigenvalue_of_the_lmi(seed):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-3, 0.5)
    if seed % 3 == 0:  # equal singular values, determinants of both signs
        matrix = rotation(rng, 3) @ np.diag(rng.choice([0.0, 1.0, -1.0], size=3)) @ rotation(rng, 3)
    least = np.linalg.eigvalsh(so.lmi(so.coordinates(matrix)))[0]
    assert so.margin(matrix) == pytest.approx(least, abs=1e-12)


@pytest.mark.parametrize('n', [2, 3])
def test_coordinates_are_those_of_the_matrix_with_the_thrust_axis_first(n):
    rng = np.random.default_rng(0)
    q = np.stack([rotation(rng, n) for _ in range(4)])
    x = so.coordinates(q)
    assert x.shape == (4, so.coordinate_count(n))
    assert np.array_equal(so.matrix(x), q) or np.allclose(so.matrix(x), q, atol=1e-15)
    assert np.array_equal(x[:, :n], q[:, :, 0])
    frobenius = so.frobenius_factor(n) * np.sum(x**2, axis=1)
    assert np.allclose(frobenius, np.sum(q**2, axis=(1, 2)))


# --- floors


@pytest.mark.parametrize(('n', 'faces'), [(2, 3), (2, 4), (2, 7), (3, 6), (3, 12), (3, 20)])
def test_faces_surround_the_floor_up_to_the_largest_fraction_and_no_further(n, faces):
    directions = normals(n, faces)
    assert directions.shape == (faces, n)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert len({tuple(np.round(d, 9)) for d in directions}) == faces
    rng = np.random.default_rng(0)
    v = rng.normal(size=(20_000, n))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    covered = (v @ directions.T).max(axis=1)
    limit = largest_fraction(n, faces)
    assert covered.min() >= limit - 1e-9
    assert covered.min() <= limit + 0.02


def test_the_patches_of_all_directions_cover_them():
    axes = np.random.default_rng(2).normal(size=(2000, 3))
    shares = np.linalg.solve(np.swapaxes(icosahedron(), 1, 2), axes.T[None])
    assert (shares >= -1e-9).all(axis=1).any(axis=0).all()


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('m', [1, 2, 3, 4])
def test_the_separating_normal_is_the_direction_to_the_nearest_point(n, m):
    rng = np.random.default_rng([5, n, m])
    sets = rng.normal(size=(300, m, n)) + 1.5 * rng.normal(size=(300, 1, n))
    normals, values = separation(sets)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    np.testing.assert_allclose((sets @ normals[:, :, None]).min(axis=(1, 2)), values, atol=1e-12)
    shares = rng.dirichlet(0.3 * np.ones(m), 4000)
    nearest = np.linalg.norm(np.einsum('sm,kmn->ksn', shares, sets), axis=2).min(axis=1)
    outside = values > 0.05
    assert (values <= nearest + 1e-9).all()
    np.testing.assert_allclose(nearest[outside], values[outside], atol=0.15)
    assert outside.sum() > 50
