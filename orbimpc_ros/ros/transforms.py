# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Frames to one another: what ``/tf`` and stated transforms tell, and messages moved by them.

A transform says how a child frame lies in its parent: p_parent = R p_child + t. Those of
``/tf_static`` and those that are stated hold for ever. Those of ``/tf`` hold for their stamps, in
between (interpolated) and for a while after the last one; before the first one nothing is known.
Nothing here depends on when a message came, but for the order of messages, so that a recording
shows the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Pose
from std_msgs.msg import Header

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, log
from orbimpc_ros.ros.messages import (
    SECOND,
    Frames,
    header,
    nanoseconds,
    pose,
    read_sighting,
    read_transform,
)

TF, TF_STATIC = '/tf', '/tf_static'
KEPT = 10 * SECOND  # [ns] of each transform of /tf, as tf2 does
MOST_SAMPLES = 4096  # of each transform
MOST_FRAMES = 1024
ON = 'tf: true (of /tf) or transforms (stated)'


@dataclass(frozen=True)
class Rigid:
    """How a frame lies in another.

    Attributes:
        rotation: shape (3, 3).
        translation: shape (3,) [m].
    """

    rotation: Array
    translation: Array

    def __matmul__(self, other: Rigid) -> Rigid:
        """Return how a frame lies that is ``other`` in this one."""
        return Rigid(self.rotation @ other.rotation, self.placed(other.translation))

    def placed(self, position: Array) -> Array:
        """Return a position, shape (3,) [m], of the frame in the other."""
        return np.asarray(self.rotation @ position + self.translation)

    @property
    def inverse(self) -> Rigid:
        """Return how the other frame lies in this one."""
        return Rigid(self.rotation.T, -self.rotation.T @ self.translation)

    def towards(self, other: Rigid, share: float) -> Rigid:
        """Return what is a share of the way to another: even turn, straight line."""
        turn = log(self.rotation.T @ other.rotation)
        way = other.translation - self.translation
        return Rigid(self.rotation @ exp(share * turn), self.translation + share * way)


