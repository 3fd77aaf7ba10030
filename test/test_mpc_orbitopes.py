# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Membership of conv SO(2) and conv SO(3): the singular-value margin against the paper's LMI."""

import numpy as np
import pytest
from problems import rotation

from orbimpc_ros.mpc.geometry import orbitopes

SEEDS = range(100)


def smallest_eigenvalue(matrix):
    return np.linalg.eigvalsh(orbitopes.lmi(orbitopes.coordinates(matrix)))[0]


@pytest.mark.parametrize('seed', SEEDS)
def test_margin_is_the_smallest_eigenvalue_of_the_lmi(seed):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-3, 0.5)
    if seed % 3 == 0:  # singular values that coincide, either sign of the determinant
        matrix = rotation(rng, 3) @ np.diag(rng.choice([0.0, 1.0, -1.0], size=3)) @ rotation(rng, 3)
    assert orbitopes.margin(matrix) == pytest.approx(smallest_eigenvalue(matrix), abs=1e-12)


@pytest.mark.parametrize(
    ('matrix', 'margin'),
    [
        (np.diag([1.0, 1.0, -1.0]), -2.0),
        (-np.eye(3), -2.0),
        (-np.eye(3) / 3, 0.0),
        (np.eye(3), 0.0),
        (np.zeros((3, 3)), 1.0),
        (np.diag([1.0, 0.0, 0.0]), 0.0),
        (np.array([[0.6, -0.8], [0.8, 0.6]]), 0.0),
        (np.zeros((2, 2)), 1.0),
    ],
)
def test_known_margins(matrix, margin):
    assert orbitopes.margin(matrix) == pytest.approx(margin, abs=1e-12)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', SEEDS)
def test_mixtures_of_rotations_are_members_and_beyond_a_rotation_is_not(n, seed):
    rng = np.random.default_rng(seed)
    mixture = sum(w * rotation(rng, n) for w in rng.dirichlet(np.ones(5)))
    assert orbitopes.margin(mixture) >= -1e-12
    assert orbitopes.margin(1.01 * rotation(rng, n)) < -1e-3


@pytest.mark.parametrize('n', [2, 3])
def test_coordinates_are_those_of_the_matrix_with_the_thrust_axis_first(n):
    rng = np.random.default_rng(0)
    q = np.stack([rotation(rng, n) for _ in range(4)])
    x = orbitopes.coordinates(q)
    assert x.shape == (4, orbitopes.coordinate_count(n))
    assert np.array_equal(orbitopes.matrix(x), q) or np.allclose(orbitopes.matrix(x), q, atol=1e-15)
    assert np.array_equal(x[:, :n], q[:, :, 0])
    frobenius = orbitopes.frobenius_factor(n) * np.sum(x**2, axis=1)
    assert np.allclose(frobenius, np.sum(q**2, axis=(1, 2)))
