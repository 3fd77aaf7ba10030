# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``python -m orbimpc_ros.mpc.kernels``: compile all machine code, so that no start has to wait."""

from concurrent.futures import ProcessPoolExecutor

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.proof.verify import Verifier
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.search.round_floor import RoundFloor
from orbimpc_ros.mpc.solve.place_program import PlaceProgram
from orbimpc_ros.mpc.solve.so3_multipliers import SO3Multipliers


def the_search() -> None:
    """Compile the search in the plane: half of all machine code."""
    Engine(Problem(floor=Floor('circle'), max_rate=1.0), 1e-6)


def the_rest() -> None:
    """Compile the other half."""
    RoundFloor(Problem(floor=Floor('circle')), 1e-6)
    Verifier(Problem())
    SO3Multipliers(Problem(dimension=3), beside=True)
    PlaceProgram(Problem())


PARTS = (the_search, the_rest) if COMPILED else ()

if __name__ == '__main__':
    with ProcessPoolExecutor(2) as pool:
        for part in [pool.submit(each) for each in PARTS]:
            part.result()
