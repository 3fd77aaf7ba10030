# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Outlines of floors: every edge lies on two faces, every circle is round."""

import numpy as np
import pytest

from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.geometry.outline import sphere
from orbimpc_ros.mpc.problem import Floor


@pytest.mark.parametrize('faces', [4, 6, 7])
def test_a_polygon_has_its_corners_and_edges(faces):
    lines = np.array(Floor('polygon', faces, 0.5).outline(2))
    assert lines.shape == (faces, 2, 3)
    assert np.allclose(np.linalg.norm(lines, axis=2), 0.5 / np.cos(np.pi / faces))
    reached = (lines[:, :, :2] @ normals(2, faces).T).max(axis=2)
    assert np.allclose(reached, 0.5)


@pytest.mark.parametrize(('faces', 'edges'), [(6, 12), (12, 30), (20, 30)])
def test_a_solid_has_its_edges(faces, edges):
    lines = np.array(Floor('polygon', faces, 0.5).outline(3))
    assert lines.shape == (edges, 2, 3)
    on = np.isclose(lines @ normals(3, faces).T, 0.5).all(axis=1)
    assert (on.sum(axis=1) == 2).all()  # every edge belongs to two faces


@pytest.mark.parametrize('dimension', [2, 3])
def test_round_floors_and_hulls_are_round(dimension):
    for lines, radius in (
        (sphere(dimension, 1.0), 1.0),
        (Floor('circle', fraction=0.7).outline(dimension), 0.7),
    ):
        assert np.allclose(np.linalg.norm(np.concatenate(lines), axis=1), radius)
    assert Floor().outline(dimension) == ()
