# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reconnecting: growing pauses, errors told once, a stop that always returns."""

from __future__ import annotations

import threading
import time

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_driver import supervisor as supervisor_module
from mixtac_driver.camera import Davis346
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.supervisor import State, Supervisor


@pytest.fixture(autouse=True)
def quick_settling(monkeypatch):
    monkeypatch.setattr(supervisor_module, 'REPORT_AFTER_S', 0.0)
    monkeypatch.setattr(supervisor_module, 'REPORT_ABSENCE_AFTER_S', 0.0)
    monkeypatch.setattr('mixtac_driver.davis346.writes.BIASES_SETTLE_S', 0.01)
    monkeypatch.setattr('mixtac_driver.davis346.writes.LOGIC_SETTLE_S', 0.01)


def wait_until(condition, seconds=5.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


class Watch:
    """A supervisor on a fake camera, with what it called back."""

    def __init__(self, backend, on_batch=None, **kwargs):
        self.starts, self.batches, self.errors = [], [], []
        p = DriverParameters(stream_timeout=0.3, recovery_first_pause=0.02)
        self.camera = Davis346(p, backend=backend)
        self.supervisor = Supervisor(
            self.camera,
            p,
            on_start=lambda: self.starts.append(time.monotonic()),
            on_batch=on_batch or self.batches.append,
            on_error=self.errors.append,
            **kwargs,
        )
        self.supervisor.start()


def test_camera_that_comes_late_is_found():
    backend = FakeBackend()
    watch = Watch(backend)
    wait_until(lambda: watch.supervisor.failures >= 2)
    wait_until(lambda: len(watch.errors) == 1)
    backend.cameras = (FakeCamera(),)
    wait_until(lambda: watch.batches)
    assert watch.supervisor.state is State.STREAMING
    assert not watch.supervisor.error
    assert watch.supervisor.stop()
    assert watch.supervisor.state is State.STOPPED


@pytest.mark.parametrize('moment_s', [0.0, 0.005, 0.015, 0.03, 0.1])
def test_stop_returns_whenever_it_is_called(moment_s):
    fake = FakeCamera()
    watch = Watch(FakeBackend(fake))
    time.sleep(moment_s)
    assert watch.supervisor.stop()
    assert fake.handles == 0


def test_consumer_that_hangs_does_not_keep_stop_from_returning(monkeypatch):
    monkeypatch.setattr(supervisor_module, 'STOP_TIMEOUT_S', 0.1)
    release = threading.Event()
    watch = Watch(FakeBackend(FakeCamera()), on_batch=lambda _b: release.wait(10))
    wait_until(lambda: watch.supervisor.state is State.STREAMING)
    assert not watch.supervisor.stop()
    release.set()
    assert watch.supervisor.stop()


def test_a_camera_that_goes_away_shortly_before_the_stop_is_not_reported(monkeypatch):
    monkeypatch.setattr(supervisor_module, 'REPORT_AFTER_S', 1000.0)
    fake = FakeCamera()
    watch = Watch(FakeBackend(fake))
    wait_until(lambda: watch.batches)
    fake.unplug()
    wait_until(lambda: watch.supervisor.failures >= 2)
    assert watch.supervisor.stop()
    assert watch.errors == []


def test_a_camera_that_comes_soon_is_not_reported_as_missing(monkeypatch):
    monkeypatch.setattr(supervisor_module, 'REPORT_ABSENCE_AFTER_S', 1000.0)
    backend = FakeBackend()
    watch = Watch(backend)
    wait_until(lambda: watch.supervisor.failures >= 2)
    backend.cameras = (FakeCamera(),)
    wait_until(lambda: watch.batches)
    assert watch.errors == []
    assert watch.supervisor.stop()


def test_an_outage_is_reported_once_the_stream_is_back(monkeypatch):
    monkeypatch.setattr(supervisor_module, 'REPORT_AFTER_S', 1000.0)
    fake = FakeCamera()
    watch = Watch(FakeBackend(fake))
    wait_until(lambda: watch.batches)
    fake.unplug()
    wait_until(lambda: watch.supervisor.failures)
    fake.error, fake.claimed = None, False
    wait_until(lambda: watch.supervisor.reconnects)
    assert watch.errors
    assert watch.supervisor.stop()
