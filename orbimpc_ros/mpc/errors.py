# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The errors of this package; those of bad input name a culprit, its value and what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

LISTED = 20  # most names listed by an error


class OrbimpcError(Exception):
    """Base class of every error this package raises on purpose."""


class BadInput(OrbimpcError, ValueError):
    """A value from outside is missing, malformed or out of range.

    Args:
        culprit: the field, topic or file that carries the value.
        value: the value received.
        allowed: what would have been accepted.
        text: the message; by default it is made of these.
    """

    def __init__(self, culprit: str, value: object, allowed: str, text: str = '') -> None:
        self.culprit, self.value, self.allowed = culprit, value, allowed
        plain = [*value] if isinstance(value, tuple) else value  # as in YAML
        shown = _in_short(plain if isinstance(plain, str) else repr(plain))
        super().__init__(text or f'{culprit} is {shown}; allowed: {allowed}')

    def __reduce__(self) -> tuple:
        """Pickle all arguments, so that an error of a worker process can reach its parent."""
        return type(self), (self.culprit, self.value, self.allowed, str(self))

    @classmethod
    def stating(cls, subject: str, problem: str, hint: str) -> BadInput:
        """Return an error that is not about a value: ``subject: problem; hint``."""
        return cls(subject, problem, hint, f'{subject}: {_in_short(problem)}; {hint}')

    @classmethod
    def unknown(cls, kind: str, name: str, known: Iterable[str], where: str = '') -> BadInput:
        """Return the error of an unknown name, with the closest known names.

        Args:
            kind: the kind of name, such as ``parameter``.
            name: the name received.
            known: the names that exist.
            where: the file or option that contains it.
        """
        names, name = list(dict.fromkeys(known)), ' '.join(name.split())[:80]
        close = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
        meant = ' or '.join(repr(each) for each in close)
        more = ', ...' if len(names) > LISTED else ''
        hint = f'did you mean {meant}?' if close else f'known: {", ".join(names[:LISTED])}{more}'
        before = f'{where}: ' if where else ''
        return cls(name, f'no {kind}', hint, f'{before}unknown {kind} {name!r}; {hint}')


def _in_short(text: str) -> str:
    """Return a text on one line, shortened in the middle if it is long."""
    if len(text) > 80:
        text = f'{text[:37]}...{text[-40:]}'  # the end of a path names the file
    return ' '.join(text.split())


class Infeasible(OrbimpcError):
    """No trajectory satisfies the constraints; the message names those at fault.

    Args:
        message: one line.
        proof: a ``ProofTree`` whose leaves are all infeasible, or None.
    """

    def __init__(self, message: str, proof: Any = None) -> None:
        super().__init__(message)
        self.proof = proof


class SolverFailure(OrbimpcError):
    """The solver stopped without a result that can be trusted."""
