# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Problems with fewer limits: whatever is proved of them holds of those with all.

Certificates state every limit. What the verifier has no use for, it leaves out; so may who makes
them.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from dataclasses import replace

from orbimpc_ros.mpc.problem import Ball, Floor, Problem, State


def with_statable_limits(problem: Problem, state: State) -> tuple[Problem, State]:
    """Return a problem, and what moves, with those limits only that refutations are made with."""
    floor, planar = problem.floor, problem.dimension == 2
    known = floor.shape in (('circle', 'polygon') if planar else ('circle',))
    if not known or problem.rotation_order == 2:
        floor = Floor()
    rated = problem.rotation_order == 1 and (planar or not problem.floor.exists)
    rate = problem.max_rate if rated and floor.exists == problem.floor.exists else 0.0
    # Who is below a floor changes speed from there on.
    paced = problem.rotation_order == 1 and floor.exists == problem.floor.exists
    pace = problem.max_acceleration if paced else 0.0
    bodies = tuple(each for each in problem.obstacles if planar or not isinstance(each, Ball))
    moving = tuple(each for each in state.hazards if planar or not isinstance(each.body, Ball))
    fewer = replace(problem, floor=floor, max_rate=rate, max_acceleration=pace, obstacles=bodies)
    return fewer, replace(state, hazards=moving)
