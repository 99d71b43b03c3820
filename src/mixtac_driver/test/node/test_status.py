# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the driver says of itself, with a fake camera."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace

import pytest

pytest.importorskip('diagnostic_msgs.msg')

from davis_fake import FakeBackend, FakeCamera

from mixtac_core.events.clock_map import ClockEstimate
from mixtac_core.node.diagnostics import ERROR, OK, WARN
from mixtac_driver.camera import Davis346
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.node.status import DriverMeters, DriverStatus
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.pixels import PixelMask
from mixtac_driver.supervisor import State


@pytest.fixture
def fake():
    return FakeCamera(registers={(1, 84): 1000})


@pytest.fixture
def camera(fake):
    with Davis346(backend=FakeBackend(fake)) as camera:
        yield camera


@pytest.fixture
def supervisor():
    return SimpleNamespace(
        state=State.STREAMING, error='', failures=2, failures_by_kind=Counter(UsbError=2),
        reconnects=1, outage_s=0.25, quiet_s=0.0,
    )  # fmt: skip


@pytest.fixture
def meters():
    return DriverMeters()


@pytest.fixture
def status(camera, supervisor, meters):
    settings = DriverSettings(DriverParameters())
    settings.use_mask(PixelMask([(1, 1), (2, 2)], (346, 260)), lambda *_settings: None)
    return DriverStatus(camera, supervisor, settings, meters)


def test_a_sound_stream_is_ok_and_told_in_figures(status):
    said = status.status()
    assert (said.level, said.message) == (OK, 'streaming')
    values = said.values
    assert (values['serial'], values['firmware'], values['logic']) == ('00000123', '0.6', '18.1')
    assert (values['pixels masked'], values['events masked on the host']) == (2, 0)
    assert values['camera dvs dropped'] == 0
    assert (values['failures UsbError'], values['reconnects']) == (2, 1)
    assert 'temperature [C]' not in values


def test_what_the_camera_dropped_is_a_warning_until_it_stops(status, fake):
    # Dropped in an earlier session.
    fake.registers[0, 84] = 5
    assert status.status().level == OK
    fake.registers[0, 84] = 9
    said = status.status()
    assert (said.level, said.values['camera dvs dropped']) == (WARN, 9)
    # Plugged in anew, it counts from zero.
    fake.registers[0, 84] = 0
    assert status.status().level == OK


def test_no_stream_is_an_error_with_its_reason(status, supervisor, camera):
    supervisor.quiet_s = 7.0
    assert status.status().level == ERROR
    supervisor.state, supervisor.error = State.WAITING, 'the camera was unplugged'
    camera.close()
    said = status.status()
    assert (said.level, said.message) == (ERROR, 'the camera was unplugged')
    assert said.values['serial'] == '00000123'
    assert 'camera dvs dropped' not in said.values
    supervisor.state = State.ENDED
    assert status.status().level == OK


def test_an_outage_between_two_reports_is_a_warning_once(status, supervisor):
    assert status.status().level == OK
    supervisor.reconnects += 1
    assert status.status().level == WARN
    assert status.status().level == OK


@pytest.mark.parametrize(('steps', 'level'), [(0, OK), (1, WARN)])
def test_a_clock_that_stepped_is_a_warning(status, meters, steps, level):
    clock = ClockEstimate(0.0, 0.0, span_s=1.0, steps=steps)
    meters.clock = clock, 1_760_000_000_000_000
    assert [status.status().level for _ in range(3)] == [level] * 3
