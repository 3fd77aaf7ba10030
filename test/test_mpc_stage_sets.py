# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Stage sets of the plane against points of them, and relaxations against their own tangents."""

import numpy as np
import pytest

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.search import relax
from orbimpc_ros.mpc.search.ring import OUTLINE, Ring, extreme, least_speed, outline, prox, support

pytestmark = pytest.mark.skipif(
    not COMPILED, reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these"
)
ALL_AROUND = Ring(0.6, 0, np.pi, 0.0, 1.0, np.inf, 0.0, np.pi)
FLOORS = [ALL_AROUND, ALL_AROUND._replace(fraction=1.0), ALL_AROUND._replace(faces=5)]


def drawn(rng, ring):
    """The outline of a sector within a face of the floor, and points of it."""
    low = -np.pi / ring.faces if ring.faces else rng.uniform(-np.pi, np.pi)
    widest = 2.0 * np.pi / ring.faces if ring.faces else 2.5
    high, shape = low + widest * rng.uniform(0.01, 1.0), np.zeros(OUTLINE)
    outline(ring, np.array([low, high, ring.fraction, 1.0]), shape)
    angles = np.linspace(low, high, 181)
    least = [least_speed(ring.fraction, ring.faces, angle) for angle in angles]
    speeds = least + np.linspace(0.0, 1.0, 31)[:, None] * (1.0 - np.array(least))
    points = np.stack([speeds * np.cos(angles), speeds * np.sin(angles)], axis=-1)
    return shape, points.reshape(-1, 2)


@pytest.mark.parametrize('ring', FLOORS)
@pytest.mark.parametrize('seed', range(10))
def test_nothing_of_a_set_is_below_its_support_and_its_extreme_point_is_there(ring, seed):
    rng = np.random.default_rng(seed)
    shape, points = drawn(rng, ring)
    for _ in range(20):
        g = rng.normal(size=2)
        least = support(shape, 0.0, 0.0, *g)
        assert (points @ g).min() == pytest.approx(least, abs=2e-3)
        assert (points @ g).min() >= least - 1e-12
        assert g @ extreme(shape, *g) == pytest.approx(least, abs=1e-12)


@pytest.mark.parametrize('ring', FLOORS)
@pytest.mark.parametrize('length', [0.0, 0.4])
@pytest.mark.parametrize('seed', range(10))
def test_a_proximal_point_costs_no_more_than_mixtures_of_points(ring, length, seed):
    rng = np.random.default_rng(seed)
    shape, points = drawn(rng, ring)
    mixed = np.concatenate([points, 0.5 * (points + rng.permutation(points))])

    def cost(z):
        return 0.5 * (z**2).sum(-1) + z @ c + length * np.sqrt((z**2).sum(-1))

    for _ in range(20):
        c = 1.5 * rng.normal(size=2)
        z = np.array(prox(shape, 1.0, length, *c)[:2])
        assert cost(z) <= cost(mixed).min() + 1e-9
        g = z + c + length * z / max(1e-9, np.hypot(*z))  # and it is of the hull
        assert support(shape, 0.0, 0.0, *g) >= g @ z - 1e-7


def quadratic(rng, steps, kind):
    """A cost whose least is not within reach, of full rank, stiff, or of rank one."""
    along = rng.uniform(0.5, 1.0, steps)
    size = {'full': 1.0, 'stiff': 1e-6, 'one': 1e-10}[kind]
    h = np.outer(along, along) + size * np.diag(rng.uniform(0.5, 1.0, steps))
    q = -np.outer(along, rng.normal(size=2)) * rng.choice([0.3, 1.5]) * steps
    known = h, np.linalg.inv(h), q, np.zeros(steps), 0.0
    return relax.Quadratic(*known, 1 if kind == 'one' else steps)


@pytest.mark.parametrize('kind', ['full', 'stiff', 'one'])
@pytest.mark.parametrize('seed', range(12))
def test_a_relaxation_is_solved_and_its_bound_is_its_tangent_in_slices_too(kind, seed):
    rng = np.random.default_rng(seed)
    steps = int(rng.integers(2, 12))
    quad, room, flat = quadratic(rng, steps, kind), relax.room_for(steps), np.zeros(steps)
    for k in range(steps):
        room.shapes[k] = drawn(rng, ALL_AROUND)[0]
    bounds = []
    for work in (1e9, 1.0):
        z, best, known = np.zeros((steps, 2)), np.zeros((steps, 2)), np.array([-np.inf, 0, -np.inf])
        status = relax.GOING
        while status == relax.GOING:
            asked = (z, best, known), (np.inf, 1e-6), room, work
            status, _ = relax.relax(quad, flat, *asked)
        assert status == relax.SOLVED
        relax.set_slope(quad.hessian, quad.q, best, room.slope)
        bound = relax.tangent_bound(quad, room.shapes, flat, best, room.slope)[1]
        assert known[relax.KEY] == pytest.approx(bound, rel=1e-9, abs=1e-12)
        bounds.append(bound)
    assert bounds[0] == pytest.approx(bounds[1], rel=3e-6)
