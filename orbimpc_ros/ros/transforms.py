# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Transforms between frames, from ``/tf`` or parameters.

A transform is a matrix, shape (4, 4), that maps points of a child frame to its parent. Those of
``/tf_static`` and of parameters are permanent; those of ``/tf`` hold for their stamps, interpolated
in between, and for a while after the last one. Only the order of messages matters, not their time
of arrival, so that a recording gives the same results without tf2's buffer, which PyPI lacks.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from geometry_msgs.msg import Transform
from std_msgs.msg import Header

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, log
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND

TF, TF_STATIC = '/tf', '/tf_static'
MOST_SAMPLES = 4096  # kept of each transform
MOST_FRAMES = 1024
AHEAD = 10.0  # [s] of the clock: localisation stamps its transforms with the end of their validity
ON = 'set tf: true, or give transforms'
FORM = "'parent child x y z roll pitch yaw', six finite numbers [m, rad]"


@dataclass(eq=False)
class Edge:
    """The transform of a frame to its parent."""

    parent: str
    child: str
    fixed: bool  # whether it is permanent
    samples: list[tuple[int, Transform]] = field(default_factory=list)  # with stamps [ns], in order

    def at(self, stamp: int, patience: float) -> Array:
        """Return the matrix at a stamp [ns]; the latest one for a stamp of 0, as in tf2.

        Raises:
            BadInput: the stamp is before the first sample or too long after the last, or the
                transform is not valid.
        """
        name = f'{self.parent} -> {self.child}'
        if self.fixed or not stamp:
            stamp = self.samples[-1][0]
        k = bisect_right(self.samples, stamp, key=lambda sample: sample[0])
        if k == 0:
            before = (self.samples[0][0] - stamp) / SECOND
            problem = f'{name} is known only from {before:.3g} s later on'
            hint = 'give stamps within its history'
            raise BadInput.stating('extrapolated transform', problem, hint)
        around = self.samples[k - 1 : k + 1]
        earlier, *later = (matrix(*messages.read_transform(each, name)) for _, each in around)
        since = stamp - around[0][0]
        if later:
            return between(earlier, later[0], since / (around[1][0] - around[0][0]))
        if since > patience * SECOND:
            problem = f'{name} is {since / SECOND:.3g} s older than the message'
            hint = f'at most transform_timeout, {patience:g} s'
            raise BadInput.stating('stale transform', problem, hint)
        return earlier


def stated(lines: Iterable[str]) -> dict[str, Edge]:
    """Return the transforms of lines ``parent child x y z roll pitch yaw`` [m, rad], by child.

    Raises:
        BadInput: a wrong number of words, an invalid number, or a child with two parents.
    """
    edges: dict[str, Edge] = {}
    for line in lines:
        try:
            parent, child, *pose = line.split()
            numbers = np.array(pose, dtype=float)
        except ValueError:  # too few words, or none of a number
            raise BadInput('transforms', line, FORM) from None
        if parent == child or numbers.shape != (6,) or not np.isfinite(numbers).all():
            raise BadInput('transforms', line, FORM)
        if child in edges:
            raise BadInput('transforms', line, f'one parent of {child}')
        roll, pitch, yaw = (exp(turn) for turn in np.diag(numbers[3:]))
        turned = messages.quaternion(yaw @ pitch @ roll)
        transform = Transform(translation=messages.vector(numbers[:3]), rotation=turned)
        edges[child] = Edge(parent, child, True, [(0, transform)])
    return edges


def matrix(rotation: Array, translation: Array) -> Array:
    """Return a rotation, shape (3, 3), and a translation, shape (3,) [m], as one matrix."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    return transform


def between(first: Array, then: Array, share: float) -> Array:
    """Return the transform interpolated between two, at a share of the way."""
    turn = log(first[:3, :3].T @ then[:3, :3])
    shift = then[:3, 3] - first[:3, 3]
    return matrix(first[:3, :3] @ exp(share * turn), first[:3, 3] + share * shift)


class Transforms:
    """The known transforms.

    Attributes:
        settings: of the planner.
    """

    def __init__(self, settings: Any) -> None:
        self._edges: dict[str, Edge] = {}
        self.settings = settings

    def forget(self) -> None:
        """Forget all transforms except permanent ones."""
        self._edges = {child: each for child, each in self._edges.items() if each.fixed}

    def hear(self, link: Any, stamp: int, *, fixed: bool) -> None:
        """Take in a TransformStamped, permanent or for a stamp [ns]; an older one is ignored.

        Raises:
            BadInput: it has no valid frames, or there are too many.
        """
        parent, child = link.header.frame_id, link.child_frame_id
        length = len(parent + child)
        if not parent or not child or parent == child or length > messages.LONGEST_FRAME:
            raise BadInput('frames', f'{parent!r} and {child!r}', 'two different short names')
        edge = self._edges.get(child)
        if edge is None and len(self._edges) >= MOST_FRAMES:
            raise BadInput('frames', 'one more', f'at most {MOST_FRAMES}')
        if edge is None or fixed or edge.fixed or edge.parent != parent:
            edge = self._edges[child] = Edge(parent, child, fixed)
        if not edge.samples or stamp > edge.samples[-1][0]:
            edge.samples.append((stamp, link.transform))
            del edge.samples[:-MOST_SAMPLES]

    def move(self, header: Header, at: int | None = None) -> Array | None:
        """Return the matrix from the frame of a header to the world; None if that is its frame.

        ``at`` is the time of the transform [ns], by default the stamp of the header.

        Raises:
            BadInput: no transform leads there, or none at that time, or the stamp is not valid.
        """
        world, frame = self.settings.frames.world, header.frame_id
        if not world or frame in ('', world):
            return None
        if not (self.settings.tf or self.settings.stated_transforms):
            raise BadInput('header.frame_id', repr(frame), f'{world!r}; for others, {ON}')
        stamp = messages.nanoseconds(header.stamp, 'header.stamp') if at is None else at
        up, down = self._ancestry(frame), self._ancestry(world)
        ends = (line[-1].parent if line else end for line, end in ((up, frame), (down, world)))
        if len(set(ends)) > 1:
            hint = 'publish it on /tf, or give it in transforms' if self.settings.tf else ON
            raise BadInput.stating('missing transform', f'none from {frame} to {world}', hint)
        while up and down and up[-1] is down[-1]:  # above what they have in common
            del up[-1], down[-1]
        moves = [np.eye(4), np.eye(4)]
        for k, line in enumerate((up, down)):
            for edge in line:
                moves[k] = edge.at(stamp, self.settings.transform_timeout) @ moves[k]
        return np.asarray(np.linalg.solve(moves[1], moves[0]))

    def _ancestry(self, frame: str) -> list[Edge]:
        """Return the transforms from a frame up to the root; a cycle is followed only once."""
        ancestry, edges = list[Edge](), self._edges | self.settings.stated_transforms
        while frame in edges and edges[frame] not in ancestry:
            ancestry.append(edges[frame])
            frame = edges[frame].parent
        return ancestry
