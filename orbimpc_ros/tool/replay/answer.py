"""What the planner answered on a tick, read from its messages, recorded or made anew."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.io.content import fields, point

Messages = Mapping[str, Any]


@dataclass(frozen=True)
class Answer:
    """An answer; what no message told is None.

    Attributes:
        status: ``optimal``, ``feasible``, ``infeasible`` or ``failed``.
        reason: why it is not ``optimal``.
        fallback: what stood in for a plan; empty for a plan.
        speed: commanded [m/s].
        body_rate: commanded, shape (3,) [rad/s].
        force: commanded [N].
        rotation: commanded, as a quaternion, shape (4,).
        thrust: share of full speed or thrust along the plan, shape (N + 1,); empty without one.
        objective: of the plan; NaN without one.
        gap: of the plan; NaN without one.
        goal_stamps: of the goals that it was planned for, by topic [ns].
        goal_counts: goals that had been taken in by then, by topic.
        advanced: how far the measurement was advanced to plan from [s].
        solve_time_ms: what the tick took; 0 if no solver was asked [ms].
    """

    status: str | None = None
    reason: str | None = None
    fallback: str | None = None
    speed: float | None = None
    body_rate: Array | None = None
    force: float | None = None
    rotation: Array | None = None
    thrust: tuple[float, ...] = ()
    objective: float | None = None
    gap: float | None = None
    goal_stamps: Mapping[str, int] = field(default_factory=dict)
    goal_counts: Mapping[str, int] = field(default_factory=dict)
    advanced: float | None = None
    solve_time_ms: float | None = None

    @property
    def solved(self) -> bool:
        """Return whether a solver was asked, as far as is known."""
        return self.solve_time_ms != 0.0

    @property
    def planned(self) -> bool:
        """Return whether it came of odometry and goals, be it without a solver, as far as is known.

        Without one it goes on with the plan before, since every goal is old; what is safe for any
        other reason names no goal.
        """
        return self.solved or bool(self.goal_stamps)


def answer_of(messages: Messages) -> Answer:
    """Return the answer that messages by topic tell."""
    found: dict[str, Any] = {}
    if 'cmd_vel' in messages:
        twist = messages['cmd_vel'].twist
        found |= {'speed': twist.linear.x, 'body_rate': point(twist.angular)}
    if 'cmd_thrust' in messages:
        found['force'] = messages['cmd_thrust'].wrench.force.x
    if 'rotation' in messages:
        q = messages['rotation'].quaternion
        found['rotation'] = np.array([q.w, q.x, q.y, q.z])
    if 'tick' in messages and messages['tick'].status:
        told = fields(messages['tick'])
        found |= {name: _text(told.get(name)) for name in ('status', 'reason', 'fallback')}
        numbers = ('objective', 'gap', 'advanced', 'solve_time_ms')
        found |= {name: _number(told.get(name)) for name in numbers}
        found |= {name: _integers(told.get(name)) for name in ('goal_stamps', 'goal_counts')}
        found['thrust'] = _numbers(told.get('speed_fraction'))
    return Answer(**found)


def _text(value: Any) -> str | None:
    return None if value is None else str(value)


def _number(value: Any) -> float | None:
    good = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if good else None


def _numbers(value: Any) -> tuple[float, ...]:
    found = [_number(each) for each in value] if isinstance(value, list) else []
    return tuple(math.nan if each is None else each for each in found)


def _integers(value: Any) -> Mapping[str, int]:
    good = isinstance(value, dict) and all(isinstance(each, int) for each in value.values())
    return value if good else {}
