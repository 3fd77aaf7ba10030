# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The inputs of a bag that have no answer in it, and the answers that have no input."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.tool.replay.recording import CLOCK, Recording
from orbimpc_ros.tool.replay.resolving import acceptable


@dataclass(frozen=True)
class Coverage:
    """How much of a recording is whole.

    Attributes:
        asked: odometry messages that a planner at each odometry has to answer.
        unanswered: those of them that have no answer.
        orphans: planned answers whose odometry is not there.
    """

    asked: int
    unanswered: int
    orphans: int

    def __str__(self) -> str:
        without = f'{self.unanswered} of {self.asked} odometry messages'
        return f'{without}; {self.orphans} answers without their odometry'


def coverage(recording: Recording, settings: PlannerSettings) -> Coverage:
    """Return how much of a recording is whole, by the stamps of odometry that answers carry on."""
    answered = {each.stamp for each in recording.answers}
    asked = list(_asked(recording, settings))
    known = {each.stamp for each in recording.inputs if each.topic == 'odom'}
    orphans = [e for e in recording.answers if e.answer.planned and e.stamp not in known]
    return Coverage(len(asked), sum(stamp not in answered for stamp in asked), len(orphans))


def _asked(recording: Recording, settings: PlannerSettings) -> Iterator[int]:
    """Yield the stamps of odometry that is acceptable, newer than any before, and has a goal.

    Of several under one time of ``/clock`` the last alone: it has overtaken the others.
    """
    newest, goal, due = -1, False, None
    for each in recording.inputs:
        moves_on = each.topic == CLOCK or not recording.simulated
        if moves_on and due is not None:
            yield due
            due = None
        if not acceptable(each, settings):
            continue
        goal = goal or each.topic != 'odom'
        if each.topic == 'odom' and each.stamp > newest:
            newest = each.stamp
            due = newest if goal else None
    if due is not None:
        yield due
