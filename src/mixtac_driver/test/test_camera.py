# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera object on a fake USB camera: opening, streaming, faults."""

from __future__ import annotations

import itertools
import time

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_core.events.windows import PACKET_PERIOD_US
from mixtac_driver.camera import Davis346
from mixtac_driver.errors import StreamError, UnsupportedCameraError
from mixtac_driver.parameters import DriverParameters

QUICK = DriverParameters(stream_timeout=0.3)


@pytest.fixture(autouse=True)
def quick_settling(monkeypatch):
    monkeypatch.setattr('mixtac_driver.davis346.writes.BIASES_SETTLE_S', 0.01)
    monkeypatch.setattr('mixtac_driver.davis346.writes.LOGIC_SETTLE_S', 0.01)


def opened(fake, parameters=None):
    return Davis346(parameters, backend=FakeBackend(fake))


def test_open_reads_what_the_camera_is():
    fake = FakeCamera()
    with opened(fake) as camera:
        identity = camera.identity
    assert (identity.serial, identity.chip, identity.logic) == ('00000123', 'DAVIS346B', (18, 1))
    assert identity.clocks.adc == pytest.approx(30.24)
    assert (identity.geometry.width, identity.geometry.height) == (346, 260)
    reads = [entry[1:] for entry in fake.log if entry[0] == 'read']
    assert reads[:5] == [(6, 0), (6, 7), (6, 1), (6, 2), (2, 3)]
    assert fake.handles == 0
    assert not fake.claimed


@pytest.mark.parametrize(
    ('change', 'value'),
    [
        ({'registers': {(6, 0): 19}}, 'logic 19.1'),
        ({'registers': {(6, 7): 0}}, 'logic 18.0'),
        ({'registers': {(6, 1): 77}}, 'chip 77'),
        ({'registers': {(2, 0): 1000}}, '1000 x 346'),
        ({'bcd_device': 0x0005}, 'firmware 0.5'),
        ({'bcd_device': 0x0100}, 'firmware 1.0'),
    ],
)
def test_cameras_of_another_kind_are_refused_and_given_back(change, value):
    fake = FakeCamera(**change)
    with pytest.raises(UnsupportedCameraError) as error:
        opened(fake).open()
    assert value in str(error.value)
    assert fake.handles == 0
    assert not fake.claimed


def test_start_and_stop_write_in_the_order_the_camera_knows():
    fake = FakeCamera()
    with opened(fake) as camera:
        fake.log.clear()
        camera.start()
        started = list(fake.log)
        fake.log.clear()
        camera.stop()
        stopped = fake.writes()
    quiet = [(1, 3, 0), (2, 4, 0), (3, 2, 0), (3, 3, 0), (3, 4, 0)]
    quiet += [(4, 0, 0), (0, 0, 0), (0, 1, 0), (9, 0, 0)]
    run = [(0, 3, 1), (9, 0, 1), (0, 1, 1), (0, 0, 1)]
    run += [(1, 3, 1), (2, 4, 1), (3, 2, 1), (3, 3, 1), (3, 4, 1), (4, 0, 1)]
    assert started == [
        *(('write', *w) for w in [*quiet, (0, 3, 0)]),
        ('clear_halt', 0x82),
        *(('write', *w) for w in run),
        ('many', 2),
        ('write', 0, 2, 1),
        ('write', 0, 2, 0),
    ]
    assert stopped == [*quiet, (0, 3, 0)]


def test_events_come_on_the_epoch_based_clock_and_only_after_the_reset():
    fake = FakeCamera()
    with opened(fake, QUICK) as camera:
        before = time.time_ns()
        fake.send([0x8005, 0x1001, 0x2002])
        camera.start()
        after = time.time_ns()
        fake.send([0x8007, 0x1003, 0x3004, 0x8000 | PACKET_PERIOD_US])
        batch = next(b for b in camera.batches() if len(b.decoded.events))
        assert batch.decoded.events.t.tolist() == [7]
        assert batch.decoded.events.x.tolist() == [3]
        assert before <= batch.origin.host_ns <= after
        assert batch.time_us == batch.origin.us + PACKET_PERIOD_US


def test_data_come_together_once_the_stream_has_passed_the_end_of_a_packet():
    fake = FakeCamera()
    with opened(fake, QUICK) as camera:
        camera.start()
        batches = camera.batches()
        start_us = next(batches).time_us
        for t in range(100, 5 * PACKET_PERIOD_US, 100):
            fake.send([0x8000 | t, 0x1003, 0x3004])
        got = list(itertools.islice(batches, 4))
        times = [batch.time_us for batch in got]
        cells = [time_us // PACKET_PERIOD_US for time_us in (start_us, *times)]
        assert cells == list(range(cells[0], cells[0] + 5))
        assert sum(len(batch.decoded.events) for batch in got) == (times[-1] - start_us) // 100


@pytest.mark.parametrize('words', [[], [0x8001] * 100])
def test_silence_and_a_reset_that_is_not_confirmed_end_the_batches(words):
    fake = FakeCamera()
    fake.answers_reset = not words
    with opened(fake, QUICK) as camera:
        camera.start()
        for word in words:
            fake.send([word])
        with pytest.raises(StreamError) as error:
            list(camera.batches())
        assert '0.3' in str(error.value)


def test_reset_on_the_sync_cable_does_not_set_published_time_back():
    fake = FakeCamera()
    with opened(fake) as camera:
        camera.start()
        fake.registers[6, 2] = 0
        fake.send([0x7002, 0x8010, 0x1001, 0x2001, 1, 0x8003, 0x1001, 0x2002])
        times, batches = [], camera.batches()
        for batch in batches:
            times += (batch.decoded.events.t + batch.origin.us).tolist()
            if len(times) == 2:
                break
        assert times[1] > times[0]
        assert camera.clock_resets == 1
        fake.send([0x8004])
        list(itertools.islice(batches, 1))
        assert not camera.is_master
        assert abs(times[1] - time.time_ns() // 1000) < 60_000_000


def test_the_map_of_the_clock_ends_with_the_clock():
    fake = FakeCamera()
    with opened(fake) as camera:
        camera.start()
        fake.send([0x7002, 0x8010, 0x1001, 0x2001])
        batches = camera.batches()
        while not camera.clock.ready:
            next(batches)
        fake.send([1, 0x8003, 0x1001, 0x2002])
        while next(batches).decoded.resets == 1:
            assert camera.clock.ready
        assert not camera.clock.ready
