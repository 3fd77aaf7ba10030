# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Draws the pictures of docs/concepts.md, light and dark: python docs/pictures.py.

Everything in them is computed by the package, from fixed seeds.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle, Polygon
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

sys.path.append(str(Path(__file__).parents[1] / 'test'))

from scenarios import retrieval_problem, retrieved

from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.sensitivity import explained
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.tool.plot import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    RED,
    SKY,
    halo,
    in_both_looks,
    paper,
)

FOLDER = Path(__file__).parent / 'pictures'
FRACTION = np.sqrt(0.3)  # the paper's det R > 0.3
AROUND = np.linspace(0.0, 2.0 * np.pi, 400)
APART = 0.1  # between two texts


def passing() -> tuple[State, np.ndarray]:
    """Return a state and goals g_1..g_5 right behind the vehicle: it has to come round."""
    state = State.at([0.0, 0.0], np.eye(2))
    return state, np.tile([-0.2, 0.3], (5, 1))


def solved(problem: Problem) -> Plan:
    """Return the optimal plan of a problem for :func:`passing`."""
    return Solver(problem, gap_tolerance=1e-9).solve(*passing())


# --- the hull


def hull() -> Figure:
    """Return conv SO(2) with its projection, and a slice of conv SO(3)."""
    figure = Figure(figsize=(9.0, 4.2), layout='constrained')
    draw_disk_hull(figure.add_subplot(1, 2, 1))
    draw_slice(figure.add_subplot(1, 2, 2, projection='3d'))
    return figure


def draw_disk_hull(axes: Axes) -> None:
    """Draw the disk, a point in it, its rotation and its speed fraction."""
    axes.add_patch(Circle((0.0, 0.0), 1.0, color=SKY, alpha=0.25, lw=0))
    axes.plot(np.cos(AROUND), np.sin(AROUND), color=BLUE, lw=2.0)
    point = np.array([0.42, 0.36])
    rotation = point / np.linalg.norm(point)
    axes.annotate('', point, (0.0, 0.0), arrowprops={'arrowstyle': '-|>', 'color': ORANGE, 'lw': 2})
    axes.plot(*np.array([point, rotation]).T, color=INK, ls=':', lw=1.4)
    axes.plot(*point, 'o', color=ORANGE, ms=7)
    axes.plot(*rotation, 'o', color=BLUE, ms=8)
    say(axes, '$R_k e_1$: its length\nis the share\nof full speed', (0.16, 0.02), va='top')
    say(axes, 'the rotation flown', (1.22, 0.93), ha='right')
    say(axes, 'SO(2): full speed', (-1.18, 1.1), color=BLUE)
    say(axes, 'conv SO(2)', (-0.4, -0.5), ha='center')
    axes.plot(0.0, 0.0, 'o', color=INK, ms=4)
    say(axes, 'no speed', (-0.04, -0.1), ha='right')
    frame(axes, 'Rotations of the plane, and their hull', 1.25)