IDENTITY = Rigid(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Stated:
    """A transform that is stated, and holds for ever.

    Attributes:
        parent: frame.
        child: frame.
        rigid: how the child lies in the parent.
    """

    parent: str
    child: str
    rigid: Rigid


def stated(words: str) -> Stated:
    """Return the transform that ``parent child x y z roll pitch yaw`` states [m], [rad].

    Raises:
        BadInput: too few words or too many, or a number that is none.
    """
    form = "'parent child x y z roll pitch yaw', six finite numbers [m, rad]"
    parent, child, *rest = words.split() if len(words.split()) == 8 else ['', '']
    try:
        numbers = np.array([float(each) for each in rest])
    except ValueError:
        raise BadInput('transforms', words, form) from None
    if parent == child or not np.isfinite(numbers).all():
        raise BadInput('transforms', words, form)
    roll, pitch, yaw = (exp(turn) for turn in np.diag(numbers[3:]))
    return Stated(parent, child, Rigid(yaw @ pitch @ roll, numbers[:3]))


class Placed(NamedTuple):
    """A pose moved to another frame, with the fields of a stamped message that are read."""

    header: Header
    pose: Pose


class PlacedPath(NamedTuple):
    """A path moved to another frame, with the fields of a nav_msgs/Path that are read."""

    header: Header
    poses: list[Placed]


@dataclass
class _Edge:
    """What is known of how a frame lies in its parent.

    Attributes:
        parent: frame.
        fixed: how, if it holds for ever.
        samples: else how at stamps [ns], as geometry_msgs/Transform, the latest last.
    """

    parent: str
    fixed: Rigid | None = None
    samples: deque[tuple[int, Any]] = field(default_factory=lambda: deque(maxlen=MOST_SAMPLES))

    def note(self, stamp: int, transform: Any) -> None:
        """Take in a sample, if it is later than the last."""
        if self.samples and stamp <= self.samples[-1][0]:
            return
        self.samples.append((stamp, transform))
        while stamp - self.samples[0][0] > KEPT:
            self.samples.popleft()

    def at(self, stamp: int, patience: float, name: str) -> Rigid:
        """Return how it lies at a stamp [ns]; at its latest for a stamp of 0, as in tf2.

        Raises:
            BadInput: the stamp is before the first sample or too long after the last.
        """
        if self.fixed is not None:
            return self.fixed
        later = None
        for at, transform in reversed(self.samples):
            if at <= stamp or stamp == 0:
                return self._between((at, transform), later, stamp, patience, name)
            later = at, transform
        before = (self.samples[0][0] - stamp) / SECOND
        problem = f'{name} is known from {before:.3g} s later on only'
        raise BadInput.stating('extrapolated transform', problem, 'give stamps within its history')

    @staticmethod
    def _between(
        first: tuple[int, Any], then: tuple[int, Any] | None, stamp: int, patience: float, name: str
    ) -> Rigid:
        (at, transform), age = first, (stamp - first[0]) / SECOND
        begin = Rigid(*read_transform(transform, name))
        if then is not None and stamp:
            end = Rigid(*read_transform(then[1], name))
            return begin.towards(end, (stamp - at) / (then[0] - at))
        if age > patience:
            problem = f'{name} is {age:.3g} s older than the message'
            raise BadInput.stating(
                'stale transform', problem, f'at most transform_timeout, {patience:g} s'
            )
        return begin


class Transforms:
    """The frames that are known, and messages moved from one to another.

    Args:
        stated: transforms that hold for ever.
        patience: for how long the last of ``/tf`` holds [s].
        listening: whether ``/tf`` is heard.
    """

    def __init__(self, stated: Iterable[Stated], patience: float, listening: bool) -> None:
        self._edges: dict[str, _Edge] = {}
        self.adopt(stated, patience, listening)

    def adopt(self, stated: Iterable[Stated], patience: float, listening: bool) -> None:
        """Take over other transforms that are stated, and another patience."""
        self._stated = {each.child: _Edge(each.parent, each.rigid) for each in stated}
        self._patience, self._listening = patience, listening

    def forget(self) -> None:
        """Forget what holds for stamps alone."""
        self._edges = {child: each for child, each in self._edges.items() if each.fixed is not None}

    def hear(self, topic: str, message: Any) -> None:
        """Take in a tf2_msgs/TFMessage; most of it concerns nobody here, and is not looked at.

        Raises:
            BadInput: a transform has no valid stamp or frame, or there are too many frames.
        """
        for each in message.transforms:
            parent, child = each.header.frame_id, each.child_frame_id
            if not parent or not child or parent == child:
                raise BadInput('frames', f'{parent!r} and {child!r}', 'two different names')
            known = self._edges.get(child)
            if known is None and len(self._edges) >= MOST_FRAMES:
                raise BadInput('frames', 'one more', f'at most {MOST_FRAMES}')
            if topic == TF_STATIC:
                fixed = Rigid(*read_transform(each.transform, f'{parent} -> {child}'))
                self._edges[child] = _Edge(parent, fixed)
                continue
            if known is None or known.parent != parent or known.fixed is not None:
                known = self._edges[child] = _Edge(parent)
            known.note(nanoseconds(each.header.stamp, 'header.stamp'), each.transform)

    def moved(self, message: Any, frame: str, at: int | None = None) -> Any:
        """Return what can be read of a message as of another frame than its own.

        Args:
            message: a PoseStamped, a Path, or anything with a header and a pose.
            frame: to move it to.
            at: for which moment [ns]; the message's stamp by default.

        Raises:
            BadInput: no transform leads there, none of that moment, or the message is not valid.
        """
        found = message.header.frame_id
        if not (self._listening or self._stated):
            raise BadInput('header.frame_id', repr(found), f'{frame!r}; for others, {ON}')
        stamp = nanoseconds(message.header.stamp, 'header.stamp')
        rigid, head = self.between(frame, found, stamp if at is None else at), header(stamp, frame)
        if hasattr(message, 'poses'):
            return PlacedPath(head, [Placed(p.header, _moved(p, rigid)) for p in message.poses])
        return Placed(head, _moved(message, rigid))

    def between(self, target: str, source: str, stamp: int) -> Rigid:
        """Return how a frame lies in another, at a stamp [ns].

        Raises:
            BadInput: no transform leads from one to the other, or none of that moment.
        """
        up, down = self._line(source), self._line(target)
        common = next((each for each in up if each in down), None)
        if common is None:
            hint = ON if not self._listening else 'publish it on /tf, or state it in transforms'
            raise BadInput.stating('missing transform', f'none from {source} to {target}', hint)
        rise, fall = (self._climbed(line[: line.index(common)], stamp) for line in (up, down))
        return fall.inverse @ rise

    def _edge(self, child: str) -> _Edge | None:
        return self._stated.get(child) or self._edges.get(child)

    def _line(self, frame: str) -> list[str]:
        """Return a frame and what it lies in, and that again, to the root; once around a circle."""
        line, edge = [frame], self._edge(frame)
        while edge is not None and edge.parent not in line:
            line.append(edge.parent)
            edge = self._edge(edge.parent)
        return line

    def _climbed(self, children: list[str], stamp: int) -> Rigid:
        """Return how the first of a line lies in the parent of the last."""
        rigid = IDENTITY
        for child in children:
            edge = self._edge(child)
            assert edge is not None
            rigid = edge.at(stamp, self._patience, f'{edge.parent} -> {child}') @ rigid
        return rigid


def _moved(message: Any, rigid: Rigid) -> Pose:
    """Return the pose of a valid message elsewhere."""
    _, seen = read_sighting(message, 3, Frames())
    assert seen.attitude is not None
    return pose(rigid.placed(seen.position), rigid.rotation @ seen.attitude)
