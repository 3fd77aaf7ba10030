# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Circular floors, without constraints that couple headings except an arrival.

The cost may depend on R e1 only. In the plane that determines R; in space the other columns are
then free, and are carried along by the shortest turns from one thrust axis to the next.

Mostly a stationary point is proved optimal by its own multipliers; otherwise the best Shor
multipliers prove it or, in the plane, bound the nodes of a best-first search over sectors of
headings. In space remaining gaps are left to the general search.

Mathematics: docs/mathematics.md, 4.4 to 4.6.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from threading import get_ident
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.rotations import carried, coordinates
from orbimpc_ros.mpc.kernels import compiled, entry_point
from orbimpc_ros.mpc.kernels.best_first import (
    CLOSED,
    DONE,
    FULL,
    LEAST,
    MADE,
    NODES,
    OPEN,
    PAUSED,
    VALUE,
    close,
    cutoff_of,
    least_left,
    leave_open,
    take,
)
from orbimpc_ros.mpc.model.condensed import Condensed, regular
from orbimpc_ros.mpc.model.dynamics import adrift, length_weights
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, NOTHING, ProofTree
from orbimpc_ros.mpc.search.engine import found_of, proof_of
from orbimpc_ros.mpc.search.relax import cost_of
from orbimpc_ros.mpc.search.ring import TURN, cut_near
from orbimpc_ros.mpc.search.shells import (
    ACTIVE,
    ARRIVED,
    Descent,
    arrive,
    descend,
    land,
    misses,
    set_out,
)
from orbimpc_ros.mpc.search.shor import (
    GOING,
    HIGH,
    KEY,
    KINDS,
    LOW,
    MU,
    PRUNED,
    TAKEN,
    Node,
    Posed,
    certify,
    climb,
    priced_branching,
    set_spread,
)
from orbimpc_ros.mpc.solve.registry import General
from orbimpc_ros.mpc.solve.request import Found, Guess, Request

# In Tree.counts: descents begun; node to start beside; its next side, and the end; next start.
STARTS, FROM, SIDE, SIDES, FIRST = range(3, 8)
PARTS = 5  # sectors that the directions of a step are split into
NARROWEST = 1e-6  # [rad], narrower sectors are not cut
NEAR = 0.2  # share of a bound's gap: climbs that cannot gain more than this end early, except
# at the root, whose point is needed as a start for descents
YOUNG, EVERY = 4, 4  # descents start from each of the first nodes, then from every 4th
MOST, ROOM = 6400, 400_000  # most nodes of a search; nodes times steps
FRUITLESS = 200  # nodes after which a search without a trajectory ends
SLICE = 3e5  # multiplications between checks of the deadline: less than a millisecond
SPACES = 4  # number of working memories that are kept
SETTLED = 90.0  # factor on the tolerance of the search
BRANCHES = 8000  # most polls of the deadline by the general search, which is then used without one
STIFF = 1e4  # weight of an arrival, in units of the largest curvature
SAME = 1e-9  # relative: costs this close to the incumbent's count as equal
OUT_OF_REACH = 1e-9  # relative margin beyond the reach


class Tree(NamedTuple):
    """A search: its M nodes, and the incumbent.

    Attributes:
        made: data of all nodes, each array with a first axis of length M.
        nodes: as in proofs (:class:`orbimpc_ros.mpc.proof.tree.ProofTree`), but with leaves not
            numbered yet, shape (M, 5).
        at: the first angle between a node's children [rad], shape (M,).
        keys: bounds of the open nodes, a heap, shape (M,).
        heap: indices of these nodes, shape (M,).
        starts: headings to descend from: the guess, and the minimiser without bounds on lengths,
            shape (2, N, n).
        descent: the current one, from a start or from beside a node.
        best: the incumbent, shape (N, n).
        counts: see the names of its entries, shape (8,).
        numbers: shape (3,).
    """

    made: Node
    nodes: np.ndarray
    at: Array
    keys: Array
    heap: np.ndarray
    starts: Array
    descent: Descent
    best: Array
    counts: np.ndarray
    numbers: Array


