# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings that change while a camera is open, on a fake USB camera."""

from __future__ import annotations

import threading
import time

import pytest
from davis_fake import FakeBackend, FakeCamera
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_driver.camera import Davis346
from mixtac_driver.davis346.control import COUNTERS, read_64
from mixtac_driver.errors import DriverError, UsbError
from mixtac_driver.parameters import DriverParameters


@pytest.fixture(autouse=True)
def quick_settling(monkeypatch):
    monkeypatch.setattr('mixtac_driver.davis346.writes.BIASES_SETTLE_S', 0.0)
    monkeypatch.setattr('mixtac_driver.davis346.writes.LOGIC_SETTLE_S', 0.0)


@pytest.fixture
def fake():
    return FakeCamera()


@pytest.fixture
def camera(fake):
    with Davis346(backend=FakeBackend(fake)) as camera:
        fake.log.clear()
        yield camera


def test_the_generator_starts_with_its_new_settings_and_stops_before_they_change(camera, fake):
    camera.apply(DriverParameters(generator_enabled=True, generator_interval=100))
    assert fake.writes() == [(4, 13, 12096), (4, 11, 1)]
    fake.log.clear()
    camera.apply(DriverParameters())
    assert fake.writes() == [(4, 11, 0), (4, 13, 1210)]


def test_a_region_of_frames_is_taken_at_once_while_they_are_off(camera, fake):
    region = [(2, 8, 10), (2, 9, 20), (2, 10, 345), (2, 11, 259)]
    camera.apply(DriverParameters(aps_roi_start_col=10, aps_roi_start_row=20))
    assert fake.log == [('many', 5), *(('write', *w) for w in [(2, 4, 0), *region])]
    camera.start()
    fake.log.clear()
    camera.apply(DriverParameters(aps_roi_start_col=10, aps_roi_start_row=20, aps_roi_end_col=300))
    region[2] = (2, 10, 300)
    assert fake.log == [('many', 6), *(('write', *w) for w in [(2, 4, 0), *region, (2, 4, 1)])]


def test_sensors_are_switched_while_the_camera_streams(camera, fake):
    camera.apply(DriverParameters(dvs_enabled=False))
    assert fake.writes() == []
    camera.start()
    assert fake.registers[1, 3] == 0
    fake.log.clear()
    camera.apply(DriverParameters(aps_enabled=False, imu_temp_enabled=False))
    assert fake.writes() == [(1, 3, 1), (2, 4, 0), (3, 4, 0)]
    camera.stop()
    fake.log.clear()
    camera.apply(DriverParameters())
    assert fake.writes() == []


def test_a_request_that_fails_sets_back_what_was_written(camera, fake):
    fake.refused.add((2, 13))
    with pytest.raises(UsbError) as error:
        camera.apply(DriverParameters(aps_exposure=1000, aps_frame_interval=20000))
    assert '2:13' in str(error.value)
    assert fake.registers[2, 12] == 211_680
    assert camera.control.parameters == DriverParameters()
    fake.refused.clear()
    fake.log.clear()
    # Whether the refused one was obeyed is not known, so it is written anew.
    camera.apply(DriverParameters())
    assert fake.writes() == [(2, 13, 1_209_600)]


@settings(max_examples=50)
@given(
    st.lists(
        st.tuples(
            st.builds(
                DriverParameters,
                dvs_enabled=st.booleans(),
                aps_enabled=st.booleans(),
                aps_exposure=st.integers(1, 4_194_303),
                aps_global_shutter=st.booleans(),
                roi_start_col=st.integers(0, 100),
                roi_start_row=st.integers(0, 100),
                aps_roi_start_col=st.integers(0, 100),
                aps_roi_start_row=st.integers(0, 100),
                generator_enabled=st.booleans(),
            ),
            st.lists(st.tuples(st.integers(0, 345), st.integers(0, 259)), max_size=8).map(tuple),
        ),
        max_size=4,
    )
)
def test_any_path_of_changes_ends_in_the_registers_of_a_fresh_start(changes):
    changed, fresh = FakeCamera(), FakeCamera()
    with Davis346(backend=FakeBackend(changed)) as camera:
        camera.start()
        for parameters, pixel_filter in changes:
            camera.apply(parameters, pixel_filter)
        final, pixels = changes[-1] if changes else (DriverParameters(), ())
        with Davis346(final, pixel_filter=pixels, backend=FakeBackend(fresh)) as other:
            other.start()
            for address, value in fresh.registers.items():
                assert changed.registers.get(address, 0) == value, address


def test_exposure_waits_for_nobody(camera, fake):
    entered, leave = threading.Event(), threading.Event()

    def slow():
        entered.set()
        leave.wait(10)

    thread = threading.Thread(target=lambda: camera.control.start(slow))
    thread.start()
    assert entered.wait(10)
    assert not camera.control.set_exposure(1000)
    leave.set()
    thread.join(10)
    assert camera.control.set_exposure(1000)


def test_a_frame_is_asked_for_only_where_none_come(camera, fake):
    camera.start()
    with pytest.raises(DriverError):
        camera.control.request_frame()
    fake.send([0x8064, 0x1001, 0x2001])
    next(each for each in camera.batches() if each.origin is not None)
    fake.log.clear()
    camera.control.request_frame()
    assert fake.log == []
    camera.apply(DriverParameters(aps_enabled=False))
    fake.log.clear()
    camera.control.request_frame()
    assert fake.log == [('many', 2), ('write', 2, 4, 1), ('write', 2, 4, 0)]


def test_counters_are_64_bits_upper_half_first():
    halves = {(int(m), int(p) + 1): k for k, (m, p) in enumerate(COUNTERS.values())}
    fake = FakeCamera(registers={**halves, (1, 81): 1})
    with Davis346(backend=FakeBackend(fake)) as camera:
        counted = camera.control.statistics()
    assert counted == {**{name: k for k, name in enumerate(COUNTERS)}, 'rows': 1 << 32}


class Ticking:
    """A 64-bit counter that goes on with every read of one of its halves."""

    def __init__(self, value):
        self.value = value

    def read(self, _module, parameter):
        self.value += 1
        value = self.value - 1
        return value >> 32 if parameter == 83 else value & 0xFFFFFFFF


@pytest.mark.parametrize('start', [(1 << 32) - 3, (1 << 32) - 2, (1 << 32) - 1, 1 << 32, 5])
def test_an_overflow_between_the_halves_is_noticed(start):
    counter = Ticking(start)
    assert start <= read_64(counter, 1, 83) <= counter.value


def test_clock_is_reset_when_asked_and_published_time_goes_on(camera, fake):
    with pytest.raises(DriverError):
        camera.control.reset_timestamps()
    camera.start()
    batches = camera.batches()
    fake.send([0x8064, 0x1001, 0x2001])
    times = []
    while not times:
        batch = next(batches)
        times += (batch.decoded.events.t + batch.origin.us).tolist()
    before_us = time.time_ns() // 1000
    camera.control.reset_timestamps()
    after_us = time.time_ns() // 1000
    fake.send([0x8003, 0x1001, 0x2001])
    while len(times) < 2:
        batch = next(batches)
        times += (batch.decoded.events.t + batch.origin.us).tolist()
    assert times[1] > times[0]
    assert before_us <= batch.origin.us <= after_us
    assert batch.origin.uncertainty_ns <= (after_us - before_us) * 500 + 1500
    assert camera.clock_resets == 0
