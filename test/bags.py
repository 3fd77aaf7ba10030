"""What the tests of demos look at: their bags, every plan rolled out, and their pictures."""

import itertools
from collections import defaultdict

import numpy as np

from orbimpc_ros.mpc.rotations import exp, from_quaternion
from orbimpc_ros.ros.parameters import sim_settings
from orbimpc_ros.tool import bag, settings
from orbimpc_ros.world.vehicle import advance, launched


def check_pictures(folder, *names):
    assert {f.name for f in folder.glob('*.png')} == set(names)
    for name in names:
        picture = (folder / name).read_bytes()
        assert picture[:8] == b'\x89PNG\r\n\x1a\n'
        assert len(picture) > 50_000
        width, height = (int.from_bytes(picture[k : k + 4], 'big') for k in (16, 20))
        assert min(width, height) >= 1000


def messages_of(folder):
    """Return the messages in a bag by topic and stamp [ns]; the first under each."""
    found = defaultdict(dict)
    for message in bag.read(folder / 'bag'):
        found[message.topic[1:]].setdefault(message.stamp, message.content)
    return found


def vector(message):
    return np.array([message.x, message.y, message.z])


def attitude(message):
    return from_quaternion(np.array([message.w, message.x, message.y, message.z]), 3)


def values_of(folder):
    return settings.read(bag.notes(folder / 'bag')['parameters'])


def check_rollout(folder, tolerance=1e-6):
    """What was commanded, flown by the vehicle's model, is the plan's and odometry's next pose.

    Flown in space; in the plane z stays zero and turning is about z.
    """
    found, values = messages_of(folder), values_of(folder)
    model = sim_settings(values | {'dimension': 3}).scenario.model
    fraction = values['start.speed_fraction']
    for now, then in itertools.pairwise(sorted(found['odom'])):
        vehicle = vehicle_of(found['odom'][now], model, fraction)
        fraction, rate = command_of(found, now, model)
        flown = advance(model, vehicle, fraction, rate)
        for pose in (found['plan'][now].poses[1].pose, found['odom'][then].pose.pose):
            assert np.allclose(vector(pose.position), flown.position, atol=tolerance)
            assert np.allclose(attitude(pose.orientation), flown.attitude, atol=tolerance)
        # At rotation order 2 a rate is taken over at the end of the step and turns in the next.
        turned = flown.attitude if model.rotation_order == 1 else flown.attitude @ exp(rate)
        commanded = attitude(found['rotation'][now].quaternion)
        assert np.allclose(commanded, turned, atol=tolerance)


def vehicle_of(odometry, model, fraction):
    """Return what is flown on from; odometry does not show the thrust, but it does the speed."""
    pose, twist = odometry.pose.pose, odometry.twist.twist
    if model.translation_order == 1:
        fraction = min(1.0, twist.linear.x / model.forward)
    body = attitude(pose.orientation)
    return launched(
        model,
        vector(pose.position),
        body,
        fraction=fraction,
        velocity=body @ vector(twist.linear),
        body_rate=vector(twist.angular),
    )


def command_of(found, stamp, model):
    """Return the share of speed or thrust, and the body rate [rad/s]."""
    twist = found['cmd_vel'][stamp].twist
    if model.translation_order == 1:
        return twist.linear.x / model.forward, vector(twist.angular)
    force = found['cmd_thrust'][stamp].wrench.force.x
    return force / (model.mass * model.forward), vector(twist.angular)
