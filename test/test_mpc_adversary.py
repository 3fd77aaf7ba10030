# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Whatever a certificate has for multipliers, points and splits, it proves nothing false."""

import contextlib
import copy
import json
import os
from pathlib import Path

import adversary
import numpy as np
import pytest

from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof import verifier
from orbimpc_ros.mpc.proof.certificate import Certificate, Leaf
from orbimpc_ros.mpc.proof.verifier.exact import UNIT
from orbimpc_ros.mpc.proof.verifier.least import towards
from orbimpc_ros.mpc.proof.verifier.limits import cones

COUNT = int(os.environ.get('ORBIMPC_ADVERSARY', '60'))  # draws of each seed; more in test/long
FILES = Path(__file__).parent / 'reference' / 'certificates'


@pytest.mark.parametrize('name', ['flat_cone', 'flat_cone_arrival', 'level_slope'])
def test_what_rests_on_a_shorter_heading_or_a_steeper_slope_does_not_hold(name):
    """Beside a sector a cone's flat end is nearer than its least speed; a sine rounds below 0."""
    known = json.loads((FILES / f'{name}.json').read_text())
    with contextlib.suppress(verifier.Refused):
        assert not verifier.verified(known).holds


@pytest.mark.parametrize('seed', range(6))
def test_no_part_proves_more_than_a_flight_in_it_costs(seed):
    for index in range(COUNT):
        rng = np.random.default_rng([seed, index])
        drawn = adversary.flight(rng)
        for _ in range(4 if drawn else 0):
            found = adversary.judged(drawn, rng)
            assert found is None or not found.is_false, f'{[seed, index]}: {found}'


EXTREMES = [0, -0.0, 1e-320, 1e-300, 1e300, -1e300, float('inf'), float('nan'), 10**400, 'x', None,
            [], {}, [[[0.0]]], -1, 500]  # fmt: skip


def _places(known, way=()):
    """Yield the ways to all that a document holds."""
    if isinstance(known, (dict, list)):
        for key, each in known.items() if isinstance(known, dict) else enumerate(known):
            yield (*way, key)
            yield from _places(each, (*way, key))


def test_whatever_a_document_holds_it_is_judged_or_refused():
    rng, judged = np.random.default_rng(7), []
    while len(judged) < 12:
        drawn = adversary.flight(rng)
        judged.append(adversary.judged(drawn, rng) if drawn else None)
        judged = [each for each in judged if each]
    for found in judged:
        ways = list(_places(found.document))
        for _ in range(100):
            made = copy.deepcopy(found.document)
            *way, last = ways[int(rng.integers(len(ways)))]
            inner = made
            for key in way:
                inner = inner[key]
            inner[last] = EXTREMES[int(rng.integers(len(EXTREMES)))]
            with contextlib.suppress(verifier.Refused):
                verifier.verified(made)


def test_what_takes_more_work_than_its_length_may_is_refused():
    known = judged_document(200)
    known['tree'] = {'point': [[0.1, 0.1]] * 200, 'bends': [-1.0] * 200}
    with pytest.raises(verifier.Refused, match='work'):
        verifier.verified(known)
    known['tree']['bends'] = [1.0] * 200
    assert verifier.verified(known).leaves == 1


def judged_document(horizon):
    case = Problem(horizon=horizon), State.at(np.zeros(2), np.eye(2)), np.ones((horizon, 2))
    return json.loads(Certificate(*case, 1.0, Leaf()).text())


@pytest.mark.parametrize(
    ('path', 'value', 'word'),
    [
        (('state', 'rotation'), [[1.0, 0.0], [0.0, -1.0]], 'not \\[\\[a'),
        (('state', 'attitude'), [[1.0, 0.5], [0.5, 1.0]], 'not \\[\\[a'),
        (('limits',), {'cones': [{'axis': [1.0, 0.0], 'angle': 1.0, 'least': 2.0, 'steps': []}]},
         'above 1'),
    ],
)  # fmt: skip
def test_states_and_limits_that_are_none_are_refused(path, value, word):
    known = judged_document(2)
    inner = known
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    with pytest.raises(verifier.Refused, match=word):
        verifier.verified(known)


def test_a_cone_is_as_wide_whatever_the_length_of_its_axis():
    (((made,),), ((twice,),)) = (
        cones([{'axis': [x, 0.0], 'angle': 0.5, 'least': 0.0, 'steps': [1]}], 2, 1)
        for x in (0.25, 2.0)
    )
    slope = [-UNIT, UNIT]
    assert abs(towards(slope, made) - towards(slope, twice)) < 1 << 60