def draw_slice(axes) -> None:
    """Draw the diagonal matrices of conv SO(3), and those of the unit cube around."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    faces = [corners[[i for i in range(4) if i != left]] for left in range(4)]
    axes.add_collection3d(Poly3DCollection(faces, facecolor=SKY, edgecolor=BLUE, alpha=0.3, lw=1.6))
    for a in (-1, 1):
        for b in (-1, 1):
            for line in ([[-1, 1], [a, a], [b, b]], [[a, a], [-1, 1], [b, b]]):
                axes.plot(*line, color=FAINT, lw=0.8)
            axes.plot([a, a], [b, b], [-1, 1], color=FAINT, lw=0.8)
    axes.scatter(*corners.T, color=BLUE, s=45, depthshade=False)
    names = ('I', 'half turn about x', 'half turn about y', 'half turn about z')
    for corner, name in zip(corners, names, strict=True):
        x, y, z = corner
        axes.text(x, y, z + 0.25, name, ha='center', path_effects=halo(), zorder=9)
    axes.scatter(-1, -1, -1, color=RED, s=35, depthshade=False)
    axes.text(-1, -1, -0.75, '-I is out', color=RED, ha='left', path_effects=halo(), zorder=9)
    axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], zticks=[-1, 0, 1])
    axes.set(xlabel=r'$R_{11}$', ylabel=r'$R_{22}$', zlabel=r'$R_{33}$')
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_facecolor(paper())
        axis.pane.set_edgecolor(FAINT)
    axes.set_box_aspect(None, zoom=0.88)
    axes.view_init(elev=18.0, azim=-58.0)
    axes.set_title('The diagonal matrices in conv SO(3)')


# --- the floor


def floor() -> Figure:
    """Return what each floor allows, and the same plan under each."""
    figure = Figure(figsize=(9.0, 3.3), layout='constrained')
    shapes = ('none', 'polygon', 'circle')
    for axes, shape in zip(figure.subplots(1, 3), shapes, strict=True):
        draw_floor(axes, shape)
    return figure


def draw_floor(axes: Axes, shape: str) -> None:
    """Draw the disk without what a floor forbids, and R_1 e1..R_5 e1 of a plan under it."""
    problem = Problem(floor=Floor(shape, 4, float(FRACTION)))
    plan = solved(problem)
    axes.add_patch(Circle((0.0, 0.0), 1.0, color=SKY, alpha=0.3, lw=0))
    rim = np.column_stack([np.cos(AROUND), np.sin(AROUND)])
    axes.plot(*rim.T, color=BLUE, lw=1.6)
    drawn = [rim]
    if shape == 'circle':
        drawn.append(FRACTION * rim)
        axes.add_patch(Circle((0.0, 0.0), FRACTION, fc=paper(), ec=RED, lw=1.6))
    if shape == 'polygon':
        corners = FRACTION * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
        axes.add_patch(Polygon(corners, fc=paper(), ec=RED, lw=1.6))
        drawn += [along([*corners, corners[0]]), along([[0.75, 0.0], [-0.75, 0.0]])]
        drawn.append(drawn[-1][:, ::-1])  # the arrows
        for normal in normals(2, 4):
            axes.annotate(
                '', 1.3 * FRACTION * normal, FRACTION * normal,
                arrowprops={'arrowstyle': '-|>', 'color': RED},
            )  # fmt: skip
    headings = plan.rotations[:, :, 0]
    axes.plot(*headings.T, '-', color=INK, lw=1.0)
    axes.plot(*headings[1:].T, 'o', color=ORANGE, mec=INK, ms=6)
    axes.plot(*headings[0], 'o', color=paper(), mec=INK, ms=6)
    number_steps(axes, headings, np.concatenate([*drawn, along(headings)]))
    slowest = plan.speed_fraction[1:].min()
    name = {'none': 'no floor', 'polygon': 'polygon', 'circle': 'circle'}[shape]
    frame(axes, f'{name}: slowest {slowest:.2f}, cost {plan.objective:.2f}', 1.15)


def along(corners) -> np.ndarray:
    """Return points along the straight lines from corner to corner."""
    share = np.linspace(0.0, 1.0, 50)[:, None]
    return np.concatenate(
        [(1 - share) * np.array(a) + share * np.array(b) for a, b in pairwise(corners)]
    )


def number_steps(axes: Axes, headings: np.ndarray, drawn: np.ndarray) -> None:
    """Write the number of each step beside it, where least is in the way.

    Args:
        axes: to write into.
        headings: of the steps, shape (N + 1, 2).
        drawn: points on what the numbers must not touch, shape (K, 2).
    """
    near = np.linalg.norm(headings[:, None] - headings, axis=2) < 0.08
    written = np.empty((0, 2))
    for first in {int(np.argmax(each)) for each in near}:
        text = ', '.join(map(str, np.flatnonzero(near[first])))
        half = 0.033 * len(text)
        round_it = np.column_stack([(0.09 + half) * np.cos(AROUND), 0.13 * np.sin(AROUND)])
        ends = np.array([[-half, 0.0], [0.0, 0.0], [half, 0.0]])
        places = headings[first] + round_it[:, None] + ends
        room = distance(places, drawn)
        if len(written):  # two numbers side by side would read as one
            room = np.minimum(room, distance(places, written) - APART)
        room[np.abs(places).max(axis=(1, 2)) > 1.1] = 0.0  # beyond the picture
        best = places[int(np.argmax(room))]
        written = np.concatenate([written, best])
        say(axes, text, best[1], ha='center', fontsize=8)


def distance(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return how far places, shape (M, J, 2), are from the nearest of points, shape (M,)."""
    return np.linalg.norm(places[:, :, None] - points, axis=3).min(axis=(1, 2))


