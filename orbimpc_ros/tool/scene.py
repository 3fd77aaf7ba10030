# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A scene that draws messages at the time of their stamps, from a bag or from running nodes."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.faces import sphere
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.messages import Frames, read_itinerary, read_odometry, read_sighting
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.bags import UNDATED, fields, point, seconds, stamp_of
from orbimpc_ros.tool.plot import BLUE, GREEN, GREY, ORANGE, RED, SKY, rgb

TOPICS = ('odom', 'goal', 'plan', 'plan_markers', 'tick', 'captured')  # that are drawn
TIMELINE = 'ros_time'
WORLD, THRUST, TICK, CHARTS = 'world', 'thrust', 'tick', 'charts'
SHOWN = {
    'Distance to the goal [m]': ('distance',),
    'Share of full speed |R e₁|, floor': ('speed', 'floor'),
    'Gap to the proved bound, log₁₀': ('gap',),
    'Solve time [ms]': ('solve_time_ms',),
    'Earliest catch, and its bound [s]': ('earliest_catch', 'catch_bound'),
}  # lines of each chart, below CHARTS
WALL_CLOCK = 1e8  # [s]: later stamps are dates, earlier ones count from a simulation's start
REMEMBERED = 500  # positions kept of the flown path
SWING = 50  # sightings kept of the goal
SIZE = 0.06  # of a vehicle, as a share of the scene
LEAST_GAP = 1e-12  # drawn for smaller gaps, since zero has no logarithm
CUBE = 1  # type of a Marker; all other bodies are balls
CLEAR = rr.components.FillMode.TransparentFillMajorWireframe

# A paper dart: nose, wing tips, and a keel to distinguish up from down.
NOSE, LEFT, RIGHT, TAIL, KEEL = (
    (0.6, 0.0, 0.0),
    (-0.4, 0.32, 0.08),
    (-0.4, -0.32, 0.08),
    (-0.3, 0.0, 0.08),
    (-0.4, 0.0, -0.16),
)
DART = np.array([NOSE, LEFT, TAIL, NOSE, TAIL, RIGHT, NOSE, TAIL, KEEL])  # three triangles
SHADES = np.array([[70, 140, 190], [0, 90, 150], [40, 60, 80]], dtype=np.uint8)  # one for each


class Scene:
    """Draws the messages of one vehicle.

    Args:
        recording: to draw into.
        values: parameters of planner and simulator, or their defaults.
    """

    def __init__(self, recording: rr.RecordingStream, values: settings.Values) -> None:
        self._to = recording
        self._way: deque[Array] = deque(maxlen=REMEMBERED)
        self._swing: deque[Array] = deque(maxlen=SWING)
        self._unit = 0.0  # length of a vehicle [m]; 0 until the scene is known
        self._pointing: tuple[float, Array] = (-1.0, np.zeros(0))  # tick's stamp [s], directions
        self._shares: tuple[float, Array] = self._pointing
        self.configure(values)

    def configure(self, values: settings.Values) -> None:
        """Draw hull, floor and obstacles of the parameters; invalid ones give a default problem."""
        try:
            self._problem = planner_settings(values).problem
        except BadInput:
            self._problem = Problem()
        self._frames = Frames(thrust_axis=values['thrust_axis'])
        self._radius = float(settings.of_sim(values)['capture_radius'])
        self._done = 'caught' if values['finish'] == 'capture' else 'arrived'
        n, floor = self._problem.dimension, self._problem.floor
        self._to.send_blueprint(layout(n, intercepting=values['objective'] == 'intercept'))
        self._to.log(f'{THRUST}/hull', _lines(sphere(n, 1.0), GREY, 0.008), static=True)
        self._to.log(f'{THRUST}/floor', _lines(floor.outline(n), RED, 0.014), static=True)
        corners = np.zeros((len(self._problem.boxes), 2, 3))
        corners[:, :, :n] = [(box.minimum, box.maximum) for box in self._problem.boxes] or 0.0
        boxes = rr.Boxes3D(
            centers=corners.mean(axis=1),
            sizes=np.diff(corners, axis=1)[:, 0],
            colors=[rgb(GREY)],
            fill_mode=rr.components.FillMode.Solid,
        )
        self._to.log(f'{WORLD}/obstacles', boxes, static=True)

    def take(self, topic: str, message: Any) -> None:
        """Draw a message unless the planner would refuse it; ``topic`` has no namespace."""
        if topic not in TOPICS:
            return
        now = seconds(message)
        if stamp_of(message) != UNDATED and (now or topic != 'goal'):  # one by hand has no stamp
            kind = 'timestamp' if now > WALL_CLOCK else 'duration'
            self._to.set_time(TIMELINE, **{kind: now})
        with suppress(BadInput):
            getattr(self, f'_take_{topic}')(message)

    def _take_odom(self, message: Any) -> None:
        _, odometry = read_odometry(message, 3, self._frames)
        place, turned = odometry.position, odometry.attitude
        self._way.append(place)
        self._begin()
        own = rr.Transform3D(translation=place, mat3x3=self._frames.own(turned))
        self._to.log(f'{WORLD}/vehicle', own)
        self._to.log(f'{WORLD}/flown', _lines([np.array(self._way)], SKY, 0.05 * self._unit))
        if self._swing:
            apart = np.linalg.norm(place - self._swing[-1])
            self._to.log(f'{CHARTS}/distance', rr.Scalars([apart]))

    def _take_goal(self, message: Any) -> None:
        self._swing.append(read_sighting(message, 3, Frames())[1].position)
        self._begin()
        ball = _balls([self._swing[-1]], [[self._radius] * 3], ORANGE)
        trail = _lines([np.array(self._swing)], ORANGE, 0.05 * self._unit)
        self._to.log(f'{WORLD}/goal', ball, trail)

    def _begin(self) -> None:
        """Choose the scale and draw the vehicle's body once vehicle and goal have been seen."""
        if self._unit or not (self._way and self._swing):
            return
        ends = np.array([self._way[0], self._swing[0]])
        self._unit = SIZE * max(1.0, float(np.linalg.norm(ends[1] - ends[0])))
        shades = np.repeat(SHADES, 3, axis=0)
        dart = rr.Mesh3D(vertex_positions=self._unit * DART, vertex_colors=shades)
        axes = rr.Arrows3D(
            vectors=self._unit * np.eye(3),
            colors=[rgb(RED), rgb(GREEN), rgb(BLUE)],
            radii=0.06 * self._unit,
        )
        self._to.log(f'{WORLD}/vehicle/body', dart, axes, static=True)

    def _take_plan(self, message: Any) -> None:
        places = read_itinerary(message, 3, Frames())[1].positions
        dots = rr.Points3D(places, radii=0.16 * self._unit, colors=[rgb(GREEN)])
        self._to.log(f'{WORLD}/plan', _lines([places], GREEN, 0.08 * self._unit), dots)
        turned = [read_sighting(each, 3, self._frames)[1].attitude for each in message.poses]
        self._pointing = seconds(message), np.array(turned)[:, :, 0]
        self._draw_thrust()

    def _take_plan_markers(self, message: Any) -> None:
        """Draw the obstacles that a plan avoids."""
        bodies = [each for each in message.markers if each.ns == 'hazards']
        places = [(point(m.pose.position), 0.5 * point(m.scale)) for m in bodies]
        found = np.reshape(places, (-1, 2, 3))
        if not np.isfinite(found).all():
            raise BadInput.stating('plan_markers', 'NaN or infinite', 'finite numbers')
        cube = np.array([each.type == CUBE for each in bodies], dtype=bool)
        boxes, balls = found[cube], found[~cube]
        how: Any = {'colors': [rgb(RED)], 'fill_mode': CLEAR}
        shown = rr.Boxes3D(centers=boxes[:, 0], half_sizes=boxes[:, 1], **how)
        self._to.log(f'{WORLD}/hazards/boxes', shown)
        self._to.log(f'{WORLD}/hazards/balls', _balls(balls[:, 0], balls[:, 1], RED))

    def _take_tick(self, message: Any) -> None:
        values = fields(message)
        self._shares = seconds(message), _numbers(values.get('speed_fraction'))
        self._to.log(TICK, rr.TextDocument(_table(values), media_type=rr.MediaType.MARKDOWN))
        charted = values | dict(zip(('start', 'speed'), self._shares[1][:2].tolist(), strict=False))
        if self._problem.floor.exists:
            charted['floor'] = self._problem.floor.fraction
        for name, value in charted.items():
            for number in _numbers([value]):
                shown = np.log10(max(number, LEAST_GAP)) if name == 'gap' else number
                self._to.log(f'{CHARTS}/{name}', rr.Scalars([shown]))
        self._draw_thrust()

    def _draw_thrust(self) -> None:
        """Draw R_k e1 = sigma_k Q_k e1 once directions and shares of the same tick have arrived."""
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


