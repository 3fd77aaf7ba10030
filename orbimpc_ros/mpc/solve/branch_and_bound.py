# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Branch and bound over regions, with a convex relaxation at each node.

Best first: the open node with the least bound is solved next, so that no node is solved whose bound
already exceeds the optimum. Until it is solved, a child has its parent's bound raised by one exact
dual step (:mod:`orbimpc_ros.mpc.solve.regions`). The search tree is also the proof.

Incumbents come from :mod:`orbimpc_ros.mpc.solve.dives`; the first one comes from the problem
without bodies, or with a turn limit in space from that in a plane
(:mod:`orbimpc_ros.mpc.solve.planar_way`).

Mathematics: docs/mathematics.md, 4.9 and 5.3.
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.proof.splits import Cut, Region
from orbimpc_ros.mpc.proof.stated import SPEEDS
from orbimpc_ros.mpc.proof.tree import CUT, ProofTree, one
from orbimpc_ros.mpc.proof.verify import Verifier
from orbimpc_ros.mpc.search.engine import TreeSearch
from orbimpc_ros.mpc.solve.dives import Dives
from orbimpc_ros.mpc.solve.place_program import PlaceProgram
from orbimpc_ros.mpc.solve.planar_way import PlanarWay
from orbimpc_ros.mpc.solve.proof_tree import Node, ProofWriter
from orbimpc_ros.mpc.solve.regions import Regions, Rows
from orbimpc_ros.mpc.solve.relaxation import Relaxation, Relaxed
from orbimpc_ros.mpc.solve.request import Found, Request, bodiless
from orbimpc_ros.mpc.solve.so3_multipliers import SO3Multipliers

NEAR = 0.05  # a dive is tried if only round floors and balls are violated, by less than this
NOTHING = 'no trajectory satisfies the constraints'
IN_PLANE = 'only paths in the plane of heading and goal were searched'
FRUITLESS = 20  # relaxations without a trajectory, after which one is found without a search
FIRST, LONGEST = 3, 30  # rounds of the search for a path that meets bodies, or none
MAX_NODES = 20_000
MAX_REFUTED = 2_000  # nodes of a search for a proof alone
HALFWAY = 50.0  # factor on the tolerance where nodes cost alike: half of a plan's gap tolerance


class BranchAndBound:
    """Solver of any problem by branch and bound, or by one relaxation without disjunctions.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
        coasting: whether states come with a ``coasted`` rotation.
        among: whether states come with hazards.
    """

    def __init__(
        self, problem: Problem, tolerance: float, *, coasting: bool = False, among: bool = False
    ) -> None:
        self.problem, self._coasting = problem, coasting
        among = among or len(problem.boxes) < len(problem.obstacles)
        rounded = problem.dimension == 3 and problem.floor.radius > 0.0
        self._plane = PlanarWay(problem, 0.5 * tolerance) if PlanarWay.leads(problem) else None
        self._beside = among or bool(problem.obstacles)
        whole = problem.dimension == 3 and problem.weighs_rotations
        # Without a floor, the relaxation of the root finds the path without bodies.
        simpler = problem.floor.exists and (self._beside or whole)
        self._alone = bodiless(problem, 0.5 * tolerance, coasting=coasting) if simpler else None
        self._lifts = whole and self._alone is not None  # its plan is not the best one yet
        turned = problem.turns_are_angles and (self._plane or self._alone) is not None
        slow = problem.has_cones or among or rounded or turned
        self.tolerance = (HALFWAY if slow else 1.0) * tolerance
        # A single relaxation needs no warm start.
        self.takes_guess = problem.floor.exists or bool(problem.obstacles) or among
        self._regions = Regions(problem)
        first, known = problem.rotation_order == 1, problem.floor.shape in SPEEDS
        touches = problem.turns_are_angles and first and known
        self._verifier = Verifier(problem) if touches else None
        spread = problem.weights.position or problem.weights.attitude or problem.obstacles or among
        self._in_plane = self._plane is not None and not spread
        if not self._in_plane:  # there, with a deadline no program is solved
            _ = self.program

    def solve(self, request: Request) -> Found:
        """Return the best trajectory and the proof; optimal unless time or nodes run out.

        Raises:
            Infeasible: no trajectory satisfies the constraints: every leaf is infeasible.
        """
        path = self._touched(request, self._path(request))
        if path.x is not None and self._in_plane and request.hurried:
            return path
        self._latest = self.begun(request)  # until the next: to free a large tree takes long
        among = traffic_of(self.problem, request.state) is not None or self._lifts
        return self._touched(request, self._latest.run(path, self._alone, among=among))

    def _touched(self, request: Request, found: Found) -> Found:
        """Return a result with the bound of the cost's tangent at its path, if that is higher."""
        if found.x is None or self._verifier is None or found.gap <= self.tolerance:
            return found
        state, goals, condensed = request.state, request.goals, self._regions.condensed
        axes = found.x[:, : goals.shape[1]]
        slope = condensed.affine(state, goals)[0] + condensed.hessian @ axes
        point = found.x if self.problem.weighs_rotations else axes
        tree = one(point, np.zeros(len(goals)), share=slope)
        bound = self._verifier.bound(state, goals, tree)
        higher = bound > found.lower_bound
        return replace(found, lower_bound=bound, proofs=(tree,)) if higher else found

    def _path(self, request: Request) -> Found:
        """Return the best path without bodies, or the first found."""
        if self._plane is not None and self._in_plane:
            return replace(self._plane.solve(request), reason=IN_PLANE)
        leading = self._plane or self._alone
        return Found() if leading is None else leading.solve(request._replace(rounds=FIRST))

    @cached_property
    def program(self) -> Relaxed:
        """Return the fastest relaxation of the problem; its machine code takes a while to load."""
        problem, coasting, beside = self.problem, self._coasting, self._beside
        if SO3Multipliers.solves(problem, beside=beside):
            return SO3Multipliers(problem, coasting=coasting, beside=beside)
        if PlaceProgram.solves(problem):
            return PlaceProgram(problem)
        from orbimpc_ros.mpc.solve.program import Program  # imports Clarabel, which is slow

        return Program(problem, coasting=coasting)

    def begun(self, request: Request) -> Search:
        """Return the search for a request."""
        self._regions.bind(request)
        return Search(self._regions, self.program, self.tolerance)


