# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording of a real camera, made by another driver, across a roll-over of its clock."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixtac_events.codec import decode_message

RECORDING = Path(__file__).parents[4] / 'shared' / 'data' / 'libcaer_rollover_0.db3'
EVENT_PACKET = """\
std_msgs/Header header
uint32 height
uint32 width
uint64 seq
uint64 time_base
string encoding
bool is_bigendian
uint8[] events
"""


@pytest.mark.skipif(not RECORDING.exists(), reason=f'no recording at {RECORDING}')
def test_real_recording_decodes_across_the_roll_over() -> None:
    import sqlite3

    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = 'event_camera_msgs/msg/EventPacket'
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(EVENT_PACKET, name))
    with sqlite3.connect(f'file:{RECORDING}?mode=ro', uri=True) as database:
        rows = database.execute('SELECT data FROM messages ORDER BY timestamp, id').fetchall()
    messages = [store.deserialize_cdr(data, name) for (data,) in rows]
    assert len(messages) == 201
    packets = [decode_message(message) for message in messages]
    t = np.concatenate([packet.events.t for packet in packets])
    x = np.concatenate([packet.events.x for packet in packets])
    y = np.concatenate([packet.events.y for packet in packets])
    assert {(message.width, message.height) for message in messages} == {(640, 480)}
    assert int(x.max()) < 640
    assert int(y.max()) < 480
    assert len({message.time_base for message in messages}) == 2, 'the clock rolls over once'
    assert np.all(np.diff(t) >= 0)
    assert 1.95e6 < t[-1] - t[0] < 2.05e6
    assert 330_000 < t.size < 340_000
    assert all(packet.complete_until == packet.events.t[-1] for packet in packets)
