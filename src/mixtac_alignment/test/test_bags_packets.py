# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events of serialised packets, batched, against the packets one by one."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_alignment.bags import PacketCollector
from mixtac_alignment.errors import GapError
from mixtac_alignment.histories import BIN_US
from mixtac_events.arrays import Events
from mixtac_events.codec import encode
from mixtac_events.packets import CodecError, EncodedPacket
from mixtac_recordings.bag import typestore
from mixtac_recordings.recording import RecordingError

STORE = typestore()
TYPE = 'event_camera_msgs/msg/EventPacket'


def serialised(
    events: Events, until: int, seq: int, frame: str = 'camera', bigendian: bool = False
) -> bytes:
    return message_of(encode(events, complete_until=until), seq, frame, bigendian)


def message_of(
    packet: EncodedPacket, seq: int, frame: str = 'camera', bigendian: bool = False
) -> bytes:
    stamp = STORE.types['builtin_interfaces/msg/Time'](1, 2)
    message = STORE.types[TYPE](
        STORE.types['std_msgs/msg/Header'](stamp, frame),
        260,
        346,
        seq,
        packet.time_base,
        packet.encoding,
        bigendian,
        packet.payload,
    )
    return bytes(STORE.serialize_cdr(message, TYPE))


def some_events(rng: np.random.Generator, start: int, count: int, span: int = 1000) -> Events:
    return Events(
        np.sort(start + rng.integers(0, span, count)).astype(np.int64),
        rng.integers(0, 346, count).astype(np.uint16),
        rng.integers(0, 260, count).astype(np.uint16),
        rng.random(count) < 0.5,
    )


def test_other_byte_orders_of_events_are_refused() -> None:
    collector = PacketCollector(60.0)
    with pytest.raises(CodecError):
        collector.add(
            serialised(some_events(np.random.default_rng(0), 10, 4), 2000, 0, bigendian=True)
        )


def test_batches_hold_every_event_and_mark_what_was_lost() -> None:
    rng = np.random.default_rng(3)
    parts = [some_events(rng, 1_000_000 + 1000 * k, int(rng.integers(0, 30))) for k in range(700)]
    collector = PacketCollector(60.0)
    for k, part in enumerate(parts):
        if k != 400:
            collector.add(serialised(part, 1_000_000 + 1000 * (k + 1), k))
    kept = [part for k, part in enumerate(parts) if k != 400]
    times = np.concatenate([part.t for part in kept])
    events, counts = collector.events(), collector.counts('here')
    assert events.t_us.tolist() == times.tolist()
    assert events.on.tolist() == np.concatenate([part.polarity for part in kept]).tolist()
    assert counts.start_us == int(times.min()) // BIN_US * BIN_US
    wanted = np.bincount(times // BIN_US - counts.start_us // BIN_US, minlength=len(counts.counts))
    assert counts.counts.tolist() == wanted.tolist()
    lost = (1_400_000 - counts.start_us) // BIN_US
    assert counts.lost_near(lost, 0)
    assert not counts.lost_near(lost - 10, 0)


def test_packets_before_the_first_known_time_of_evt3_do_not_count() -> None:
    collector = PacketCollector(60.0)
    for seq, words in enumerate(([0x6C18, 0x2000], [0x84C5, 0x6001, 0x2000])):
        payload = np.array(words, np.uint16).view(np.uint8)
        collector.add(message_of(EncodedPacket('evt3', 0, payload), seq))
    assert collector.counts('here').start_us == ((0x4C5 << 12) + 1) // BIN_US * BIN_US


def test_no_packets_are_an_error_that_names_the_place() -> None:
    with pytest.raises(RecordingError):
        PacketCollector(60.0).counts('here')


@pytest.mark.parametrize('jump_us', [-2_000_000, 1_700_000_000_000_000])
def test_a_camera_clock_that_jumps_is_refused(jump_us: int) -> None:
    rng = np.random.default_rng(6)
    collector = PacketCollector(60.0)
    collector.add(serialised(some_events(rng, 5_000_000, 10), 5_001_000, 0))
    collector.add(serialised(some_events(rng, 5_400_000, 10), 5_401_000, 1))
    with pytest.raises(GapError):
        collector.add(serialised(some_events(rng, 5_401_000 + jump_us, 10), 5_402_000 + jump_us, 2))


def test_a_driver_that_was_started_anew_is_refused() -> None:
    rng = np.random.default_rng(6)
    collector = PacketCollector(60.0)
    collector.add(serialised(some_events(rng, 5_000_000, 10), 5_001_000, 41))
    with pytest.raises(GapError):
        collector.add(serialised(some_events(rng, 5_071_000, 10), 5_072_000, 0))
