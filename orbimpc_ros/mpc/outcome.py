"""The words for how a tick ended: enumerations whose values are what the topics say."""

from __future__ import annotations

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
    SAFE_COMMAND = 'safe command'
