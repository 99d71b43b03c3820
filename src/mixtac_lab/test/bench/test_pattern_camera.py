# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A camera that sends a pattern answers reads as the real one does."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from usb_oracle import decode

from mixtac_lab.bench.pattern import STEP_US, PatternCamera, make_pattern
from mixtac_sim.usb import endpoints
from mixtac_sim.usb.faults import UsbTimeout

RUN = ((0, 3), (9, 0), (0, 1), (0, 0))
BUFFER = 1 << 16
EVENTS = 65


@pytest.fixture
def camera():
    """One event per millisecond, so that most early packet delays pass without any."""
    made = PatternCamera('P0000001', make_pattern(1000.0, events_per_row=1.0))
    yield made
    made.unplug()


def run(camera):
    for module, param in RUN:
        camera.control(0x40, 0xBF, module, param, struct.pack('>I', 1))


def test_a_read_that_begins_in_a_pause_is_answered_by_what_comes_after(camera):
    run(camera)
    parts = [camera.read_bulk(endpoints.DATA_ENDPOINT, BUFFER, 20.0) for _ in range(2 * EVENTS)]
    words = np.frombuffer(b''.join(parts), '<u2')
    assert len(decode(words).events) > EVENTS // 2


def test_without_running_there_is_nothing_to_wait_for(camera):
    with pytest.raises(UsbTimeout):
        camera.read_bulk(endpoints.DATA_ENDPOINT, BUFFER, 0.01)


def test_a_late_read_gets_what_was_sent_before_and_no_more():
    camera = PatternCamera('P0000002', make_pattern(3e5))
    now_us = 1000
    camera._clock = lambda: now_us
    run(camera)
    delay_us = 1e6 * camera._early_packet_s()
    for sent in (20, 23):
        now_us = round((sent + 0.9) * delay_us)
        words = np.frombuffer(camera.read_bulk(endpoints.DATA_ENDPOINT, BUFFER, 1.0), '<u2')
        t = [event[0] for event in decode(words).events]
        assert 0 <= sent * delay_us - camera.clock_origin_us - t[-1] <= STEP_US
