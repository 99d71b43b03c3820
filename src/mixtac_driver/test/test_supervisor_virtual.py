# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every fault of the virtual camera against camera and supervisor: named, survived, restored."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip('mixtac_sim.usb.device')

from faulty_camera import Fault
from virtual_scene import Scene

from mixtac_driver.camera import Davis346
from mixtac_driver.davis346.writes import register_writes
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.supervisor import State, Supervisor
from mixtac_sim.usb.pyusb_backend import in_process_backend

pytestmark = pytest.mark.live
GARBAGE_WRAP = 0x7FFF


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr('mixtac_driver.davis346.writes.BIASES_SETTLE_S', 0.01)
    monkeypatch.setattr('mixtac_driver.davis346.writes.LOGIC_SETTLE_S', 0.01)
    monkeypatch.setattr('mixtac_driver.usb.protocol.CONTROL_TIMEOUT_MS', 50)


class Rig:
    """A scene, a camera on it, a supervisor, and everything that was published."""

    def __init__(self):
        self.scene = Scene()
        self.device = self.scene.device
        self.times, self.errors, self.starts = [], [], []
        p = DriverParameters(stream_timeout=1.5)
        self.camera = Davis346(p, backend=in_process_backend(self.device))
        self.supervisor = Supervisor(
            self.camera,
            on_start=lambda: self.starts.append(len(self.times)),
            on_batch=lambda batch: self.times.append(batch.time_us),
            on_error=self.errors.append,
        )
        self.supervisor.start()
        self.wait_for_stream()

    def wait_until(self, condition, seconds=60.0):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, (self.supervisor.state, self.errors)
            time.sleep(0.002)

    def wait_for_stream(self):
        before = len(self.times)
        self.wait_until(lambda: len(self.times) > before + 5)

    def check(self):
        """Stop, and look whether everything is as it should be."""
        writes = register_writes(self.camera.control.parameters, self.camera.identity)
        wanted = {(write.module, write.parameter): write.value for write in writes}
        assert {address: self.device.register(*address) for address in wanted} == wanted
        assert self.times == sorted(self.times)
        assert self.supervisor.state is State.STREAMING

    def close(self):
        assert self.supervisor.stop()
        self.scene.close()


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.close()


@pytest.mark.parametrize(
    ('fault', 'kind'),
    [
        (Fault('stall', count=15), 'StallError'),
        (Fault('frozen'), 'StreamError'),
        (Fault('frozen', seconds=2.0), 'StreamError'),
        (Fault('babble', count=1), 'BusError'),
        (Fault('bus error', count=3), 'BusError'),
    ],
)
def test_failures_that_end_a_stream_are_named_and_the_stream_comes_back(rig, fault, kind):
    rig.camera.apply(DriverParameters(aps_exposure=7777))
    rig.device.inject(fault)
    rig.wait_until(lambda: rig.supervisor.failures_by_kind)
    rig.wait_until(lambda: rig.supervisor.reconnects and not rig.supervisor.error)
    rig.wait_for_stream()
    assert kind in rig.supervisor.failures_by_kind
    rig.wait_until(lambda: rig.errors)
    assert rig.device.exposure_us == 7777
    rig.check()


@pytest.mark.parametrize(
    'fault',
    [
        Fault('stall', count=3),
        Fault('short', seconds=0.2),
        Fault('lost', count=1),
        Fault('frozen', seconds=0.1),
        Fault('hung', seconds=0.2),
    ],
)
def test_lesser_faults_do_not_end_the_stream(rig, fault):
    # A busy computer may have taken more than one start.
    starts = len(rig.starts)
    rig.device.inject(fault)
    time.sleep(0.25)
    rig.wait_for_stream()
    assert len(rig.starts) == starts
    assert rig.camera.transport_counters.stalls == (3 if fault.kind == 'stall' else 0)
    rig.check()


def test_time_that_garbage_threw_ahead_is_not_published(rig):
    rig.device.feed(np.array([GARBAGE_WRAP], np.uint16))
    rig.wait_until(lambda: rig.supervisor.reconnects)
    rig.wait_for_stream()
    assert 'ahead' in rig.errors[0]
    assert rig.times[-1] < time.time_ns() // 1000 + 1_000_000
    rig.check()


@pytest.mark.parametrize(
    ('kind', 'name'),
    [
        ('refused', 'StallError'),
        ('no answer', 'NoAnswerError'),
        ('garbage', 'UnsupportedCameraError'),
    ],
)
def test_camera_that_is_ill_when_plugged_in_is_opened_when_it_is_well(rig, kind, name):
    rig.device.unplug()
    rig.wait_until(lambda: rig.supervisor.failures_by_kind)
    rig.device.plug_in()
    rig.device.inject(Fault(kind))
    rig.wait_until(lambda: name in rig.supervisor.failures_by_kind)
    assert rig.supervisor.state is not State.STREAMING
    rig.device.clear_faults()
    rig.wait_for_stream()
    rig.check()


def test_another_camera_in_its_place_is_taken_and_identified(rig):
    rig.device.unplug()
    rig.wait_until(lambda: rig.supervisor.failures_by_kind)
    rig.device.plug_in('V0000099')
    rig.wait_until(lambda: rig.supervisor.reconnects)
    assert 'DisconnectedError' in rig.supervisor.failures_by_kind
    assert rig.camera.identity.serial == 'V0000099'
    rig.check()