@lru_cache(maxsize=SPACES)
def _working_space(thread: int, nodes: int, steps: int, n: int) -> Tree:
    """Return working memory for a search, which overwrites the previous one of this thread."""
    shapes = (steps, 2), (steps, n), (KINDS, steps), (steps, n), (steps,), (n,), (3,)
    return Tree(
        Node(*(np.empty((nodes, *shape)) for shape in shapes)),
        np.zeros((nodes, 5), np.int64),
        np.zeros(nodes),
        np.empty(nodes),
        np.empty(nodes, np.int64),
        np.zeros((2, steps, n)),
        Descent(np.zeros((steps, n)), np.zeros(n), np.zeros(6)),
        np.zeros((steps, n)),
        np.zeros(8, np.int64),
        np.zeros(3),
    )


@compiled
def _node(tree, i):
    """Return a node."""
    sector, z, held, point, kept, pull, known = tree.made
    return Node(sector[i], z[i], held[i], point[i], kept[i], pull[i], known[i])


@compiled
def _take(tree, z, cost):
    """Make a trajectory the incumbent if it is better."""
    if cost < tree.numbers[VALUE]:
        tree.numbers[VALUE], tree.best[:] = cost, z


@entry_point
def _begin(posed, tree, first):
    """Begin a search with its root, and with descents from the starts of indices from ``first`` on.

    With an arrival, a trajectory that satisfies it is the first incumbent.
    """
    tree.counts[:], tree.nodes[0], tree.numbers[:] = 0, 0, np.inf
    tree.counts[MADE], tree.counts[FIRST] = 1, first
    root = _node(tree, 0)
    root.sector[:, LOW], root.sector[:, HIGH] = -np.pi, np.pi
    root.z[:], root.held[:], root.point[:], root.kept[:], root.pull[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    root.known[KEY], root.known[TAKEN], root.known[MU] = -np.inf, 0.0, 0.0
    tree.numbers[LEAST], tree.descent.numbers[ACTIVE] = -np.inf, 0.0
    leave_open(tree, 0, -np.inf, np.inf)
    z = tree.descent.z
    if posed.stiff > 0.0 and arrive(posed, z):
        _take(tree, z, cost_of(posed, z))


@compiled
def _set_out(posed, tree):
    """Begin the next descent, from beside a node or else a start; return False if none remains.

    With an arrival, the start without bounds on lengths is used only after the root is solved.
    """
    counts, descent = tree.counts, tree.descent
    given = 1 if posed.stiff > 0.0 and counts[NODES] == 0 else len(tree.starts)
    if counts[SIDE] < counts[SIDES]:
        set_spread(posed, _node(tree, counts[FROM]), counts[SIDE], descent.z)
        counts[SIDE] += 1
    elif counts[FIRST] < given:
        descent.z[:] = tree.starts[counts[FIRST]]
        counts[FIRST] += 1
    else:
        return False
    counts[STARTS] += 1
    set_out(posed, descent, tree.made.pull[counts[FROM]])
    return True


@compiled
def _descend(posed, tolerance, tree, work):
    """Descend; if that leads to a new incumbent, try to prove it optimal by its own multipliers."""
    counts, numbers, z = tree.counts, tree.numbers, tree.descent.z
    work = descend(posed, tree.descent, work)
    cost = cost_of(posed, z)
    if misses(posed, z) > ARRIVED:
        return work
    _take(tree, z, cost)
    same = SAME * abs(numbers[VALUE] + posed.constant)
    if tree.descent.numbers[ACTIVE] > 0.0 or cost > numbers[VALUE] + same:
        return work
    root = _node(tree, 0)
    before = root.known[KEY]
    cutoff = cutoff_of(numbers[VALUE], posed.constant, tolerance)
    certify(posed, z, tree.descent.pull, root, cutoff)
    key = root.known[KEY]
    if key >= cutoff:
        counts[MADE], counts[OPEN], numbers[CLOSED], tree.nodes[0] = 1, 0, key, 0
    elif counts[MADE] > 1:
        root.known[KEY] = before
    elif counts[OPEN] > 0:
        tree.keys[0] = key
    else:
        numbers[CLOSED] = key
    return work - len(z) ** 3


@compiled
def _split(tree, node, k, cutoff):
    """Create the children of a node by the directions of a step; their climbs begin at its end."""
    counts, whole = tree.counts, _node(tree, node)
    low, high = whole.sector[k, LOW], whole.sector[k, HIGH]
    angle = np.arctan2(whole.z[k, 1], whole.z[k, 0])
    every = high - low >= TURN
    parts = PARTS if every else 2
    cut = angle if every else cut_near(angle, low, high)
    first = counts[MADE]
    tree.nodes[node, 0], tree.nodes[node, 1] = ARCS if every else CUT, k
    tree.nodes[node, 2], tree.nodes[node, 3], tree.nodes[node, 4] = first, parts, -1
    tree.at[node] = cut
    for i in range(parts):
        part, tree.nodes[first + i] = _node(tree, first + i), 0
        part.sector[:], part.z[:], part.held[:] = whole.sector, whole.z, whole.held
        part.point[:], part.kept[:] = whole.point, whole.kept
        part.pull[:], part.known[:] = whole.pull, whole.known
        part.known[TAKEN] = 0.0
        if every:
            part.sector[k, LOW] = cut + i * TURN / parts
            part.sector[k, HIGH] = cut + (i + 1) * TURN / parts
        else:
            part.sector[k, HIGH if i == 0 else LOW] = cut
        leave_open(tree, first + i, part.known[KEY], cutoff)
    counts[MADE] += parts


@compiled
def _solve_node(posed, tolerance, tree, node, work):
    """Climb a node, split it, and schedule descents; return the remaining multiplications.

    Descents begin on all sides of the root, then on one side, in turn, of some nodes.
    """
    counts, near, solved = tree.counts, NEAR if node > 0 else 0.0, _node(tree, node)
    cutoff = cutoff_of(tree.numbers[VALUE], posed.constant, tolerance)
    status, work = climb(posed, solved, near, cutoff, work)
    if status == GOING:
        leave_open(tree, node, solved.known[KEY], np.inf)
        return work
    counts[NODES] += 1
    if status != PRUNED and (counts[NODES] <= YOUNG or counts[NODES] % EVERY == 0):
        sides = 2 * (len(posed.left) - 1)
        counts[FROM], counts[SIDE] = node, counts[STARTS] % sides if node > 0 else 0
        counts[SIDES] = counts[SIDE] + 1 if node > 0 else sides
    k = -1
    if len(posed.left) == 2 and solved.known[KEY] < cutoff:
        k = priced_branching(posed, solved, NARROWEST)
    if k < 0:
        close(tree, solved.known[KEY])
    else:
        _split(tree, node, k, cutoff)
    return work


@entry_point
def _search(posed, tolerance, tree, most, work):
    """Continue a best-first search.

    Args:
        posed: the problem.
        tolerance: relative gap at which to stop.
        tree: begun by :func:`_begin`; updated in place.
        most: nodes to solve in all.
        work: multiplications to do.

    Returns:
        ``DONE``; ``FULL`` if the largest number of nodes is solved; ``PAUSED`` if the work is done.
    """
    counts, numbers, status = tree.counts, tree.numbers, PAUSED
    while work > 0.0 and status == PAUSED:
        if tree.descent.numbers[ACTIVE] > 0.0:
            work = _descend(posed, tolerance, tree, work)
        elif least_left(tree) >= cutoff_of(numbers[VALUE], posed.constant, tolerance):
            status = DONE
        elif _set_out(posed, tree):
            work -= 1.0
        elif counts[OPEN] == 0:
            status = DONE
        elif counts[NODES] >= (most if numbers[VALUE] < np.inf else min(most, FRUITLESS)):
            status = FULL
        else:
            work = _solve_node(posed, tolerance, tree, take(tree), work)
    if status == PAUSED and posed.stiff > 0.0 and tree.descent.numbers[ACTIVE] > 0.0:
        z = tree.descent.z.copy()
        if land(posed, z):
            _take(tree, z, cost_of(posed, z))
    numbers[LEAST] = min(least_left(tree), numbers[VALUE])
    return status


class RoundFloor:
    """Solver of problems of rotation order 1 with a circular floor and no limit but a terminal one.

    Args:
        problem: to solve, in natural units.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    takes_guess, trusts_guess = True, False  # any starting point will do

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, SETTLED * tolerance
        self._condensed, steps, n = Condensed(problem), problem.horizon, problem.dimension
        self._hessian, self._inverse, self._excess = regular(self._condensed.hessian)
        self._lengths, arrival = length_weights(problem)[1:].astype(float), np.zeros(steps)
        self._stiff = 0.0
        if problem.terminal == 'constraint':
            arrival = problem.maps.reach[-1, 1:].copy()
            self._stiff = STIFF * float(np.diag(self._hessian).max() / np.square(arrival).max())
        self._arrival = arrival
        self._most = min(MOST, ROOM // steps) if n == 2 else 1
        self._general = General(problem, self._tolerance)
        # The first calls compile or load machine code: at start-up, not in a tick.
        known, tree = (self._arrival, np.zeros(n), self._stiff, 0.5, 0.0), self._tree()
        posed = Posed(self._hessian, np.ones((steps, n)), self._lengths, *known)
        _begin(posed, tree, 0)
        _search(posed, 1.0, tree, 1, 0.0)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return True if this method applies to a problem."""
        constrained = problem.terminal == 'constraint'
        arrives = constrained or problem.arrival_weight > 0.0
        decided = constrained and not problem.maps.reach[-1, 1:].any()  # the state decides it
        return (
            (problem.floor.shape, problem.rotation_order) == ('circle', 1)
            and not (problem.inertial and arrives)
            and not decided
            and (problem.dimension == 2 or problem.weights.input == problem.weights.attitude == 0.0)
            and not (problem.max_rate or problem.obstacles or problem.has_cones)
            and not problem.approach.exists
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the tree that proves a bound.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        posed, tolerance, tree = self._posed(request), self._tolerance, self._tree()
        n, guess = len(posed.left), request.guess
        if guess is not None:
            tree.starts[0] = guess.x[:, :n]
        tree.starts[-1] = -(self._inverse @ posed.q)  # without bounds on lengths
        _begin(posed, tree, 0 if guess is not None else 1)
        while _search(posed, tolerance, tree, self._most, SLICE) == PAUSED:
            if request.late or request.enough.met(self._found(tree, posed)):
                break
        found = replace(self._found(tree, posed), proof=self._proof(tree))
        if found.x is not None and n == 3:
            found = replace(found, x=coordinates(carried(request.state.attitude, found.x)))
        # Setting up the general search takes longer than callers with a deadline can wait.
        if found.gap <= tolerance or n == 2 or request.hurried:
            return found
        return self._by_branches(request, found)

    def _tree(self) -> Tree:
        nodes = PARTS * self._most + 2
        return _working_space(get_ident(), nodes, self._problem.horizon, self._problem.dimension)

    def _posed(self, request: Request) -> Posed:
        state, goals, problem = request.state, request.goals, self._problem
        q, constant = self._condensed.affine(state, goals)
        left = np.zeros(goals.shape[1])
        if self._stiff:
            reached = adrift(problem, state)[-1] + problem.maps.reach[-1, 0] * state.rotation[:, 0]
            left = np.asarray(goals[-1] - reached)
            reach = float(self._arrival.sum())
            if np.linalg.norm(left) > reach + OUT_OF_REACH * (reach or 1.0):
                raise Infeasible('the goal is out of reach')
        floor = float(problem.floor.fraction)
        known = self._lengths, self._arrival, left, self._stiff, floor, constant
        return Posed(self._hessian, q, *known)

    def _found(self, tree: Tree, posed: Posed) -> Found:
        return found_of(tree.best, tree.numbers, tree.counts, posed.constant, self._excess)

    def _proof(self, tree: Tree) -> ProofTree:
        made, spare = int(tree.counts[MADE]), 2.0 * self._excess / len(tree.best)
        known = tree.nodes[:made], tree.at[:made], tree.made.point[:made]
        pull = tree.made.pull[:made, None] if self._stiff else NOTHING
        return proof_of(*known, tree.made.kept[:made] - spare, pull)

    def _by_branches(self, request: Request, found: Found) -> Found:
        """Return the better of a result and that of the general search, with the higher bound."""
        guess = None if found.x is None else Guess(found.x, found.cost)
        asked = iter(range(BRANCHES))
        other = self._general.solve(
            request._replace(guess=guess, out_of_time=lambda: next(asked, None) is None)
        )
        best = other if other.cost < found.cost else found
        bound = other if other.lower_bound > found.lower_bound else found
        known = replace(best, lower_bound=bound.lower_bound, proof=bound.proof)
        return replace(known, nodes=found.nodes + other.nodes)
