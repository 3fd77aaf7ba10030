# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Messages, drawn at the time of their stamps: the same for a bag and for running nodes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import rerun as rr

from orbimpc_ros.loop.goal.motion import GoalTrajectory
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.outline import sphere
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.messages import (
    SECOND,
    Frames,
    nanoseconds,
    read_itinerary,
    read_odometry,
    read_sighting,
)
from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.bags import attitude, fields, point, seconds
from orbimpc_ros.tool.palette import BLUE, GREEN, GREY, ORANGE, RED, SKY, rgb
from orbimpc_ros.tool.view.layout import THRUST, TICK, TIMELINE, WORLD, blueprint, eye

WALL_CLOCK = 1e8  # [s]: later stamps are dates, earlier ones count from a simulation's start
REMEMBERED = 500  # places on the flown path
SWING = 50  # sightings of the goal
APART = 1.5  # headings on the way, in lengths of a vehicle
SIZE = 0.06  # of a vehicle, as a share of the scene
LEAST_GAP = 1e-12  # drawn for a gap without a logarithm
LINE, STEPS = (
    rr.components.InterpolationMode.Linear,
    rr.components.InterpolationMode.StepAfter,
)
CUBE = 1  # type of a Marker; every other body is round
TRANSPARENT = rr.components.FillMode.TransparentFillMajorWireframe
SERIES = {
    'distance/to_goal': (BLUE, 2.0, LINE),
    'speed/commanded': (BLUE, 2.0, STEPS),
    'speed/floor': (RED, 2.5, STEPS),
    'gap/log10': (GREEN, 2.0, STEPS),
    'time/solve_ms': (ORANGE, 2.0, STEPS),
    'catch/earliest': (GREEN, 2.0, STEPS),
    'catch/bound': (RED, 2.5, STEPS),
}  # colour, width and manner of what charts show

# A paper dart: nose, wing tips, and the keel that tells up from down.
NOSE, LEFT, RIGHT, TAIL, KEEL = (
    (0.6, 0.0, 0.0),
    (-0.4, 0.32, 0.08),
    (-0.4, -0.32, 0.08),
    (-0.3, 0.0, 0.08),
    (-0.4, 0.0, -0.16),
)
DART = np.array([NOSE, LEFT, TAIL, NOSE, TAIL, RIGHT, NOSE, TAIL, KEEL])  # three triangles
SHADES = np.array([[70, 140, 190], [0, 90, 150], [40, 60, 80]], dtype=np.uint8)  # one for each
DART_COLORS = np.repeat(SHADES, 3, axis=0)


