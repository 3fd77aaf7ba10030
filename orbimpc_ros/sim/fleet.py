# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Seeded fleets: vehicles on a ring that chase ropes outwards, or cross to the opposite side."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import whole

MOST, LARGEST_SEED = 64, 2**31 - 1  # of vehicles; of all seeds
RING = 1.5  # [m] radius of the ring of starts
AHEAD = (7.0, 9.0)  # [m] from a start to the centre of its rope's swing
SWING = 0.5  # [m] amplitude of the swing along each axis
FREQUENCIES = (0.02, 0.3)  # [Hz]
ROOM = 3.0  # [m] of circumference per vehicle on the ring of a crossing
LEAST_RING = 5.0  # [m]
ASTRAY = 0.5  # [m] largest offset of starts and goals of a crossing from the ring, along each axis

FLEETS = {'fleet': 4, 'crossing': 8}  # default number of vehicles

Parameters = dict[str, Any]


def vehicles(fleet: str, count: int, seed: int = 0) -> dict[str, Parameters]:
    """Return the simulator parameters that differ within a fleet, by namespace: /uav1, ...

    Args:
        fleet: a key of :data:`FLEETS`.
        count: number of vehicles.
        seed: of the random draws; those of a vehicle depend on its number, too, not on ``count``.

    Raises:
        BadInput: ``count`` is not in [1, 64], or ``seed`` not in [0, 2^31 - 1].
    """
    parameters = dict[str, Parameters]()
    whole(seed, 'seed', 0, LARGEST_SEED)
    for number in range(whole(count, 'vehicles', 1, MOST)):
        rng, place = np.random.default_rng([seed, number]), 2.0 * math.pi * number / count
        outwards = np.array([math.cos(place), math.sin(place)])
        swing, frequency, phase = 0.0, 0.0, np.zeros(2)
        if fleet == 'fleet':
            start, goal = RING * outwards, (RING + rng.uniform(*AHEAD)) * outwards
            swing, frequency = SWING, rng.uniform(*FREQUENCIES)
            phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        else:
            across = max(LEAST_RING, ROOM * count / (2.0 * math.pi)) * outwards
            start, goal = rng.uniform(-ASTRAY, ASTRAY, (2, 2)) + np.array([across, -across])
        half = 0.5 * math.atan2(*(goal - start)[::-1])
        parameters[f'/uav{number + 1}'] = {
            'rope.center': (*goal.tolist(), 0.0),
            'rope.amplitude': (swing, swing, 0.0),
            'rope.frequency': frequency,
            'rope.phase': (*phase.tolist(), 0.0),
            'start.position': (*start.tolist(), 0.0),
            'start.orientation': (0.0, 0.0, math.sin(half), math.cos(half)),
            'seed': (seed + number + 1) % (LARGEST_SEED + 1),
        }
    return parameters