def _numbers(value: Any) -> Array:
    """Return a list of finite numbers as an array, anything else as an empty one."""
    whole = isinstance(value, list) and all(isinstance(each, (int, float)) for each in value)
    found = np.array(value if whole else [], dtype=float)
    return found if np.isfinite(found).all() else np.zeros(0)


def _lines(strips: Sequence[Array], color: str, radius: float) -> rr.LineStrips3D:
    return rr.LineStrips3D(list(strips), colors=[rgb(color)], radii=[radius])


def _balls(centers: Any, halves: Any, color: str) -> rr.Ellipsoids3D:
    return rr.Ellipsoids3D(centers=centers, half_sizes=halves, colors=[rgb(color)], fill_mode=CLEAR)


def _table(values: dict[str, Any]) -> str:
    """Return the known values of a tick as a Markdown table."""
    rows = [
        f'| {key} | {_text(value)} |'
        for key, value in values.items()
        if value not in ('', [], {}) and value == value  # NaN is unknown
    ]
    return '\n'.join([*rows[:1], '| --- | --- |', *rows[1:]])


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{key} {_text(each)}' for key, each in value.items())
    if isinstance(value, list):
        return ', '.join(_text(each) for each in value)
    return f'{value:.4g}' if isinstance(value, float) else str(value)


def layout(dimension: int, *, intercepting: bool) -> rrb.Blueprint:
    """Return the layout of the page: the world, the thrust set, the tick as text, and charts."""
    charts = [
        rrb.TimeSeriesView(name=title, contents=[f'/{CHARTS}/{name}' for name in lines])
        for title, lines in SHOWN.items()
    ]
    axes = 'the (a, b) disk' if dimension == 2 else 'the unit ball'
    thrusts = f'R e₁ of the plan in {axes}: hull, floor'
    lines = rrb.LineGrid3D(visible=False)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(origin=WORLD, name='Vehicle, plan, rope'),
                rrb.Horizontal(charts[0], charts[1]),
                row_shares=[9, 3],
            ),
            rrb.Vertical(
                rrb.Spatial3DView(origin=THRUST, name=thrusts, line_grid=lines),
                rrb.TextDocumentView(origin=TICK, name='Tick'),
                rrb.Horizontal(*charts[2 : 5 if intercepting else 4]),  # the last: catches
                row_shares=[9, 9, 6],
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=TIMELINE, state='collapsed'),
        collapse_panels=True,
    )
