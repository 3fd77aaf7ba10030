# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Whether a certificate proves its lower bound: in exact arithmetic, from the standard library.

    python -m verifier CERTIFICATE.json

Nothing else of the package is imported, so that this folder can be copied and read by itself.
Numbers of the file are doubles, and sums and products of them are exact: whole numbers over one
denominator. Square roots, sines and cosines are bracketed, and the side taken on which a bound gets
worse; where least values are counted in units of 2^-160, they are rounded down.

A bound rests on three facts. (1) The cost without lengths, f, is a sum of squares of affine
functions: it is convex, and so is f_t(x) = f(x) + sum_k t_k |x_k|^2 / 2 where its matrix is
positive semidefinite; any tangent of it is a lower bound. (2) What is left of the cost, lengths and
-t_k |x_k|^2 / 2, and the tangent are sums over steps: their least value over the sets C_k that the
x_k are in is a sum of least values, each known in closed form. (3) Splits are exhaustive: whatever
a trajectory does, it is in one of the parts; a floor's faces, the directions below and above an
angle, or the sides of a body. The bound of a split is the least of its parts'.

Where nothing is feasible, or nothing catches a goal, a bound above zero of what costs nothing says
so (``refuted``).

What has to be believed: (1) is ``cost`` and ``bound``, (2) ``least``, (3) ``splits``, with what
``walls`` says of their sides. ``exact`` has the brackets; ``reading``, ``stated``, ``limits`` and
``regions`` say what a file means.

Format and derivation: docs/proofs.md.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, NamedTuple

from .bound import bounds
from .exact import rounded_down
from .reading import Refused, Work, fields, items, number, parsed, read
from .refuted import refuted_by
from .stated import posed_by

__all__ = [
    'FORMAT', 'RELATIVE', 'Refused', 'Verdict',
    'parsed', 'posed_by', 'read', 'refuted_by', 'verified',
]  # fmt: skip

FORMAT = 'orbimpc certificate 1'
RELATIVE = Fraction(1, 10**9)  # by which a published bound may exceed what is proved


class Verdict(NamedTuple):
    """What a certificate comes to.

    Attributes:
        claimed: the bound that was published; of refutations infinity, where nothing is feasible,
            or else the end of the first step that may have a catch [s].
        proved: the bound that holds, rounded down.
        leaves: how many bounds it is the least of.
        holds: whether what was published exceeds what holds by no more than 1e-9 of it; of
            refutations, whether each does refute.
    """

    claimed: float
    proved: float
    leaves: int
    holds: bool


def verified(document: Any) -> Verdict:
    """Return what a certificate, as JSON has it, comes to.

    Raises:
        Refused: it is malformed, or not sound whatever the bound.
    """
    refutes = isinstance(document, dict) and 'refuted' in document
    claim = ('refuted',) if refutes else ('lower_bound', 'tree')
    fields(document, 'certificate', ('format', 'problem', 'state', 'goals', *claim),
           ('limits', 'origins'))  # fmt: skip
    if document['format'] != FORMAT:
        raise Refused(f'format is not {FORMAT!r}')
    work = Work(document)
    return _refuting(document, work) if refutes else _bounding(document, work)


def _refuting(document: dict[str, Any], work: Work) -> Verdict:
    claim, origins = document['refuted'], document.get('origins')
    fields(claim, 'refuted', ('trees',), ('radius', 'cone'))
    trees = items(claim['trees'], 'trees')
    problems, found = refuted_by(document, len(trees)), []
    for posed, tree in zip(problems, trees, strict=True):
        begun = origins and items(origins, 'origins')[: posed.horizon]
        found.append(bounds(posed, tree, begun, work))
    whole = next((k for k, each in enumerate(found) if min(each) <= 0), len(found))
    leaves, holds = sum(map(len, found)), whole == len(found)
    if 'radius' not in claim:
        return Verdict(math.inf, math.inf if holds else 0.0, leaves, holds)
    claimed, proved = ((k + 1) * problems[0].model.step for k in (len(found), whole))
    return Verdict(rounded_down(claimed), rounded_down(proved), leaves, holds)


def _bounding(document: dict[str, Any], work: Work) -> Verdict:
    posed = posed_by(document)
    claimed = number(document['lower_bound'], 'lower_bound')
    found = bounds(posed, document['tree'], document.get('origins'), work)
    proved = min(found)
    holds = claimed <= 0 or proved >= claimed - RELATIVE * claimed  # no term of the cost is < 0
    return Verdict(float(claimed), rounded_down(proved), len(found), holds)
