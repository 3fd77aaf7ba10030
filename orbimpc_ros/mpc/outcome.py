# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The words for how a tick ended: enumerations whose values are what the topics say."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Word(str, Enum):
    """A member is its value: it compares, prints and serialises as that string."""

    __str__ = str.__str__

    def __format__(self, spec: str) -> str:
        """Format the value, on every version of Python."""
        return format(self.value, spec)


class Status(Word):
    """What a solve proved."""

    OPTIMAL = 'optimal'  # a checked plan, within the gap tolerance of the proved bound
    FEASIBLE = 'feasible'  # a checked plan, not proved optimal
    INFEASIBLE = 'infeasible'  # proved: no trajectory satisfies the constraints
    FAILED = 'failed'  # no plan, and no proof that there is none


class Fallback(Word):
    """What a tick's command follows where the solve gave no plan."""

    NONE = ''
    SHIFTED_PLAN = 'shifted plan'
    SOFT_ARRIVAL = 'soft arrival'
    CLEAREST_WAY = 'clearest way'
    SAFE_COMMAND = 'safe command'


class Cause(Word):
    """What kept a tick from being planned on fresh inputs."""

    NONE = ''  # it was planned: its status says the rest
    GOAL = 'goal'  # no goal is fresh
    HORIZON = 'horizon'  # a shrinking horizon has run out
    COMMAND = 'command'  # the command made of a plan must not be sent
    ODOMETRY = 'odometry'  # odometry is stale
    SOURCES = 'sources'  # more than one source of odometry
    WAITING = 'waiting'  # an input has not come yet
    CLOCK = 'clock'  # simulated time stands still
    DISABLED = 'disabled'
    AFRESH = 'afresh'  # inputs and plan were forgotten, but for a goal sent by hand
    RESET = 'reset'  # the same on request, and what was estimated
    FAILURE = 'failure'  # a callback raised an error
    SHUTDOWN = 'shutdown'


@dataclass(frozen=True)
class Reason:
    """Why no plan is followed.

    Attributes:
        cause: to decide by.
        words: for people.
    """

    cause: Cause
    words: str

    def and_so(self, more: str) -> Reason:
        """Return the reason with more words."""
        return Reason(self.cause, f'{self.words}; {more}')
