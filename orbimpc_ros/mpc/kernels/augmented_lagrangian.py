# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The relaxation over SO(3) by the method of multipliers, with Newton steps.

With positions eliminated, the problem is a strictly convex quadratic in R_1..R_N (nine coordinates
each), whose Hessian is the same N x N matrix for every coordinate of R_k e1, and another one for
every coordinate of the other two columns. Its additional terms are

- R_k in conv SO(3): S(R_k) >= 0, with a multiplier matrix L_k >= 0;
- c_k |R_k e1|, the length: the maximum of w . R_k e1 over |w| <= c_k;
- rows a . v >= b, with multipliers >= 0, on R_k e1 and on positions, which are linear in all R_j
  e1. If the body rate decides R_1 up to its thrust fraction rho, two of them are 0 <= rho <= 1.

The augmented Lagrangian replaces each by its Moreau envelope of parameter 1/sigma (see
:mod:`~orbimpc_ros.mpc.kernels.penalty_terms`). It is convex and once differentiable; its
generalised Hessian is the quadratic's plus a few columns for each active constraint, so a Newton
step solves a system of the size of these (Woodbury), not of the problem. Near the minimiser the
projections become the multipliers, and sigma grows (Rockafellar's method of multipliers; Zhao, Sun
and Toh, *A Newton-CG augmented Lagrangian method for semidefinite programming*).

The multipliers are always feasible, so the dual function at them is always a lower bound: L(x,
multipliers) - 1/2 r . P r, where r is the residual gradient and P the inverse Hessian on the
directions that a terminal constraint leaves free.

Mathematics: docs/mathematics.md, 4.7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled, entry_point, vectorised
from orbimpc_ros.mpc.kernels.linear import copy_to, refutes, solve_spd
from orbimpc_ros.mpc.kernels.penalty_terms import (
    TermMultipliers,
    inner,
    project,
    set_columns,
    set_forces,
)

SETTLED, STALLED, PAUSED, REFUTED, GOING = range(5)  # outcomes of a minimisation
SIGMA, BEST, PROMISED = range(3)  # in Iterate.numbers
STEPS, TAKEN = range(2)  # in Iterate.counts

LIMIT = 200  # most Newton steps and updates of the multipliers
NOTHING = 1e-18  # a minimum is near enough if no more than this can be gained
WARM = 30.0  # factor on the initial sigma if the initial multipliers are useful
ENOUGH = 1e-2  # a minimum is near enough at this share of the gain by the multipliers
HALVINGS = 30
DESCENT = 1e-4  # share of a Newton step's predicted decrease that a step must achieve
ROUNDING = 1e-13
GROWTH = 3.0
QUICK, SLOW, STUCK = 2, 6, 15  # Newton steps up to which sigma grows fast, grows, stays


class Iterate(NamedTuple):
    """A minimisation that can be interrupted.

    Attributes:
        x: the iterate, x_0 - P F, shape (N, 9).
        held: the force F of the held multipliers, shape (N, 9).
        numbers: sigma, the penalty's parameter; the greatest lower bound; the decrease of the merit
            predicted by the last Newton step, shape (3,).
        counts: steps and updates made; Newton steps since sigma last changed, shape (2,).
    """

    x: Array
    held: Array
    numbers: Array
    counts: np.ndarray


@compiled
def apply(terms, force, out):
    """Set ``out`` to P times a force, the response of the quadratic.

    Args:
        terms: give P.
        force: shape (n, 9).
        out: shape (n, 9).
    """
    n, inverse = len(force), terms.inverse
    slid = inner(force, terms.slide)
    for k in range(n):
        for c in range(9):
            out[k, c] = slid * terms.slide[k, c]
        for j in range(n):
            first, others = inverse[0, k, j], inverse[1, k, j]
            for c in range(3):
                out[k, c] += first * force[j, c]
            for c in range(3, 9):
                out[k, c] += others * force[j, c]


