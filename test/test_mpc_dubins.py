# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Catches against the closed form: minimum-time interception by a Dubins vehicle in wind."""

import math

import chases
import numpy as np
import pytest
from dubins import earliest, earliest_headed, earliest_within

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Approach

REFERENCES = chases.references()
HEADED = [known for known in REFERENCES if known.headed_time < 15.0]
needs_machine_code = pytest.mark.skipif(
    not COMPILED, reason='takes minutes in plain Python: install numba'
)


@pytest.mark.parametrize('known', REFERENCES)
def test_the_closed_form_is_that_of_others(known):
    time, word = earliest(known.chase)
    assert time == pytest.approx(known.time, abs=1e-6)
    assert word == known.word


@pytest.mark.parametrize('known', REFERENCES)
def test_the_closed_form_with_a_given_heading_is_that_of_others(known):
    time, word = earliest_headed(known.chase, known.heading)
    assert time == pytest.approx(known.headed_time, abs=1e-6)
    assert word == known.headed_word


def first_end(time, step):
    """The first end of a step that is not before a time."""
    return math.ceil(time / step - 1e-9)


@needs_machine_code
@pytest.mark.parametrize('known', REFERENCES)
def test_the_earliest_catch_is_at_the_first_step_that_ends_after_the_closed_form(known):
    step = next(step for step in (0.2, 0.4, 0.8) if known.time < 29.0 * step)
    catch = chases.catch(known.chase, step, 30)
    sooner = 2.0 * chases.NEAR * step  # what a radius may save, should the goal go along
    assert known.time - sooner <= catch.time <= known.time + 1.5 * step
    assert known.time - step <= catch.bound <= catch.time


@needs_machine_code
@pytest.mark.parametrize('known', HEADED)
def test_a_catch_in_a_cone_is_between_the_closed_forms_of_its_axis_and_of_any_heading_in_it(known):
    step, cone = 0.8, 0.2
    axis = (math.cos(known.heading), math.sin(known.heading))
    catch = chases.catch(known.chase, step, 20, Approach(cone, axis))
    within = known.heading + cone * np.linspace(-1.0, 1.0, 41)
    soonest = min(earliest_headed(known.chase, each)[0] for each in within)
    assert soonest - step <= catch.bound <= catch.time <= known.headed_time + 1.5 * step


@needs_machine_code
def test_chases_at_random_end_at_the_time_of_the_closed_form():
    """Within 1 %, where it is known where the goal is between the ends of steps."""
    rng = np.random.default_rng(11)
    for _ in range(4):
        chase = chases.drawn(rng, 1.5, 5.5)
        time, catch = earliest(chase)[0], chases.catch(chase, 0.2, 30, between=True)
        assert time - 0.2 <= catch.bound <= catch.time
        assert catch.time == pytest.approx(time, rel=0.01)


@needs_machine_code
def test_searches_that_stop_at_a_catch_find_that_of_the_controller():
    rng = np.random.default_rng(12)
    for _ in range(4):
        chase = chases.drawn(rng, 1.5, 5.5)
        catch = chases.catch(chase, 0.2, 30, between=True)
        soonest = chases.soonest(chase, 0.2, 30, lambda: None)
        assert (soonest.time, soonest.bound) == (catch.time, catch.bound)
        within = earliest_within(chase, chases.radius(chase, 0.2))
        assert within - 1e-3 <= soonest.time <= within + 0.1 * 0.2


@needs_machine_code
@pytest.mark.parametrize(('number', 'step'), [(0, 0.1), (3, 0.4), (3, 0.2), (3, 0.1)])
def test_as_steps_get_shorter_the_catch_comes_to_the_closed_form(number, step):
    known = REFERENCES[number]
    end = first_end(known.time, step)
    assert chases.tried(known.chase, step, end).miss < 1.0
    before = chases.tried(known.chase, step, end - 1)
    assert before.never
    assert before.miss > 1.0
