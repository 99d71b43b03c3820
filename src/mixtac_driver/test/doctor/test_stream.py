# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the doctor measures on a running virtual camera, and how it judges figures."""

from __future__ import annotations

import dataclasses
import functools
import math

import pytest
from davis_fake import FakeBackend, FakeCamera
from virtual_scene import Scene

from mixtac_driver.camera import Davis346
from mixtac_driver.doctor.computer import Level
from mixtac_driver.doctor.stream import Measurement, check_measurement, check_running
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.usb.transport import TransportCounters
from mixtac_events.clock_map import ClockEstimate
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.pyusb_backend import in_process_backend
from mixtac_sim.usb.registers import Board

GOOD = Measurement(
    seconds=2.0,
    elapsed_s=2.0,
    events=100_000,
    frames=50,
    samples=2000,
    edges=0,
    size=20_000_000,
    gaps_ms=(1.0, 2.0),
    losses={},
    transport=TransportCounters(transfers=2000, size=20_000_000),
    clock=ClockEstimate(
        offset_us=0.0, skew_ppm=12.0, residual_us=50.0, span_s=11.0, pairs=2000, steps=0
    ),
    clock_resets=0,
)


@functools.cache
def identity():
    with Davis346(backend=FakeBackend(FakeCamera())) as camera:
        return camera.identity


def judge(name, imu_type=2, **changes):
    """Return the finding of that name on the good measurement with changes."""
    result = dataclasses.replace(GOOD, **changes)
    findings = check_measurement(
        result, DriverParameters(), dataclasses.replace(identity(), imu_type=imu_type)
    )
    return {finding.name: finding for finding in findings}[name]


def test_a_good_camera_has_nothing_to_mend():
    findings = check_measurement(GOOD, DriverParameters(), identity())
    assert [f.level for f in findings] == [Level.OK] * 8
    assert not any(f.remedy for f in findings)


@pytest.mark.parametrize(
    ('name', 'changes', 'level'),
    [
        ('events', {'events': 0}, Level.WARN),
        ('frames', {'frames': 0}, Level.ERROR),
        ('frames', {'frames': 40}, Level.WARN),
        ('frames', {'frames': 45}, Level.OK),
        ('inertial samples', {'samples': 0}, Level.ERROR),
        ('inertial samples', {'samples': 1500}, Level.WARN),
        ('inertial samples', {'samples': 0, 'imu_type': 0}, Level.OK),
        ('transfers', {'gaps_ms': (1.0, 30.0)}, Level.WARN),
        ('transfers', {'transport': TransportCounters(stalls=1)}, Level.WARN),
        ('losses', {'losses': {'frames_dropped': 2}}, Level.WARN),
        ('losses', {'transport': TransportCounters(dropped_transfers=3)}, Level.WARN),
        ('losses', {'elapsed_s': 3.0}, Level.WARN),
        ('camera clock', {'clock': None}, Level.WARN),
        ('camera clock', {'clock_resets': 1}, Level.WARN),
    ],
)
def test_figures_are_judged(name, changes, level):
    finding = judge(name, **changes)
    assert finding.level is level
    assert bool(finding.remedy) == (level > Level.OK)


@pytest.mark.parametrize(
    ('changes', 'level'),
    [
        ({'skew_ppm': -150.0}, Level.WARN),
        ({'residual_us': 2000.0}, Level.WARN),
        ({'span_s': 2.0}, Level.OK),
    ],
)
def test_the_clock_is_judged(changes, level):
    clock = dataclasses.replace(GOOD.clock, **changes)
    finding = judge('camera clock', clock=clock)
    assert finding.level is level
    known = clock.span_s > 10
    assert finding.values['skew [ppm]'] == (clock.skew_ppm if known else None)


def test_figures_of_nothing_are_no_numbers_and_no_crash():
    finding = judge('transfers', gaps_ms=(math.nan, math.nan), elapsed_s=0.0, seconds=0.0)
    assert finding.level is Level.OK


@pytest.fixture
def scene():
    scene = Scene()
    yield scene
    scene.close()


def test_a_running_camera_is_measured(scene):
    backend = in_process_backend(scene.device)
    found = {f.name: f for f in check_running('virtual', 0.6, backend=backend)}
    assert found['identity'].values['serial'] == 'V0000042'
    assert found['identity'].values['chip'] == 'DAVIS346B'
    # The scene has 20,000 events, 25 frames and 200 inertial samples per second.
    assert found['events'].values['events [1/s]'] == pytest.approx(20_000, rel=0.3)
    assert found['frames'].values['frames [1/s]'] == pytest.approx(25, abs=5)
    samples = found['inertial samples']
    assert samples.level is Level.WARN
    assert samples.values['inertial samples [1/s]'] == pytest.approx(200, rel=0.1)
    assert found['transfers'].values['usb [MB/s]'] > 5
    assert found['losses'].values['transfers_dropped'] == 0
    # It was given back: another may have it at once.
    assert next(check_running('virtual', 0.1, backend=backend)).name == 'identity'


def test_a_camera_that_is_in_use_is_named(scene):
    scene.device.claim('somebody else')
    (finding,) = check_running('virtual', 0.1, backend=in_process_backend(scene.device))
    assert (finding.name, finding.level) == ('opening the camera', Level.ERROR)
    assert 'stop the other program' in finding.remedy


def test_a_camera_that_cannot_be_is_refused():
    device = VirtualDavis346('V0000001', board=Board(deviation=0))
    (finding,) = check_running('virtual', 0.1, backend=in_process_backend(device))
    assert (finding.name, finding.level) == ('opening the camera', Level.ERROR)
    assert finding.remedy


def test_a_camera_that_is_unplugged_meanwhile(scene):
    findings = check_running('virtual', 30.0, backend=in_process_backend(scene.device))
    assert next(findings).name == 'identity'
    scene.device.unplug()
    (finding,) = findings
    assert (finding.name, finding.level) == ('data stream', Level.ERROR)