@vectorised
def _set_gram(inverse, slide, step, column, weight, count, slid, matrix):
    """Set the lower triangle of a Newton system's matrix, C^-1 + U'P U, U the columns."""
    for i in range(count):
        k = step[i]
        along = 0.0
        for c in range(9):
            along += column[i, c] * slide[k, c]
        slid[i] = along
        for j in range(i + 1):
            first = others = 0.0
            for c in range(3):
                first += column[i, c] * column[j, c]
            for c in range(3, 9):
                others += column[i, c] * column[j, c]
            near = step[j]
            matrix[i, j] = (
                first * inverse[0, k, near] + others * inverse[1, k, near] + along * slid[j]
            )
        matrix[i, i] += 1.0 / weight[i]


@compiled
def _newton(terms, residual, moved_by, count, work, force):
    """Set ``force`` to that of a Newton step: residual - U (C^-1 + U'P U)^-1 U'P residual.

    By Woodbury's identity the system has only the size of the active constraints.

    Args:
        terms: give P.
        residual: the residual gradient, shape (n, 9).
        moved_by: P times that, shape (n, 9).
        count: number of columns of U.
        work: holds U, and C in ``weight``.
        force: to be set, shape (n, 9).

    Returns:
        False if the system is singular.
    """
    _set_gram(
        terms.inverse, terms.slide, work.step, work.column, work.weight, count, work.slid,
        work.matrix,
    )  # fmt: skip
    n = len(residual)
    for i in range(count):
        total = 0.0
        for k in range(n):
            share = terms.shares[work.step[i], k]
            if share != 0.0:
                for c in range(9):
                    total += share * work.column[i, c] * moved_by[k, c]
        work.solution[i] = total
    if not solve_spd(work.matrix, work.solution, count):
        return False
    copy_to(force, residual)
    for i in range(count):
        for k in range(n):
            share = terms.shares[work.step[i], k] * work.solution[i]
            if share != 0.0:
                for c in range(9):
                    force[k, c] -= share * work.column[i, c]
    return True


@compiled
def _begin(terms, start, held, force, x, work):
    """Set x to the minimiser for the held multipliers; reset these if zeros are better.

    Returns the dual function there, relative to the cost of ``start``: a lower bound.
    """
    work.bases[:] = 0.0
    for i in range(4):
        work.bases[:, i, i] = 1.0
    least = set_forces(terms, held, force)
    apply(terms, force, x)
    least += inner(force, start) - 0.5 * inner(force, x)
    copy_to(x, start - x)
    if least < 0.0:
        held.orbitopes[:], held.lengths[:], held.rows[:] = 0.0, 0.0, 0.0
        copy_to(x, start)
        force[:], least = 0.0, 0.0
    _note(work, x, force, held)
    return least


@compiled
def _note(work, lowest, forces, held):
    """Store the point and the multipliers of the greatest bound so far."""
    copy_to(work.lowest, lowest)
    copy_to(work.forces, forces)
    copy_to(work.pushes, held.lengths)
    copy_to(work.rows[: len(held.rows)], held.rows)


@compiled
def stiffen(progress, near, largest):
    """Set the next sigma, after Newton steps came near a minimum or were given up.

    Args:
        progress: updated in place.
        near: whether they came near.
        largest: largest value of sigma.
    """
    sigma, taken = progress.numbers[SIGMA], progress.counts[TAKEN]
    if not near:
        sigma /= GROWTH * GROWTH
    elif taken <= QUICK:
        sigma = min(largest, sigma * GROWTH * GROWTH)
    elif taken <= SLOW:
        sigma = min(largest, sigma * GROWTH)
    progress.numbers[SIGMA] = sigma
    progress.numbers[PROMISED], progress.counts[TAKEN] = np.inf, 0


@compiled
def _ended(terms, quadratic, worst, budget, limits, progress, new, work):
    """Return the outcome of a minimisation, ``GOING`` if it is to continue; see `minimise`.

    Args:
        terms: see there, as for the others.
        quadratic: cost of the iterate without lengths, relative to that of the start.
        worst: violation of a constraint there.
        budget: multiplications left.
        limits: see there.
        progress: see there.
        new: multipliers of the last projection.
        work: see there.
    """
    precision, proportion, least, rounding, _ = limits
    numbers, counts, x, cost = progress.numbers, progress.counts, progress.x, quadratic
    for k in range(len(x)):
        if terms.lengths[k] > 0.0:
            cost += terms.lengths[k] * np.sqrt(x[k, 0] ** 2 + x[k, 1] ** 2 + x[k, 2] ** 2)
    gap = abs(cost - numbers[BEST])
    if worst <= precision and gap <= proportion * abs(least + cost) + rounding:
        return SETTLED
    rows = terms.places, terms.normals, terms.offsets
    if len(terms.shares) > len(x) and refutes(terms.shares, rows, new.rows):
        numbers[BEST] = np.inf
        copy_to(work.rows[: len(new.rows)], new.rows)
        return REFUTED
    if counts[STEPS] >= LIMIT:
        return STALLED
    return PAUSED if budget <= 0.0 else GOING


