# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A planner stepped with plain values, with every command counted as sent."""

import numpy as np

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.planner import Planner, Snapshot
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.sim.vehicle import Vehicle


def odometry(position=(0.0, 0.0), attitude=0.0, speed=1.0, time=0.0):
    """Return odometry of straight flight; in the plane ``attitude`` may be a heading [rad]."""
    n = len(position)
    if np.ndim(attitude) == 0:
        attitude = exp(np.array([attitude] if n == 2 else [0.0, 0.0, attitude]))
    still = np.zeros(1 if n == 2 else 3)
    return Odometry(time, np.array(position, float), attitude.copy(), speed * np.eye(n)[0], still)


def launched(model, position, attitude, *, fraction=1.0, velocity=0.0, body_rate=0.0):
    """Return the vehicle of a model at time 0; velocity and body rate are 0 unless given."""
    still, rate = np.zeros(model.dimension), np.zeros(model.rates) + body_rate
    wind = model.blown * (model.translation_order == 1)
    start = Vehicle(0.0, position, still + velocity, attitude, rate, fraction, wind)
    return model.flown(start, 0.0, fraction, rate)[-1]


def started(plant, heading=0.0, fraction=0.0):
    """Return a plant's vehicle moving ahead from the origin, at a heading in the plane [rad]."""
    turn = [heading] if plant.dimension == 2 else [0.0, 0.0, heading]
    place, attitude = np.zeros(plant.dimension), exp(np.array(turn))
    return launched(plant, place, attitude, fraction=fraction)


def flown(plant, vehicle, fraction, rate, time):
    """Return a vehicle after a time [s] with a constant command."""
    return plant.flown(vehicle, time, fraction, rate)[-1]


class Motion:
    """A goal with the motion ``place(times)``."""

    def __init__(self, place):
        self.at = place


class Stepped(Planner):
    """A planner with one method per kind of tick."""

    hazards = ()

    def tick(self, odometry, goals, late=None, ahead=None, wanted=None):
        """Return the decision for goals g_1..g_N, or for a goal as a function of time."""
        goal = goals if ahead is None else Motion(ahead)
        return self.tell(Snapshot(odometry, goal, wanted, self.hazards), late)

    def hold(self, odometry):
        """Return the decision without a goal."""
        return self.tell(Snapshot(odometry, hazards=self.hazards))

    def safe(self, attitude, reason):
        """Return the decision for a reason to stop."""
        n = len(attitude)
        still = np.zeros(n), attitude.copy(), np.zeros(n), np.zeros(1 if n == 2 else 3)
        return self.tell(Snapshot(Odometry(0.0, *still), stop=reason))

    def tell(self, snapshot, late=None):
        """Return the decision for a snapshot, and count its command as sent."""
        decision = self.step(snapshot, late=late)
        self.sent(decision.command)
        return decision


def stale(inputs, name, *clock):
    """Return how old the ``odometry`` or the ``goal`` is, as it is told, if it is too old."""
    snapshot, limits = inputs.snapshot(*clock), inputs.settings
    age = snapshot.odometry_age if name == 'odometry' else snapshot.goal_age
    timeout = limits.odom_timeout if name == 'odometry' else limits.goal_timeout
    return f'{age:.2f} s old' if age > timeout else ''


def targets(inputs, times, *clock):
    """Return the predicted positions of the goal at ``times``."""
    return inputs.snapshot(*clock).goal.at(times)
