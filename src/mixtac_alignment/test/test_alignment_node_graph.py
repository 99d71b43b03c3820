# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The contract of the alignment and the force error node: exact names, types and QoS."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from mixtac_node.graph import NodeSpec
from mixtac_node.topics import SERVICES, TOPICS

pytestmark = pytest.mark.dds
NAMESPACE = 'left/finger'
REFERENCE = '/other/wrench'
PUBLISHED = {
    'alignment': ('clock_fit', 'reference/wrench'),
    'force_error': ('force_error/mae', 'force_error/rmse'),
}
WRENCH = 'geometry_msgs/msg/WrenchStamped'
SUBSCRIBED = {
    'alignment': {
        f'/{NAMESPACE}/events': 'event_camera_msgs/msg/EventPacket',
        REFERENCE: WRENCH,
        f'/{NAMESPACE}/image_raw': 'sensor_msgs/msg/Image',
        f'/{NAMESPACE}/image_exposure': 'mixtac_msgs/msg/FrameExposure',
        f'/{NAMESPACE}/external_edges': 'mixtac_msgs/msg/ExternalEdge',
        f'/{NAMESPACE}/reference_edges': 'sensor_msgs/msg/TimeReference',
    },
    'force_error': {
        f'/{NAMESPACE}/force': WRENCH,
        f'/{NAMESPACE}/reference/wrench': WRENCH,
    },
}


@pytest.fixture(scope='module')
def graph(module_node_under_test: Any) -> Any:
    """Return a node of the test's own that sees both nodes, in another namespace than usual."""
    test = module_node_under_test
    alignment = NodeSpec(
        'mixtac_alignment.alignment_node',
        'alignment',
        overrides={'reference_topic': REFERENCE},
    )
    force_error = NodeSpec('mixtac_alignment.force_error_node', 'force_error')
    test.start_nodes([alignment, force_error], NAMESPACE)
    test.spin_until(lambda: set(test.node.get_node_names()) >= set(PUBLISHED))
    for owner in PUBLISHED:
        # The last thing that either makes.
        test.spin_until(lambda owner=owner: '/diagnostics' in publishers(test.node, owner))
    return test.node


def publishers(node: Any, owner: str) -> dict[str, list[str]]:
    return dict(node.get_publisher_names_and_types_by_node(owner, f'/{NAMESPACE}'))


@pytest.mark.parametrize('owner', PUBLISHED)
def test_each_published_topic_has_its_type_and_qos(graph: Any, owner: str):
    for name in PUBLISHED[owner]:
        (wanted,) = (each for each in TOPICS if each.name == name)
        infos = graph.get_publishers_info_by_topic(wanted.resolved(NAMESPACE))
        assert [(info.node_name, info.topic_type) for info in infos] == [(owner, wanted.type_name)]
        qos = infos[0].qos_profile
        assert qos.reliability == ReliabilityPolicy.RELIABLE
        assert (qos.durability == DurabilityPolicy.TRANSIENT_LOCAL) == wanted.latched


@pytest.mark.parametrize('owner', PUBLISHED)
def test_nothing_else_is_published(graph: Any, owner: str):
    usual = {'/diagnostics', '/parameter_events', '/rosout'}
    own = {f'/{NAMESPACE}/{name}' for name in PUBLISHED[owner]}
    assert set(publishers(graph, owner)) - usual == own


@pytest.mark.parametrize('owner', SUBSCRIBED)
def test_each_subscription_takes_what_is_published_best_effort(graph: Any, owner: str):
    found = dict(graph.get_subscriber_names_and_types_by_node(owner, f'/{NAMESPACE}'))
    found.pop('/parameter_events', None)
    assert found == {name: [type_name] for name, type_name in SUBSCRIBED[owner].items()}
    for name in SUBSCRIBED[owner]:
        (info,) = (i for i in graph.get_subscriptions_info_by_topic(name) if i.node_name == owner)
        assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        assert info.qos_profile.durability == DurabilityPolicy.VOLATILE


def test_the_fit_is_a_trigger(graph: Any):
    (wanted,) = (service for service in SERVICES if service.name == 'alignment/fit')
    found = dict(graph.get_service_names_and_types_by_node('alignment', f'/{NAMESPACE}'))
    assert found[f'/{NAMESPACE}/{wanted.name}'] == [wanted.type_name]