class Search:
    """One search: the open nodes, the incumbent, and the least bound of closed leaves.

    Args:
        regions: of its request.
        program: the relaxation of the problem.
        tolerance: relative gap at which the search stops.
    """

    def __init__(self, regions: Regions, program: Relaxed, tolerance: float) -> None:
        self._request, self._regions, self._tolerance = regions.request, regions, tolerance
        self._dives, self._leaves = Dives(program, regions, tolerance), ProofWriter(regions)
        self._closed = np.inf
        self._nodes = [Node(0, -np.inf, regions.root())]
        self._open = [self._nodes[0]]

    def run(self, path: Found, alone: TreeSearch | None, *, among: bool) -> Found:
        """Run the search; the first incumbents are beside paths.

        Args:
            path: that ignores bodies, or none; its bound holds among them too.
            alone: the search for that path, which goes on between nodes.
            among: whether paths are followed from the root: the best trajectory, and this one.
        """
        regions, best, root, stood_in = self._regions, self._dives, self._nodes[0], False
        if root.region is None:
            raise Infeasible(NOTHING)
        if path.x is not None:
            best.offer(path.x)
            if alone is not None and best.x is path.x and not alone.has_ended:
                path = self._onward(path, alone, LONGEST if self._request.hurried else np.inf)
        most = min(MAX_NODES, self._request.rounds)
        while self._open and max(path.lower_bound, self._open[0].bound) < self._limit:
            if best.solved >= most or (best.solved and self._request.late):
                break
            if best.solved >= FRUITLESS and best.x is None and not stood_in:
                stood_in = True
                best.stand_in()
            self._expand(heapq.heappop(self._open))
            if among and self._open:
                for x in (best.x, None if path.x is best.x else path.x):
                    if x is not None:
                        best.dive(regions.headings(x), self._rows(root))
                among = False
            if alone is not None and not alone.has_ended:
                path = self._onward(path, alone, 0.0)
        if best.x is None:
            best.recall()
        return self._found(path, alone)

    def _onward(self, path: Found, alone: TreeSearch, rounds: float) -> Found:
        """Return the path after more rounds of its search; offer it if it is cheaper."""
        longer = alone.resumed(self._request._replace(rounds=rounds))
        if longer.x is not None and longer.cost < path.cost:
            self._dives.offer(longer.x)
        return longer

    def _found(self, path: Found, alone: TreeSearch | None) -> Found:
        """Return the incumbent with the better bound and its proof: the tree's or the path's.

        Raises:
            Infeasible: every leaf is.
        """
        best, root, request = self._dives, self._nodes[0], self._request
        lower = min([self._closed, best.cost, *(node.bound for node in self._open)])
        if max(lower, root.bound) == np.inf:
            raise Infeasible(NOTHING, self._leaves.tree(self._nodes))
        if alone is not None and path.lower_bound >= lower and not path.proofs:
            path = alone.proved(request, path)
        if path.proofs and path.lower_bound >= lower:
            return replace(path, x=best.x, cost=best.cost, nodes=best.solved)
        # The root alone is the proof, if its bound is as good.
        enough = root.bound >= lower - self._tolerance * abs(lower)
        tree = self._leaves.tree(self._nodes, 1) if enough else None
        trees = [tree or self._leaves.tree(self._nodes)]
        if not enough and trees[0] and trees[0].share.size:  # multipliers of cones may not refute
            trees.append(self._leaves.tree(self._nodes, 1))
        return Found(best.x, best.cost, lower, best.solved, proofs=tuple(filter(None, trees)))

    @property
    def _limit(self) -> float:
        """Return the bound from which on nodes are not worth solving.

        A leaf closed with too wide a turn caps the bound of the tree: no other node can raise it.
        """
        if self._dives.x is None or self._regions.turns is None:
            return self._dives.cutoff
        return min(self._dives.cutoff, self._closed)

    def exceeding(self, cost: float) -> ProofTree | None:
        """Return a proof that every trajectory costs more than a value; None if none was found.

        With infinity it is a proof that there is none. No trajectory is looked for. A node with a
        lower bound is split where its solution violates a choice, or else at the widest sector,
        which ends turns that are too wide.
        """
        if self._nodes[0].region is None:
            return None
        while self._open and self._open[0].bound <= cost:
            if self._dives.solved == MAX_REFUTED or self._request.late:
                return None
            self._expand(heapq.heappop(self._open), cost)
            if self._closed < np.inf:  # below the cost
                return None
        return self._leaves.tree(self._nodes)

    def _expand(self, node: Node, cost: float | None = None) -> None:
        """Solve a node; branch on it, or offer its solution as the incumbent.

        Given a ``cost`` that bounds have to exceed, no incumbent is looked for.
        """
        regions, relaxed = self._regions, self._bounded(node)
        if relaxed.empty or (cost is not None and node.bound > cost):
            return
        if relaxed.x is None:  # neither solved nor proved infeasible
            self._close(node.bound)
            return
        headings = regions.headings(relaxed.x)
        missed, cut = regions.missed(headings), None
        if cost is None:
            self._seek(node, relaxed, headings, missed)
        # Branching may take as long as a solve. Without a cut, an imposed face is violated: the
        # solve was not accurate enough.
        if not self._request.late:
            cut = self._cut(node, missed)
        if cut is None and cost is not None and not regions.turns_in_time(headings):
            cut = regions.widest(self._region(node))
        if cut is None:
            self._close(node.bound)
        else:
            self._part(node, cut, relaxed.bound, headings[1:])

    def _bounded(self, node: Node) -> Relaxation:
        """Solve a node; keep its bound and its proof."""
        rows = self._rows(node)
        relaxed = self._dives.relax(rows)
        node.better = relaxed.empty or relaxed.bound >= node.bound
        node.bound = np.inf if relaxed.empty else max(node.bound, relaxed.bound)
        held = tuple(each for held in rows.values() for each in held)
        node.leaf = self._leaves.solved(relaxed, held, node.depth)
        return relaxed

    def _seek(
        self, node: Node, relaxed: Relaxation, headings: Array, missed: dict[int, float]
    ) -> None:
        """Offer a solution that meets all choices as the incumbent; dive from any other one."""
        dives, regions = self._dives, self._regions
        if not missed:
            assert relaxed.x is not None
            dives.offer(relaxed.x)
            if relaxed.is_accurate and regions.turns_in_time(headings):
                return
        dives.recall()
        # Only round floors and balls are violated, and by little.
        nearly = all(regions.is_round(c) and by < NEAR for c, by in missed.items())
        if nearly or dives.x is None:
            dives.dive(headings, self._rows(node))

    def _rows(self, node: Node) -> Rows:
        """Return the half-spaces of a node, by choice."""
        if node.rows is None:
            regions, above, region = self._regions, node.above, self._region(node)
            if above is None or above.cut is None:
                node.rows = regions.every(region)
            elif above.cut.kind == CUT:  # turns may carry it to other headings
                node.rows = self._rows(above) | regions.changed(self._region(above), region)
            else:
                node.rows = self._rows(above) | {above.cut.choice: node.own}
        return node.rows

    def _region(self, node: Node) -> Region:
        """Return the region of a node that is not empty."""
        assert node.region is not None
        return node.region

    # --- branching

    def _cut(self, node: Node, missed: dict[int, float]) -> Cut | None:
        """Return the split of the choice that promises the greatest bound; None without one."""
        regions, region = self._regions, self._region(node)
        promises = {c: (regions.promise(c, by), by) for c, by in missed.items()}
        ranked = sorted(missed, key=promises.__getitem__, reverse=True)
        cuts = (regions.cut(choice, region) for choice in ranked)
        return next((cut for cut in cuts if cut is not None), None)

    def _part(self, node: Node, cut: Cut, dual_value: float, headings: Array) -> None:
        """Create the children of a node and open those that are neither empty nor pruned.

        Args:
            node: the node to split.
            cut: the split of one of its choices.
            dual_value: of its solution, from which the gains of the children are counted.
            headings: of the solution, shape (N, n).
        """
        regions, choice = self._regions, cut.choice
        node.cut, node.first = cut, len(self._nodes)
        for i in range(cut.parts):
            region = regions.part(self._region(node), cut, i)
            part = Node(node.first + i, node.bound, region, node)
            self._nodes.append(part)
            if region is None:
                continue
            side = regions.side(choice, region)
            part.own = regions.held(choice, side)
            gain, part.refuted = regions.gain(choice, side, headings)
            part.bound = max(node.bound, dual_value + gain)
            if part.refuted >= 0:
                continue
            if part.bound >= self._dives.cutoff:
                self._close(part.bound)
            else:
                heapq.heappush(self._open, part)

    def _close(self, bound: float) -> None:
        """Record the bound of a node that is not searched any further."""
        self._closed = min(self._closed, bound)
