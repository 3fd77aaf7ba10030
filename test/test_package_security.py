# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The SROS2 policy grants exactly what the nodes use; without requested security nothing flies."""

import os
import sys
from importlib.util import find_spec
from unittest import mock
from xml.etree import ElementTree

import pytest
from geometry_msgs.msg import TwistStamped
from harness import ROOT, run, wait_for
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from orbimpc_ros.ros.entry import PACKAGES
from orbimpc_ros.ros.topics import topics_of
from orbimpc_ros.tool.demo import Recorder

POLICY = ROOT / 'config' / 'security' / 'policy.xml'
# Kinds of endpoints by element and attribute of the policy.
KINDS = {
    ('topics', 'publish'): 'publisher',
    ('topics', 'subscribe'): 'subscriber',
    ('services', 'reply'): 'service',
    ('services', 'request'): 'client',
}


def granted(node):
    """Return the full names granted to a node, by kind of endpoint."""
    (profile,) = ElementTree.parse(POLICY).iterfind(f".//profile[@node='{node}']")
    found = {kind: set() for kind in KINDS.values()}
    for rules in profile:
        for rule in rules.attrib:
            names = {full(name.text, profile) for name in rules}
            found[KINDS[rules.tag, rule]] |= names
    return found


def full(name, profile):
    """Return a name as SROS2 expands it: absolute, below the node, or below the namespace."""
    ns = profile.get('ns').rstrip('/')
    if name.startswith('/'):
        return name
    return f'{ns}/{profile.get("node")}{name[1:]}' if name[0] == '~' else f'{ns}/{name}'


@pytest.fixture(scope='module')
def endpoints(shared, tmp_path_factory):
    """Return the endpoints of three real nodes, by node and kind, and the simulator.

    The spacecraft's planner has every topic; a forecast, traffic and a vehicle in continuous
    time add the remaining ones of the simulator.
    """
    launch, observer = shared
    launch('planner', {'publish_certificate': True}, 'spacecraft')
    sim = {'wait_subscribers': 9, 'goal_path_steps': 3, 'vehicle': 'continuous'}
    sim['traffic'] = [9.0, 9.0, 9.0, 0.0, 0.0, 0.0, 1.0]
    simulator = launch('sim', sim, 'spacecraft')
    with mock.patch.dict(os.environ, ROS_DOMAIN_ID=str(observer.domain)):
        bag = tmp_path_factory.mktemp('recorder') / 'bag'
        recorder = Recorder(bag, topics_of(), {}, ['planner'])

    def names(node, kind):
        found = getattr(observer.node, f'get_{kind}_names_and_types_by_node')(node, '/')
        return {name for name, _ in found}

    def complete():
        recorder.spin(0.0)
        known = {name for name, _ in observer.node.get_node_names_and_namespaces()}
        if not {'planner', 'sim', 'recorder'} <= known:
            return False
        last = {'planner': '/planner/enable', 'sim': '/sim/reset'}
        return '/odom' in names('recorder', 'subscriber') and all(
            service in names(node, 'service') for node, service in last.items()
        )

    try:
        observer.until(complete, 'three nodes')
        found = {
            node: {kind: names(node, kind) for kind in KINDS.values()}
            for node in ('planner', 'sim', 'recorder')
        }
        yield found, simulator
    finally:
        recorder.close()


@pytest.mark.parametrize('node', ['planner', 'sim', 'recorder'])
def test_a_node_is_granted_exactly_what_it_uses(endpoints, node):
    allowed = granted(node)
    if node == 'sim' and find_spec('tf2_msgs') is None:
        allowed['publisher'].discard('/tf')  # published only where tf2_msgs is installed
    assert endpoints[0][node] == allowed


def test_qos_is_as_documented(shared, endpoints):
    node = shared[1].node
    outputs = ('cmd_vel', 'rotation', 'plan', 'plan_markers', 'tick', 'odom', 'goal', 'captured')
    for topic in outputs:
        profile = node.get_publishers_info_by_topic(topic)[0].qos_profile
        assert profile.reliability == ReliabilityPolicy.RELIABLE
        kept = 'TRANSIENT_LOCAL' if topic == 'captured' else 'VOLATILE'
        assert profile.durability == DurabilityPolicy[kept]
    for topic in ('odom', 'goal', 'goal_path'):
        found = node.get_subscriptions_info_by_topic(topic)
        (heard,) = (each for each in found if each.node_name == 'planner')
        assert heard.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        assert heard.qos_profile.durability == DurabilityPolicy.VOLATILE


# --- without security in the middleware


def keystore(folder):
    """Make a keystore of invalid files: the middleware finds it, and must refuse to start."""
    enclaves = folder / 'enclaves'
    enclaves.mkdir(parents=True)
    for name in (
        *('identity_ca.cert.pem', 'permissions_ca.cert.pem', 'cert.pem', 'key.pem'),
        *('governance.p7s', 'permissions.p7s'),
    ):
        (enclaves / name).write_text('none')
    return folder


@pytest.mark.parametrize(
    ('node', 'prepare'), [('planner', keystore), ('sim', lambda folder: folder)]
)
def test_where_security_is_asked_for_and_missing_nothing_flies(
    observer, domain, tmp_path, node, prepare
):
    """The Fast DDS of PyPI has no security library: it must fail closed."""
    commands = observer.listen(TwistStamped, 'cmd_vel')
    asked = {'ENABLE': 'true', 'STRATEGY': 'Enforce', 'KEYSTORE': prepare(tmp_path / 'keystore')}
    secured = {f'ROS_SECURITY_{name}': str(value) for name, value in asked.items()}
    environment = {**os.environ, **secured, 'ROS_DOMAIN_ID': str(domain)}
    done = run(sys.executable, '-m', PACKAGES[node], env=environment)
    lines = [line for line in done.stderr.splitlines() if not line.startswith('[INFO]')]
    assert done.returncode not in (0, None)
    assert len([line for line in lines if 'ROS_SECURITY_ENABLE=true' in line]) == 1, done.stderr
    assert 'Traceback' not in done.stderr
    assert lines[-1].endswith('middleware with security)')
    observer.until(lambda: True)
    assert commands == []
    assert observer.node.count_publishers('cmd_vel') == 0


def test_a_node_warns_where_other_machines_may_join(launch, monkeypatch, endpoints):
    _, at_home = endpoints
    assert 'open to' not in at_home.output
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    monkeypatch.setenv('ROS_STATIC_PEERS', '10.0.0.7')
    node = launch('sim')  # which starts more quickly
    wait_for(lambda: 'waits for' in node.output)
    assert node.output.count('open to') == 2