class Scene:
    """Draws the messages of one vehicle.

    Args:
        recording: to draw into.
        values: parameters of planner and simulator, as far as they are known.
    """

    def __init__(self, recording: rr.RecordingStream, values: settings.Values) -> None:
        self._to = recording
        self._way: deque[Array] = deque(maxlen=REMEMBERED)
        self._noses: deque[tuple[Array, Array]] = deque(maxlen=REMEMBERED)
        self._swing: deque[Array] = deque(maxlen=SWING)
        self._measured, self._sighted, self._paired = -1.0, -2.0, False  # [s], [s], alike?
        self._unit = 0.0  # length of a vehicle [m]; 0 until the scene is known
        self._pointing: tuple[float, Array] = (-1.0, np.zeros(0))  # of which tick [s], and what
        self._shares: tuple[float, Array] = self._pointing
        self._planned: tuple[float, GoalTrajectory | None] = (-1.0, None)  # of which tick [s]
        self._catching: tuple[float, Array] = self._pointing  # and how long after its start [s]
        self._takers = {
            'odom': self._take_odometry,
            'goal': self._take_goal,
            'goal_path': self._take_forecast,
            'plan': self._take_plan,
            'plan_markers': self._take_markers,
            'tick': self._take_tick,
            'captured': self._take_captured,
        }
        for entity, look in SERIES.items():
            self._to.log(entity, _series(*look), static=True)
        self.configure(values)
        self._look_at(np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]))

    @property
    def topics(self) -> Sequence[str]:
        """Return the topics that are drawn, named without a namespace."""
        return tuple(self._takers)

    def configure(self, values: settings.Values) -> None:
        """Draw what parameters say: hull, floor, obstacles; nothing if they contradict."""
        try:
            self._problem = planner_settings(values).problem
        except BadInput:
            self._problem = Problem()
        self._frames = Frames(thrust_axis=values['thrust_axis'])
        self._intercepting = values['objective'] == 'intercept'
        self._radius = float(settings.of_sim(values)['capture_radius'])
        self._done = 'caught' if values['finish'] == 'capture' else 'arrived'
        n, floor = self._problem.dimension, self._problem.floor
        self._to.log(f'{THRUST}/hull', _lines(sphere(n, 1.0), GREY, 0.008), static=True)
        self._to.log(f'{THRUST}/floor', _lines(floor.outline(n), RED, 0.014), static=True)
        self._to.log(f'{WORLD}/obstacles', _boxes(self._problem), static=True)

    def draw(self, messages: Iterable[tuple[str, Any]]) -> None:
        """Draw messages, each with its topic, in the order of their stamps."""
        for topic, message in messages:
            self.take(topic, message)
        self._to.flush()

    def take(self, topic: str, message: Any) -> None:
        """Draw a message; ``topic`` is named without a namespace.

        What the planner, too, would refuse is not drawn.
        """
        if topic not in self._takers:
            return
        with suppress(BadInput):
            for header in _headers(message):
                now = nanoseconds(header.stamp, 'header.stamp') / SECOND
                kind = 'timestamp' if now > WALL_CLOCK else 'duration'
                self._to.set_time(TIMELINE, **{kind: now})
            self._takers[topic](message)

    def _take_odometry(self, message: Any) -> None:
        _, odometry = read_odometry(message, 3, self._frames)
        place, turned = odometry.position, odometry.attitude
        self._way.append(place)
        self._point(place, turned[:, 0])
        self._begin()
        own = rr.Transform3D(translation=place, mat3x3=self._frames.own(turned))
        self._to.log(f'{WORLD}/vehicle', own)
        places, along = np.array(self._noses).transpose(1, 0, 2)
        noses = _arrows(places, self._unit * along, BLUE, 0.07 * self._unit)
        way = _lines([np.array(self._way)], SKY, 0.05 * self._unit)
        self._to.log(f'{WORLD}/flown', way, noses)
        self._measured = seconds(message)
        self._draw_distance()

    def _point(self, place: Array, heading: Array) -> None:
        """Remember a heading to draw, unless it would cover the last one."""
        if not self._noses or np.linalg.norm(place - self._noses[-1][0]) > APART * self._unit:
            self._noses.append((place, heading))

    def _take_goal(self, message: Any) -> None:
        self._swing.append(read_sighting(message, 3, Frames())[1].position)
        self._begin()
        ball = rr.Ellipsoids3D(
            centers=[self._swing[-1]],
            half_sizes=[[self._radius] * 3],
            colors=[rgb(ORANGE)],
            fill_mode=TRANSPARENT,
        )
        trail = _lines([np.array(self._swing)], ORANGE, 0.05 * self._unit)
        self._to.log(f'{WORLD}/goal', ball, trail)
        self._sighted = seconds(message)
        self._draw_distance()

    def _draw_distance(self) -> None:
        """Draw the distance to the goal of the odometry's own stamp, if goals have such stamps."""
        together = self._measured == self._sighted
        self._paired = self._paired or together
        if together or (not self._paired and self._sighted < self._measured and self._swing):
            apart = np.linalg.norm(self._way[-1] - self._swing[-1])
            self._to.log('distance/to_goal', rr.Scalars([apart]))

    def _begin(self) -> None:
        """Choose the point of view and the size of things once both ends of the way are known."""
        if self._unit or not (self._way and self._swing):
            return
        ends = np.array([self._way[0], self._swing[0]])
        self._unit = SIZE * max(1.0, float(np.linalg.norm(ends[1] - ends[0])))
        self._look_at(ends)
        corners, shades = self._unit * DART, DART_COLORS
        dart = rr.Mesh3D(vertex_positions=corners, vertex_colors=shades)
        axes = rr.Arrows3D(
            vectors=self._unit * np.eye(3),
            colors=[rgb(RED), rgb(GREEN), rgb(BLUE)],
            radii=0.06 * self._unit,
        )
        self._to.log(f'{WORLD}/vehicle/body', dart, axes, static=True)

    def _look_at(self, points: Array) -> None:
        dimension = self._problem.dimension
        layout = blueprint(dimension, eye(dimension, points), intercepting=self._intercepting)
        self._to.send_blueprint(layout)

    def _take_forecast(self, message: Any) -> None:
        places = read_itinerary(message, 3, Frames())[1].positions
        dots = rr.Points3D(places, radii=0.1 * self._unit, colors=[rgb(ORANGE)])
        self._to.log(f'{WORLD}/goal/forecast', dots)

    def _take_plan(self, message: Any) -> None:
        way = read_itinerary(message, 3, Frames())[1]
        assert isinstance(way, GoalTrajectory)
        places = way.positions
        dots = rr.Points3D(places, radii=0.16 * self._unit, colors=[rgb(GREEN)])
        self._to.log(f'{WORLD}/plan', _lines([places], GREEN, 0.08 * self._unit), dots)
        self._planned = seconds(message), way
        self._draw_catch()
        own = [attitude(stamped.pose.orientation) for stamped in message.poses]
        self._pointing = seconds(message), self._frames.turned(np.array(own))[:, :, 0]
        self._draw_thrust()

    def _take_markers(self, message: Any) -> None:
        """Draw the bodies that a plan stays clear of, and where they go."""
        bodies = [each for each in message.markers if each.ns == 'hazards']
        boxes, balls = (
            _finite([(point(m.pose.position), 0.5 * point(m.scale)) for m in found], (-1, 2, 3))
            for found in (
                [each for each in bodies if each.type == CUBE],
                [each for each in bodies if each.type != CUBE],
            )
        )
        ways = [each.points for each in message.markers if each.ns == 'ways']
        strips = [_finite([point(each) for each in way], (-1, 3)) for way in ways]
        width, color = 0.03 * self._unit, [rgb(RED)]
        shown = {
            'boxes': rr.Boxes3D(
                centers=boxes[:, 0], half_sizes=boxes[:, 1], colors=color, fill_mode=TRANSPARENT
            ),
            'balls': rr.Ellipsoids3D(
                centers=balls[:, 0], half_sizes=balls[:, 1], colors=color, fill_mode=TRANSPARENT
            ),
            'ways': _lines(strips, RED, width),
            'ends': rr.Points3D([each[-1] for each in strips], colors=color, radii=[2.0 * width]),
        }
        for name, each in shown.items():
            self._to.log(f'{WORLD}/hazards/{name}', each)

    def _take_tick(self, message: Any) -> None:
        values = fields(message)
        self._shares = seconds(message), _numbers(values.get('speed_fraction'))
        self._to.log(TICK, rr.TextDocument(_words(values), media_type=rr.MediaType.MARKDOWN))
        self._chart('time/solve_ms', values.get('solve_time_ms'))
        for gap in _numbers([values.get('gap')]):
            self._chart('gap/log10', np.log10(max(gap, LEAST_GAP)))
        if len(self._shares[1]) > 1:
            self._chart('speed/commanded', self._shares[1][1])
        if self._problem.floor.exists:
            self._chart('speed/floor', self._problem.floor.fraction)
        self._chart('catch/earliest', values.get('earliest_catch'))
        self._chart('catch/bound', values.get('catch_bound'))
        self._catching = seconds(message), _numbers([values.get('earliest_catch')])
        self._draw_thrust()
        self._draw_catch()

    def _draw_catch(self) -> None:
        """Draw where a plan catches the goal, once plan and time of the same tick are there."""
        (planned, way), (ticked, after) = self._planned, self._catching
        if planned != ticked or way is None:
            return
        places = way.at(way.times[0] + after)
        balls = rr.Ellipsoids3D(
            centers=places,
            half_sizes=np.full((len(places), 3), self._radius),
            colors=[rgb(GREEN)],
            fill_mode=rr.components.FillMode.MajorWireframe,
        )
        self._to.log(f'{WORLD}/catch', balls)

    def _draw_thrust(self) -> None:
        """Draw R_k e1 = sigma_k Q_k e1 once direction and share of the same tick are there."""
        (planned, axes), (ticked, shares) = self._pointing, self._shares
        if planned != ticked or len(axes) != len(shares):
            return
        ends = shares[:, None] * axes
        names = [str(k) for k in range(len(ends))]
        dots = rr.Points3D(ends, radii=0.03, colors=[rgb(GREEN)], labels=names)
        self._to.log(f'{THRUST}/plan', dots, _lines([ends], GREEN, 0.008))

    def _take_captured(self, message: Any) -> None:
        if message.data and self._swing:
            radius, place = 0.3 * self._unit, self._swing[-1]
            star = rr.Points3D([place], radii=radius, colors=[rgb(GREEN)], labels=[self._done])
            self._to.log(f'{WORLD}/done', star)

    def _chart(self, entity: str, value: Any) -> None:
        for number in _numbers([value]):
            self._to.log(entity, rr.Scalars([number]))


