# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Whatever a certificate has for multipliers, points and splits, it proves nothing false."""

import json
import os

import adversary
import numpy as np
import pytest

from orbimpc_ros.mpc.proof import verifier

COUNT = int(os.environ.get('ORBIMPC_ADVERSARY', '60'))  # draws of each seed; more in test/long
HOLES = {
    'a cone that ends flat beside a sector': 'flat_cone.json',
    'the same, of an arrival': 'flat_cone_arrival.json',
    'a glide slope as good as level': 'level_slope.json',
}


@pytest.mark.parametrize('seed', range(6))
def test_no_part_proves_more_than_a_flight_in_it_costs(seed):
    for index in range(COUNT):
        rng = np.random.default_rng([seed, index])
        drawn = adversary.flight(rng)
        for _ in range(4 if drawn else 0):
            found = adversary.judged(drawn, rng)
            assert found is None or not found.is_false, f'{[seed, index]}: {found}'
