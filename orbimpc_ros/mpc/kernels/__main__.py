"""``python -m orbimpc_ros.mpc.kernels``: compile the machine code now, so that no start waits."""

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.solve.annulus_newton import AnnulusNewton
from orbimpc_ros.mpc.solve.hull_riccati import HullRiccati
from orbimpc_ros.mpc.solve.polygon_bnb import PolygonSearch
from orbimpc_ros.mpc.solve.sector_bnb import SectorSearch
from orbimpc_ros.mpc.solve.so3_multipliers import SO3Multipliers

if COMPILED:
    HullRiccati(Problem(), 1e-6)
    PolygonSearch(Problem(floor=Floor('polygon')), 1e-6)
    AnnulusNewton(Problem(floor=Floor('circle')), 1e-6)
    SectorSearch(Problem(floor=Floor('circle'), max_rate=1.0), 1e-6)
    SO3Multipliers(Problem(dimension=3))
