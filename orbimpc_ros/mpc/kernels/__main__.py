# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``python -m orbimpc_ros.mpc.kernels``: compile all machine code, so that no start has to wait."""

from concurrent.futures import ProcessPoolExecutor

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.proof.verify import Verifier
from orbimpc_ros.mpc.search.engine import PlanarSearch
from orbimpc_ros.mpc.search.round_floor import RoundFloor
from orbimpc_ros.mpc.solve.place_program import PlaceProgram
from orbimpc_ros.mpc.solve.so3_multipliers import SO3Multipliers


def first_half() -> None:
    """Compile the search in the plane, what verifies bounds, and programs among bodies."""
    PlanarSearch(Problem(floor=Floor('circle'), max_rate=1.0), 1e-6)
    Verifier(Problem())
    PlaceProgram(Problem())


def second_half() -> None:
    """Compile the search for round floors, and programs over SO(3)."""
    RoundFloor(Problem(floor=Floor('circle')), 1e-6)
    SO3Multipliers(Problem(dimension=3), beside=True)


PARTS = (first_half, second_half) if COMPILED else ()

if __name__ == '__main__':
    with ProcessPoolExecutor(2) as pool:
        for part in [pool.submit(each) for each in PARTS]:
            part.result()