def _headers(message: Any) -> list[Any]:
    """Return the header that says when a message is of: that of its first marker, or none."""
    stamped = getattr(message, 'markers', [message])[:1]
    return [each.header for each in stamped if hasattr(each, 'header')]


def _numbers(value: Any) -> Array:
    """Return a list of finite numbers as an array, anything else as an empty one."""
    whole = isinstance(value, list) and all(isinstance(each, (int, float)) for each in value)
    found = np.array(value if whole else [], dtype=float)
    return found if np.isfinite(found).all() else np.zeros(0)


def _finite(points: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Return points as an array.

    Raises:
        BadInput: a number is not finite.
    """
    found = np.reshape(points, shape)
    if not np.isfinite(found).all():
        raise BadInput.stating('plan_markers', 'NaN or infinite', 'finite numbers')
    return found


def _series(color: str, width: float, manner: rr.components.InterpolationMode) -> rr.SeriesLines:
    return rr.SeriesLines(colors=[rgb(color)], widths=[width], interpolation_mode=manner)


def _lines(strips: Sequence[Array], color: str, radius: float) -> rr.LineStrips3D:
    return rr.LineStrips3D(list(strips), colors=[rgb(color)], radii=[radius])


def _arrows(places: Array, along: Array, color: str, radius: float) -> rr.Arrows3D:
    return rr.Arrows3D(origins=places, vectors=along, colors=[rgb(color)], radii=[radius])


def _boxes(problem: Problem) -> rr.Boxes3D:
    """Return the obstacles; in the plane they are flat."""
    corners = [np.array([box.minimum, box.maximum]) for box in problem.boxes]
    places = np.pad(np.reshape(corners, (-1, 2, problem.dimension)), _to_space(problem.dimension))
    return rr.Boxes3D(
        centers=places.mean(axis=1),
        sizes=np.diff(places, axis=1)[:, 0],
        colors=[rgb(GREY)],
        fill_mode=rr.components.FillMode.Solid,
    )


def _to_space(dimension: int) -> list[tuple[int, int]]:
    return [(0, 0), (0, 0), (0, 3 - dimension)]


def _words(values: dict[str, Any]) -> str:
    """Return what a tick says, as a table in Markdown."""
    first, *others = [
        f'| {key} | {_word(value)} |' for key, value in values.items() if _is_known(value)
    ]
    return '\n'.join([first, '| --- | --- |', *others])


def _is_known(value: Any) -> bool:
    return value not in ('', [], {}) and value == value  # NaN stands for nothing


def _word(value: Any) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{key} {_word(each)}' for key, each in value.items())
    if isinstance(value, list):
        return ', '.join(_word(each) for each in value)
    return f'{value:.4g}' if isinstance(value, float) else str(value)