@entry_point
def minimise(terms, start, held, limits, work, progress, budget):
    """Continue to minimise quadratic and terms, by the method of multipliers.

    Each augmented Lagrangian is minimised by Newton's method.

    Args:
        terms: added to the quadratic.
        start: x_0, its minimiser subject to the terminal constraint, shape (n, 9).
        held: the multipliers, updated in place.
        limits: largest violation of a constraint; largest gap, relative to the cost; the cost of
            x_0; its rounding error; the largest sigma.
        work: working memory; the point and multipliers of the greatest bound are stored in it.
        progress: updated in place.
        budget: multiplications to do; one Newton step is done at least.

    Returns:
        ``SETTLED``, ``STALLED``, ``PAUSED``, or ``REFUTED`` if infeasibility is proved.
    """
    largest, (x, held_force, numbers, counts) = limits[4], progress
    trial, direction, force = np.empty_like(start), np.empty_like(start), np.empty_like(start)
    residual, change = np.empty_like(start), np.empty_like(start)
    new = TermMultipliers(held.orbitopes.copy(), held.lengths.copy(), held.rows.copy())
    if counts[STEPS] == 0:
        numbers[BEST] = _begin(terms, start, held, held_force, x, work)
        if numbers[BEST] > 0.0:
            numbers[SIGMA] *= WARM
    value, moved, worst = project(terms, x, held, numbers[SIGMA], new, force, work)
    while True:
        # The residual gradient is force - F.
        copy_to(residual, force - held_force)
        apply(terms, residual, direction)
        left = inner(residual, direction)
        quadratic = 0.5 * inner(held_force, start - x)
        bound = quadratic + value - 0.5 * left
        if bound > numbers[BEST]:
            numbers[BEST] = bound
            _note(work, x - direction, force, new)
        status = _ended(terms, quadratic, worst, budget, limits, progress, new, work)
        if status != GOING:
            return status
        counts[STEPS] += 1
        near = min(left, numbers[PROMISED]) <= max(NOTHING, ENOUGH * moved / numbers[SIGMA])
        if near or counts[TAKEN] == STUCK:
            if near:  # hold the multipliers of the last projection
                copy_to(held.orbitopes, new.orbitopes)
                copy_to(held.lengths, new.lengths)
                copy_to(held.rows, new.rows)
            stiffen(progress, near, largest)
            value, moved, worst = project(terms, x, held, numbers[SIGMA], new, force, work)
            continue
        counts[TAKEN] += 1
        count = set_columns(terms, x, held, numbers[SIGMA], new, work)
        budget -= count * count * (count / 6.0 + 9.0) + 40.0 * len(x) ** 2 + 500.0 * len(x)
        if not _newton(terms, residual, direction, count, work, change):
            return STALLED
        apply(terms, change, direction)
        bend, pull = inner(change, direction), inner(held_force, direction)
        numbers[PROMISED] = inner(residual, direction)
        merit = quadratic + value - 0.5 * moved / numbers[SIGMA]
        share = 1.0
        for _ in range(HALVINGS):
            copy_to(trial, x - share * direction)
            value, moved, worst = project(terms, trial, held, numbers[SIGMA], new, force, work)
            reached = quadratic + share * (pull + 0.5 * share * bend) + value
            reached -= 0.5 * moved / numbers[SIGMA]
            enough = DESCENT * share * numbers[PROMISED]  # Armijo's rule
            if reached <= merit - enough + ROUNDING * (1.0 + abs(merit)):
                break
            share *= 0.5
        copy_to(x, trial)
        held_force += share * change
