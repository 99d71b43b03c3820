# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Driver and estimator in one process: messages handed over, and the running process."""

from __future__ import annotations

import threading

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')

from std_srvs.srv import Trigger

from mixtac_cli.monitor_node import Monitor
from mixtac_cli.sensor_node import DirectPublisher, DirectTopic
from mixtac_msgs.msg import SlipState
from mixtac_node.base_node import QOS_FORCE
from mixtac_node.graph import sensor_graph


class RosPublisher:
    def __init__(self):
        self.listeners = 0
        self.sent = []

    def publish(self, message):
        self.sent.append(message)

    def get_subscription_count(self):
        return self.listeners


def test_messages_go_to_callbacks_in_the_same_thread_and_in_order():
    topic, ros, seen = DirectTopic(), RosPublisher(), []
    publisher = DirectPublisher(ros, topic)

    def note(message):
        seen.append((message, threading.get_ident()))

    topic.subscribe(note)
    for number in range(5):
        publisher.publish(number)
    assert seen == [(n, threading.get_ident()) for n in range(5)]
    assert topic.unsubscribe(note)
    assert not topic.unsubscribe(note)
    publisher.publish(9)
    assert len(seen) == 5


def test_the_middleware_gets_messages_only_while_somebody_else_listens():
    topic, ros = DirectTopic(), RosPublisher()
    publisher = DirectPublisher(ros, topic)
    topic.subscribe(lambda _: None)
    publisher.publish(1)
    ros.listeners = 2
    publisher.publish(2)
    assert ros.sent == [2]
    assert publisher.get_subscription_count() == 3


def test_a_callback_may_end_itself_and_others():
    topic, seen = DirectTopic(), []

    def first(message):
        seen.append(('first', message))
        topic.unsubscribe(first)

    topic.subscribe(first)
    topic.subscribe(lambda m: seen.append(('second', m)))
    topic.hand_over(1)
    topic.hand_over(2)
    assert seen == [('first', 1), ('second', 1), ('second', 2)]


@pytest.mark.dds
def test_one_process_has_the_nodes_topics_and_force_of_two(node_under_test, tmp_path):
    graph = sensor_graph(
        f'virtual:{tmp_path}/usb.sock', virtual_sensor={'scenario': 'idle'}, single_process=True
    )
    with Monitor('one', 60) as monitor:
        node_under_test.start_nodes(graph, 'one')
        monitor.bring_up('fger', node_under_test)
        monitor.listen()
        node_under_test.spin_until(lambda: monitor.force_count >= 250)
        _, stamps, _ = monitor.force()
        steps = stamps[1:] - stamps[:-1]
        assert (steps > 0).all()
        assert (steps % 2_000_000 == 0).all()
        monitor.trigger('fger/tare', node_under_test.check)
        assert monitor.publishers('/one/events')
        assert monitor.publishers('/one/image_raw')
        node_under_test.spin_until(lambda: {'one/driver', 'one/fger'} <= set(monitor.diagnostics))
        assert monitor.diagnostics['one/fger']['lost_packets'] == '0'


@pytest.mark.dds
def test_slip_control_answers_in_the_drivers_process(node_under_test, tmp_path):
    """Events pass within the process: the driver has no subscriber of them outside."""
    graph = sensor_graph(
        f'virtual:{tmp_path}/usb.sock',
        virtual_sensor={'scenario': 'idle'},
        slip={'learning_time': 0.2},
    )
    states = node_under_test.listen(SlipState, '/one/slip', QOS_FORCE)
    node_under_test.start_nodes([each for each in graph if each.name != 'fger'], 'one')
    node_under_test.spin_until(lambda: states and states[-1].background > 0.0)
    node = node_under_test.node
    assert [e.node_name for e in node.get_publishers_info_by_topic('/one/events')] == ['driver']
    assert not node.get_subscriptions_info_by_topic('/one/events')
    reply = node_under_test.call(Trigger, '/one/slip_control/tare')
    assert reply.success, reply.message
    node_under_test.spin_until(lambda: states[-1].background == 0.0)