# --- the price


def price() -> Figure:
    """Return the cost over the floor with the price as its slope, and the prices of a flight."""
    figure = Figure(figsize=(9.0, 3.8), layout=ConstrainedLayoutEngine(wspace=0.06))
    slope, flight = figure.subplots(1, 2)
    draw_slope(slope)
    draw_prices(flight)
    return figure


def draw_slope(axes: Axes) -> None:
    """Draw the optimal cost over the fraction of the floor, and what the prices say of it."""
    fractions = np.linspace(0.3, 0.8, 21)
    of = [solved(Problem(floor=Floor('circle', fraction=float(f)))).objective for f in fractions]
    problem = Problem(floor=Floor('circle', fraction=float(FRACTION)))
    plan = solved(problem)
    prices = explained(problem, *passing(), plan).binding
    rises = total(prices, 'floor')
    near = np.array([FRACTION - 0.15, FRACTION + 0.15])
    axes.plot(fractions, of, color=BLUE, lw=2.0, label='optimal cost')
    axes.plot(near, plan.objective + rises * (near - FRACTION), color=ORANGE, lw=1.6, ls='--',
              label=f'sum of the floor\'s prices: {rises:.2f}')  # fmt: skip
    axes.plot(FRACTION, plan.objective, 'o', color=ORANGE, mec=INK, ms=7)
    axes.set(xlabel='floor.fraction', ylabel='cost', title='A price is a slope')
    axes.legend(loc='upper left')


def draw_prices(axes: Axes) -> None:
    """Draw what hull and floor cost at every tick of the retrieval, up to the capture."""
    problem, bills = retrieval_problem(), []
    for flight, tick in retrieved(problem):
        if flight.over:
            break
        prices = explained(problem, tick.state, tick.goals, tick.plan).binding
        bills.append([total(prices, name) for name in ('hull', 'floor')])
    fast, slow = np.array(bills).T
    ticks = np.arange(len(bills))
    axes.bar(ticks, fast, color=BLUE, label='hull: faster would be better')
    axes.bar(ticks, slow, bottom=fast, color=RED, label='floor: slower would be better')
    axes.set(xlabel='tick of the retrieval', ylabel='price per unit of speed fraction')
    axes.set_title('What binds on the way to the rope')
    axes.set_ylim(top=1.1 * (fast + slow).max())
    axes.legend()


def total(binding, name: str) -> float:
    """Return the sum of the prices of one kind of constraint."""
    return sum(each.price for each in binding if each.name == name)


# --- what the drawings share


def say(axes: Axes, text: str, at, **how) -> None:
    """Write a text at a point, to the right of it by default."""
    axes.text(*at, text, **{'ha': 'left', 'va': 'center', 'fontsize': 8.5} | how)


def frame(axes: Axes, title: str, half: float) -> None:
    """Show a square of the (a, b) plane about zero."""
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect='equal', title=title)
    axes.set(xlabel='a', ylabel='b', xticks=[-1, 0, 1], yticks=[-1, 0, 1])


PICTURES: dict[str, Callable[[], Figure]] = {
    'hull': hull,
    'floor': floor,
    'price': price,
}


def main(folder: Path = FOLDER) -> None:
    """Draw every picture in both looks."""
    folder.mkdir(exist_ok=True)
    for name, draw in PICTURES.items():
        for file in in_both_looks(folder / f'{name}.png'):
            draw().savefig(file)


if __name__ == '__main__':
    main()
