# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages handed over within a process."""

from __future__ import annotations

import threading

from mixtac_cli.sensor_node import DirectPublisher, DirectTopic


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
    subscription = topic.subscribe(lambda m: seen.append((m, threading.get_ident())))
    for number in range(5):
        publisher.publish(number)
    assert seen == [(n, threading.get_ident()) for n in range(5)]
    topic.unsubscribe(subscription)
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
    handles = {}

    def first(message):
        seen.append(('first', message))
        topic.unsubscribe(handles['first'])

    handles['first'] = topic.subscribe(first)
    topic.subscribe(lambda m: seen.append(('second', m)))
    topic.hand_over(1)
    topic.hand_over(2)
    assert seen == [('first', 1), ('second', 1), ('second', 2)]
