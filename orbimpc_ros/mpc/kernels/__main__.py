"""``python -m orbimpc_ros.mpc.kernels``: compile the machine code now, so that no start waits."""

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.solve.annulus_newton import Circle
from orbimpc_ros.mpc.solve.hull_riccati import Hull
from orbimpc_ros.mpc.solve.polygon_bnb import Planar
from orbimpc_ros.mpc.solve.so3_multipliers import Spatial

if COMPILED:
    Hull(Problem(), 1e-6)
    Planar(Problem(floor=Floor('polygon')), 1e-6)
    Circle(Problem(floor=Floor('circle')), 1e-6)
    Spatial(Problem(dimension=3))
