# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Odometry of a pose and a twist, which autopilots publish on two topics.

Where the two come with the same stamps, in whatever order, they belong together. Elsewhere each is
measured at its own pace, and a pose goes with the last twist.
"""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.messages import SECOND, nanoseconds

POSE_TWIST = ('pose', 'twist')
APART = SECOND // 10  # [ns] at most, from a pose to its twist


class PoseTwistSynchronizer:
    """Pairs poses with twists as odometry, stamped as the pose.

    Both methods return odometry as soon as there is some, and raise BadInput where a stamp is not
    valid, or those of pose and twist are too far apart.
    """

    def __init__(self) -> None:
        self._pose: tuple[int, PoseStamped] | None = None
        self._twist: tuple[int, TwistStamped] | None = None
        self._joined_at = -1  # stamp of the last pose that has become odometry [ns]
        self._twins = False  # whether stamps have been seen to be the same

    def pose(self, message: PoseStamped) -> Odometry | None:
        """Take in a pose; return odometry if it has its twist."""
        self._pose = nanoseconds(message.header.stamp, 'pose.header.stamp'), message
        return self._join(alone=not self._twins)

    def twist(self, message: TwistStamped) -> Odometry | None:
        """Take in a twist; return odometry if a pose has waited for it."""
        self._twist = nanoseconds(message.header.stamp, 'twist.header.stamp'), message
        return self._join(alone=self._joined_at < 0)

    def _join(self, *, alone: bool) -> Odometry | None:
        """Return odometry, of stamps that need not be the same if ``alone``."""
        if self._pose is None or self._twist is None:
            return None
        (stamp, pose), (other, twist) = self._pose, self._twist
        self._twins = self._twins or stamp == other
        if stamp == self._joined_at or not (alone or stamp == other):
            return None
        if abs(stamp - other) > APART:
            apart = f'{abs(stamp - other) / SECOND:.3g} s from that of pose'
            raise BadInput('twist.header.stamp', apart, f'within {APART / SECOND:g} s')
        self._joined_at = stamp
        joined = Odometry(header=pose.header, child_frame_id=twist.header.frame_id)
        joined.pose.pose, joined.twist.twist = pose.pose, twist.twist
        return joined
