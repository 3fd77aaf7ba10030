"""The last look at a command: each of its conditions, on a good one broken in one way."""

from dataclasses import replace

import numpy as np
import pytest
from problems import rotation

from orbimpc_ros.mpc.command import Command, flaw
from orbimpc_ros.mpc.problem import Problem

NAN, INF = np.nan, np.inf


def good(n):
    rng = np.random.default_rng(n)
    return Command(0.7, 0.2 * np.ones(1 if n == 2 else 3), rotation(rng, n))


@pytest.mark.parametrize('n', [2, 3])
def test_a_good_command_has_no_flaw(n):
    rng = np.random.default_rng(5)
    assert flaw(Problem(n), good(n)) == ''
    for _ in range(100):
        assert flaw(Problem(n), replace(good(n), rotation=rotation(rng, n))) == ''


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('value', [NAN, INF, -INF])
def test_not_finite(n, value):
    for broken in (
        replace(good(n), speed_fraction=value),
        replace(good(n), body_rate=changed(good(n).body_rate, -1, value)),
        replace(good(n), rotation=changed(good(n).rotation, (1, 0), value)),
    ):
        assert flaw(Problem(n), broken) == 'the command is not finite'


@pytest.mark.parametrize('fraction', [-1e-9, 1.0 + 1e-9])
def test_more_than_all_or_less_than_nothing(fraction):
    assert 'speed fraction' in flaw(Problem(), replace(good(2), speed_fraction=fraction))


@pytest.mark.parametrize('n', [2, 3])
def test_turning_faster_than_allowed(n):
    rate = good(n).body_rate
    largest = float(np.linalg.norm(rate))
    assert flaw(Problem(n, max_rate=largest), good(n)) == ''
    assert 'beyond' in flaw(Problem(n, max_rate=0.99 * largest), good(n))
    half_a_turn = rate * np.pi / largest
    assert flaw(Problem(n), replace(good(n), body_rate=half_a_turn)) == ''
    assert 'beyond' in flaw(Problem(n), replace(good(n), body_rate=1.001 * half_a_turn))


def broken_rotations(n):
    turned = good(n).rotation
    yield turned * (1.0 + 1e-8)
    yield turned * np.array([-1.0] + [1.0] * (n - 1))  # a mirror
    for i in range(n):
        for j in range(n):
            yield changed(turned, (i, j), turned[i, j] + 1e-6)


@pytest.mark.parametrize('n', [2, 3])
def test_no_rotation(n):
    for broken in broken_rotations(n):
        found = flaw(Problem(n), replace(good(n), rotation=broken))
        assert found == 'the commanded rotation is not a rotation'


@pytest.mark.parametrize(
    'rows',
    [
        np.zeros((3, 3)),
        np.diag([2.0, 0.5, 1.0]),
        np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 0.8]]),
    ],
)
def test_a_last_row_across_the_others_makes_no_rotation(rows):
    found = flaw(Problem(3), replace(good(3), rotation=rows))
    assert found == 'the commanded rotation is not a rotation'


def changed(array, index, value):
    copy = array.copy()
    copy[index] = value
    return copy
