# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Outcomes of a tick: enumerations whose values are published on topics."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Word(str, Enum):
    """An enumeration whose members compare, print and serialise as their string values."""

    __str__ = str.__str__


class Status(Word):
    """The result of a solve."""

    OPTIMAL = 'optimal'  # a checked plan, within the gap tolerance of the proved bound
    FEASIBLE = 'feasible'  # a checked plan, not proved optimal
    INFEASIBLE = 'infeasible'  # proved: no trajectory satisfies the constraints
    FAILED = 'failed'  # no plan, and no proof that there is none


class Fallback(Word):
    """The source of a tick's command if the solve gave no plan."""

    NONE = ''
    SHIFTED_PLAN = 'shifted plan'
    SOFT_ARRIVAL = 'soft arrival'
    CLEAREST_WAY = 'clearest way'
    SAFE_COMMAND = 'safe command'


class Cause(Word):
    """The reason why a tick was not planned on fresh inputs."""

    NONE = ''  # it was planned, with the result in its status
    GOAL = 'goal'  # no goal is fresh
    HORIZON = 'horizon'  # a shrinking horizon has run out
    COMMAND = 'command'  # the command of a plan failed its check
    ODOMETRY = 'odometry'  # odometry is stale
    SOURCES = 'sources'  # more than one source of odometry
    WAITING = 'waiting'  # an input has not come yet
    CLOCK = 'clock'  # simulated time does not advance
    DISABLED = 'disabled'
    AFRESH = 'afresh'  # inputs and plan were discarded, except a goal sent by hand
    RESET = 'reset'  # the same on request, and estimates were discarded too
    FAILURE = 'failure'  # a callback raised an error
    SHUTDOWN = 'shutdown'


@dataclass(frozen=True)
class Reason:
    """The reason why no plan is followed.

    Attributes:
        cause: for programs.
        words: for people.
    """

    cause: Cause
    words: str

    def and_so(self, more: str) -> Reason:
        """Return the reason with more words."""
        return Reason(self.cause, f'{self.words}; {more}')
