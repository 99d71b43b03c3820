# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the demo reads from its bag, losses included."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_cli.demo.evaluation import read_streams
from mixtac_events.arrays import Events
from mixtac_events.codec import encode
from mixtac_node import topics
from mixtac_recordings.bag import blank_message, typestore
from mixtac_recordings.bag_writer import McapBag


@pytest.mark.parametrize(
    ('numbers', 'lost'),
    [((5, 6, 9), 2), ((5, 6, 0, 1), 0), ((5, 8, 0, 1, 3), 3)],
    ids=['gap', 'restart', 'gaps around a restart'],
)
def test_lost_packets_with_a_restart_of_the_driver(tmp_path, numbers, lost):
    forces = (topics.FORCE, topics.REFERENCE_WRENCH, topics.TRUTH_WRENCH)
    with McapBag(tmp_path / 'bag') as writer:
        handles = {
            topic: writer.add_connection(
                topic.resolved('mixtac'), topic.type_name, typestore=typestore()
            )
            for topic in (topics.EVENTS, *forces)
        }

        def write(topic, message, received_ns):
            data = typestore().serialize_cdr(message, topic.type_name)
            writer.write(handles[topic], received_ns, data)

        for topic in forces:
            write(topic, blank_message(topic.type_name), 0)
        for index, number in enumerate(numbers):
            t = np.array([1000 * index], np.int64)
            pixel = np.zeros(1, np.uint16)
            encoded = encode(Events(t, pixel, pixel, np.ones(1, np.bool_)))
            message = blank_message(topics.EVENTS.type_name)
            message.width, message.height, message.seq = 346, 260, number
            message.encoding, message.time_base = encoded.encoding, encoded.time_base
            message.events = np.frombuffer(encoded.payload, np.uint8)
            write(topics.EVENTS, message, 1_000_000 * index)
    streams = read_streams(tmp_path / 'bag', 'mixtac')
    assert streams.packets == len(numbers)
    assert streams.lost_packets == lost
