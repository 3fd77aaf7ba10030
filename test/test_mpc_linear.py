# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The linear algebra of the kernels obeys its laws; without numba it is the same code, slower."""

import numpy as np
import pytest

from orbimpc_ros.mpc.geometry.orbitopes import lmi
from orbimpc_ros.mpc.kernels.linear import diagonalise, is_positive, solve_spd
from orbimpc_ros.mpc.kernels.orbitope import add_adjoint, set_lmi, set_pair


@pytest.mark.parametrize('size', range(1, 18))
def test_systems_are_solved(size):
    rng = np.random.default_rng(size)
    factor = rng.normal(size=(size, size))
    matrix, x = factor @ factor.T + np.eye(size), rng.normal(size=size)
    room, right = np.full((20, 20), np.nan), np.full(20, np.nan)
    room[:size, :size], right[:size] = np.tril(matrix), matrix @ x
    assert solve_spd(room, right, size)
    np.testing.assert_allclose(right[:size], x, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize('size', range(1, 8))
@pytest.mark.parametrize('fault', [0.0, -1.0])
def test_systems_that_are_not_positive_definite_are_refused(size, fault):
    rng = np.random.default_rng(size)
    for bad in range(size):
        values = rng.uniform(1.0, 2.0, size=size)
        values[bad] = fault
        assert not solve_spd(np.diag(values), np.ones(size), size)


@pytest.mark.parametrize('seed', range(20))
def test_symmetric_matrices_are_diagonalised(seed):
    rng = np.random.default_rng(seed)
    basis, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    given = rng.choice([0.0, 1.0, -1.0, 1e-9, 3.0], size=4) * rng.choice([1.0, 1e6])
    matrix = basis @ np.diag(given) @ basis.T
    vectors, values = np.eye(4), np.empty(4)
    diagonalise(matrix.copy(), vectors, values)
    scale = np.abs(given).max() + 1e-30
    np.testing.assert_allclose(np.sort(values) / scale, np.sort(given) / scale, atol=1e-14)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(matrix @ vectors, vectors * values, atol=1e-13 * scale)
    assert is_positive(matrix.copy()) == (given.min() > 0.0 and given.min() > 1e-12 * scale)


def test_the_matrix_of_the_orbitope_is_the_one_that_is_stated():
    x, s = np.random.default_rng(0).normal(size=9), np.empty((4, 4))
    set_lmi(x, s)
    np.testing.assert_array_equal(s, lmi(x))


@pytest.mark.parametrize('seed', range(5))
def test_adjoint_and_pairs(seed):
    rng = np.random.default_rng(seed)
    x, m = rng.normal(size=9), rng.normal(size=(4, 4))
    m = m + m.T
    linear = lmi(x) - np.eye(4)
    out = np.zeros(9)
    add_adjoint(m, -2.0, out)
    assert out @ x == pytest.approx(-2.0 * np.sum(m * linear))
    basis, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    for i in range(4):
        for j in range(4):
            pair = np.outer(basis[:, i], basis[:, j])
            pair = pair + pair.T
            set_pair(basis, i, j, out)
            assert out @ x == pytest.approx(np.sum(pair * linear) / np.linalg.norm(pair))
