# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Delay compensation: measurements move on as the vehicle does, and what was in force when."""

import numpy as np
import pytest
from problems import ORDERS, rotation
from stepping import flown

from orbimpc_ros.loop.compensation import CommandHistory, Interval, advanced
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.sim.plant import Plant
from orbimpc_ros.sim.vehicle import launched, measured


def command(fraction, rate=(0.0,)):
    return Command(fraction, np.array(rate), np.eye(2 if len(rate) == 1 else 3))


@pytest.mark.parametrize('source', ['ground', 'air'])
@pytest.mark.parametrize('orders', ORDERS)
def test_a_measurement_moves_on_as_the_vehicle_does(orders, source):
    """Before a command is known, and with two of them, in a wind or under gravity.

    Rates are near zero, too, where closed forms give way to series. At order 1 they are obeyed at
    once; what else was commanded comes with the next command.
    """
    rng, n, order = np.random.default_rng(1), orders['dimension'], orders['translation_order']
    problem = Problem(**orders, forward=2.0)
    for _ in range(20):
        plant = Plant(n, 1, order, forward=2.0, disturbance=tuple(rng.normal(size=n)))
        rates = 10.0 ** rng.uniform(-4, 0.5, (3, 1)) * rng.normal(size=(3, plant.rates))
        first, second = (command(rng.uniform(), rate) for rate in rates[1:])
        place, attitude, velocity = rng.normal(size=n), rotation(rng, n), rng.normal(size=n)
        start = launched(
            plant, place, attitude, fraction=rng.uniform(), velocity=velocity, body_rate=rates[0]
        )
        spans = 0.1, 0.3, 0.2
        known = (None, None), (first, None), (second, first)
        intervals = [Interval(span, *each) for span, each in zip(spans, known, strict=True)]
        later = advanced(problem, measured(start, source), intervals, plant.blown, source)
        turns = rates if problem.rotation_order == 1 else rates[[0, 0, 1]]
        before, vehicle = start.fraction if order == 1 else 0.0, start
        shares = before, before, first.speed_fraction
        for span, rate, share in zip(spans, turns, shares, strict=True):
            vehicle = flown(plant, vehicle, share, rate, span)
        expected = measured(vehicle, source)
        assert later.time == pytest.approx(0.6)
        for name in ('position', 'attitude', 'body_velocity'):
            found = getattr(later, name)
            np.testing.assert_allclose(found, getattr(expected, name), atol=1e-6, err_msg=name)
        if problem.rotation_order == 2:
            np.testing.assert_array_equal(later.body_rate, first.body_rate)
        assert advanced(problem, later, []) is later


A, B, C = command(0.1), command(0.2), command(0.3)


def told(begin, end, sent=((1.0, A), (2.0, B), (3.0, C))):
    kept = CommandHistory()
    for at, given in sent:
        kept.add(given, at)
    return [
        (pytest.approx(interval.duration), interval.command, interval.before)
        for interval in kept.intervals(begin, end)
    ]


def test_intervals_are_what_was_in_force():
    assert told(1.5, 1.7) == [(0.2, A, None)]
    assert told(1.5, 2.5) == [(0.5, A, None), (0.5, B, A)]
    assert told(2.0, 3.5) == [(1.0, B, A), (0.5, C, B)]
    assert told(4.0, 4.25) == [(0.25, C, B)]
    assert told(0.5, 1.25) == [(0.5, None, None), (0.25, A, None)]
    assert told(0.0, 0.5) == [(0.5, None, None)]
    assert told(2.5, 2.5) == told(2.5, 2.0) == []


def test_forgotten_commands_are_not_in_force():
    kept = CommandHistory()
    kept.add(A, 1.0)
    kept.forget()
    assert [interval.command for interval in kept.intervals(1.5, 2.0)] == [None]
