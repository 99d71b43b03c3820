# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event packets serialised by rosbags."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('ament_index_python', reason='needs the message definitions of the workspace')

from mixtac_core.recordings.bag import typestore

STORE = typestore()
KIND = 'event_camera_msgs/msg/EventPacket'


def packet(seq: int, frame: str, encoding: str, sec: int, nanosec: int, *, big: bool) -> bytes:
    header = STORE.types['std_msgs/msg/Header'](
        stamp=STORE.types['builtin_interfaces/msg/Time'](sec=sec, nanosec=nanosec), frame_id=frame
    )
    message = STORE.types[KIND](
        header=header,
        height=260,
        width=346,
        seq=seq,
        time_base=7,
        encoding=encoding,
        is_bigendian=False,
        events=np.zeros(5, np.uint8),
    )
    return bytes(STORE.serialize_cdr(message, KIND, little_endian=not big))


@pytest.fixture(scope='session', name='packet')
def packet_fixture():
    """Return the function that serialises a packet."""
    return packet
