# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver on a real libusb while the bus fails: stalls, errors, babble, silence, unplugging."""

from __future__ import annotations

import json
import sys
import threading
import time
from functools import partial

import pytest
from faulty_camera import Fault, FaultyDavis346
from umockdev_session import HERE, Camera, bridged, need_umockdev

pytestmark = pytest.mark.umockdev
PATIENCE_S = 90.0


class Session:
    """The driver in a process of its own, on a virtual camera whose time runs."""

    def __init__(self, folder):
        self.camera = Camera(folder, FaultyDavis346)
        self.report, self.done = folder / 'report.json', folder / 'stop'
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        while not self.stopping.wait(0.002):
            self.camera.device.advance(self.camera.now())

    def figures(self):
        return json.loads(self.report.read_text()) if self.report.exists() else {'batches': 0}

    def wait_until(self, condition):
        deadline = time.monotonic() + PATIENCE_S
        while not condition(self.figures()):
            assert time.monotonic() < deadline, self.figures()
            time.sleep(0.01)
        return self.figures()

    def wait_for_stream(self):
        before = self.figures()['batches']
        return self.wait_until(lambda now: now['batches'] > before + 5)

    def fail(self, kind, cause):
        """Cause a failure until it is seen."""
        before = self.figures()['failures'].get(kind, 0)
        cause()
        self.wait_until(lambda now: now['failures'].get(kind, 0) > before)
        self.camera.device.clear_faults()

    def close(self):
        self.stopping.set()
        self.thread.join()


@pytest.fixture
def session(tmp_path):
    need_umockdev()
    session = Session(tmp_path)
    yield session
    session.close()


def test_driver_streams_on_after_every_failure_of_the_bus(session):
    device = session.camera.device
    inject = device.inject
    script = str(HERE / 'umockdev_recovery_client.py')
    arguments = str(session.report), str(session.done)
    with bridged(session.camera, sys.executable, script, *arguments) as process:
        session.wait_for_stream()
        inject(Fault('stall', count=1))
        session.wait_until(lambda now: now['stalls'])
        figures = session.wait_for_stream()
        assert (figures['failures'], figures['reconnects']) == ({}, 0)
        held = figures['held']
        for fault, kind in (
            ('stall', 'StallError'),
            ('bus error', 'BusError'),
            ('babble', 'BusError'),
            ('frozen', 'StreamError'),
        ):
            session.fail(kind, partial(inject, Fault(fault)))
            session.wait_for_stream()
        session.fail('DisconnectedError', device.unplug)
        device.plug_in()
        session.wait_for_stream()
        session.wait_until(lambda now: now['held'] == held)
        session.done.touch()
        assert process.wait(PATIENCE_S) == 0
