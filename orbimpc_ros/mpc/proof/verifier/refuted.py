# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Refutations: that no trajectory is feasible, or that none catches its goal in the first steps.

Where nothing costs anything, the bound of whatever is feasible is at most zero: one above it
refutes. A catch at step k is a trajectory of k steps that ends within a radius of g_k, and with its
last heading inside a cone if there is one.

Derivation: docs/proofs.md.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

from .exact import ZERO
from .limits import Cone, cones
from .motion import Place
from .reading import Refused, fields, weight, whole
from .stated import StatedProblem, posed_by


def refuted_by(document: dict[str, Any], count: int) -> list[StatedProblem]:
    """Return what nothing is feasible of: catches at so many steps from the first on, or all."""
    claim, posed = document['refuted'], posed_by(document).costless
    if 'radius' not in claim:
        if 'cone' in claim or count != 1:
            raise Refused('there is a cone, or not one tree, but nothing to catch')
        return [posed]
    whole(count, 'the number of trees', 1, posed.horizon)
    radius, last = weight(claim['radius'], 'radius'), _last_cone(claim, posed.n)
    return [_catch(posed, k, radius, last) for k in range(1, count + 1)]


def _last_cone(claim: dict[str, Any], n: int) -> list[Cone]:
    """Return the cones that the last heading of a catch is in."""
    if 'cone' in claim:
        fields(claim['cone'], 'cone', ('axis', 'angle', 'least'))
    stated = [{**claim['cone'], 'steps': [1]}] if 'cone' in claim else []
    (found,) = cones(stated, n, 1)
    return found


def _catch(posed: StatedProblem, k: int, radius: Fraction, last: list[Cone]) -> StatedProblem:
    """Return the problem of a catch at step k: the first k steps, which later ones do not move."""
    held, limits = posed.limits.cones, posed.limits

    def begun(places: list[Place]) -> list[Place]:
        return [place._replace(reach=place.reach.pieces(k)[0]) for place in places[: k + 1]]

    return replace(
        posed,
        horizon=k,
        positions=begun(posed.positions),
        velocities=begun(posed.velocities),
        goals=posed.goals[:k],
        weights=posed.weights._replace(flown=[ZERO] * (k + posed.model.inertial)),
        arrives=False,
        limits=limits._replace(
            cones=[*held[: k - 1], held[k - 1] + last],
            speeds=limits.speeds[:k],
        ),
        radius=radius,
    )
