# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Whatever a certificate has for multipliers, points and splits, it proves nothing false."""

import contextlib
import copy
import json
import os

import adversary
import numpy as np
import pytest

from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof import reading
from orbimpc_ros.mpc.proof.document import Certificate, verified
from orbimpc_ros.mpc.proof.reading import Refused
from orbimpc_ros.mpc.proof.tree import ARCS, LEAF, one

COUNT = int(os.environ.get('ORBIMPC_ADVERSARY', '60'))  # draws of each seed; more in test/long


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
            with contextlib.suppress(Refused):
                verified(made)


def document_of(horizon, point=0.1, shor=-1.0, leaves=1):
    """Return a certificate without much of a bound, whose leaves are the same."""
    case = Problem(horizon=horizon), State.at(np.zeros(2), np.eye(2)), np.ones((horizon, 2))
    leaf = one(np.full((horizon, 2), point), np.full(horizon, shor))
    nodes = [[ARCS, 1, 1, leaves, -1], *[[LEAF, 0, 0, 0, 0]] * leaves][leaves == 1 :]
    tree = leaf._replace(nodes=np.array(nodes), at=np.zeros(len(nodes)))
    return json.loads(Certificate(*case, 1.0, tree).text())


def test_what_takes_more_work_than_its_length_may_is_refused():
    assert verified(document_of(200)).leaves == 1
    with pytest.raises(Refused, match='work'):
        verified(document_of(200, shor=1.0))
    assert verified(document_of(50, leaves=40)).leaves == 40
    with pytest.raises(Refused, match='work'):  # a leaf that many nodes share is as much work
        verified(document_of(50, leaves=4000))


CONE = {'axis': [1.0, 0.0], 'angle': 1.0, 'least': 0.0, 'steps': []}
SPEEDS = {'entry': 0.1, 'change': 0.1}
BALL = {'centre': [1.0, 0.0], 'radius': 1.0, 'of': 'end'}


@pytest.mark.parametrize(
    ('path', 'value', 'word'),
    [
        (('format',), 'another', 'format'),
        (('format',), 'orbimpc certificate 1', 'read no more'),
        (('goals',), ..., 'lacks goals'),
        (('lower_bound',), True, 'finite'),
        (('lower_bound',), 10**400, 'finite'),
        (('lower_bound',), '1', 'finite'),
        (('more',), 1, 'unknown'),
        (('goals', 0), [1.0], 'list of 2'),
        (('problem', 'horizon'), 2.5, 'horizon'),
        (('problem', 'step'), 0.0, 'step'),
        (('problem', 'weights', 'position'), -1.0, 'position'),
        (('problem', 'floor', 'shape'), ['circle'], 'floor'),
        (('state', 'attitude'), None, 'attitude'),
        (('state', 'rotation'), [[1.0, 0.0], [0.0, -1.0]], 'allowed'),
        (('state', 'attitude'), [[1.0, 0.5], [0.5, 1.0]], 'allowed'),
        (('limits',), {'cones': [{**CONE, 'least': 2.0}]}, 'cone'),
        (('limits',), {'speeds': [0.1, 0.2]}, 'speeds'),
        (('limits',), {'speeds': {'entry': 0.1}}, 'change'),
        (('limits',), {'speeds': {**SPEEDS, 'entry': -0.1}}, 'speeds'),
        (('limits',), {'speeds': {**SPEEDS, 'change': -0.1}}, 'speeds'),
        (('limits',), {'speeds': {**SPEEDS, 'most': 1.0}}, 'speeds'),
        (('limits',), {'bodies': [{**BALL, 'radius': 0.0}]}, 'radius'),
        (('limits',), {'bodies': [{**BALL, 'of': 'all'}]}, 'of'),
        (('tree',), 7, 'tree'),
        (('tree', 'nodes'), [[0, 0, 0, 0]], 'nodes'),
        (('tree', 'points'), [], "unknown 'points'"),
    ],
)
def test_states_and_limits_that_are_none_are_refused(path, value, word):
    known = document_of(2)
    inner = known
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    if value is ...:
        del inner[path[-1]]
    with pytest.raises(Refused, match=word) as caught:
        verified(known)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    'text', [b'', b'{', b'{"a":NaN}', b'{"a":-Infinity}', b'{"a":1,"a":1}', b'\xff', b'[' * 10**5]
)
def test_what_is_no_json_is_refused(text):
    with pytest.raises(Refused):
        reading.parsed(text)


def test_a_huge_file_is_refused_before_it_is_taken_apart(tmp_path, monkeypatch):
    file = tmp_path / 'huge.json'
    with file.open('wb') as made:
        made.truncate(1 << 30)  # sparse
    monkeypatch.setattr(reading, 'parsed', lambda text: pytest.fail('it was'))
    with pytest.raises(Refused, match='larger than'):
        reading.read(file)
