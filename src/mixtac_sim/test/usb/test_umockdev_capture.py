# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drivers that know nothing of Mixtac read a captured camera, from the bundle alone."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from real_capture import real_capture, recordings
from umockdev_session import HERE, bridged, client_python, need_umockdev
from usb.core import USBError, USBTimeoutError

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_driver.errors import EndOfStream
from mixtac_driver.playback.replay import ReplayedCamera
from mixtac_driver.usb.capture import read_capture
from mixtac_sim.usb.faults import UsbStall, UsbTimeout
from mixtac_sim.usb.server import UsbServer

pytestmark = pytest.mark.umockdev

SHIPPED = Path(__file__).parents[3] / 'mixtac_driver/test/usb/virtual.zip'
FIRST = 20
HELD_US = 20_000
"""Some clients hand on events only when later ones come."""
SETTLED_US = 200_000
"""The clock of one client knows no reset and stands still until the camera's has caught up."""


class Served(ReplayedCamera):
    """A captured camera as the server of the virtual one takes it."""

    plugs = 1

    def __init__(self, capture, ready, done):
        super().__init__(capture)
        self._ready, self._done = ready, done

    def control(self, kind, number, value, index, data, limit_s=None):
        try:
            return super().control(kind, number, value, index, data)
        except USBError as error:
            raise UsbStall(str(error)) from error

    def read_into(self, endpoint, view, wait_s):
        try:
            return self.read(endpoint, view, wait_s)
        except USBTimeoutError as error:
            raise UsbTimeout(str(error)) from error
        except EndOfStream as error:
            if self._ready.exists():
                self._done.touch()
            raise UsbTimeout(str(error)) from error

    def check_present(self, plugs=None):
        pass

    claim = release = check_present

    def unplug(self):
        pass


def expected_events(capture):
    """Return the events after the first reset [n, 4], by our decoder."""
    decoder, after = StreamDecoder(Geometry()), []
    for batch in decoder.push(capture.words.tobytes()):
        e = batch.events
        if batch.resets:
            after.append(np.stack([e.t, e.x, e.y, e.polarity], axis=1).astype(np.int64))
    return np.concatenate(after)


def after_reset(events, expected):
    """Return what a client saw from the first of the expected events on."""
    first = expected[:FIRST, 1:]
    for k in range(len(events) - FIRST):
        if np.array_equal(events[k : k + FIRST, 1:], first):
            return events[k:]
    raise AssertionError('the client did not see the first events after the reset')


@pytest.mark.parametrize('source', ['virtual', 'real'])
@pytest.mark.parametrize('client', ['ours', 'libcaer', 'neuromorphic', 'dv'])
def test_a_client_reads_the_events_of_the_capture(client, source, tmp_path):
    need_umockdev()
    if source == 'real':
        (path,) = recordings('davis346_sample.aedat4')
        capture, frames, samples = real_capture(path), 4, 150
    else:
        capture, frames, samples = read_capture(SHIPPED), 10, 100
    python = client_python(client)
    ready, done = tmp_path / 'ready', tmp_path / 'done'
    camera = Served(capture, ready, done)
    served = SimpleNamespace(server=UsbServer(camera, str(tmp_path / 'camera.sock')))
    out = tmp_path / 'seen.npz'
    script = str(HERE / 'umockdev_clients.py')
    with bridged(served, python, script, client, str(out), str(ready), str(done)) as process:
        assert process.wait(60) == 0
    with np.load(out) as saved:
        seen = dict(saved)
    expected = expected_events(capture)
    events = after_reset(seen['events'], expected)
    held_back, expected = expected[len(events) :], expected[: len(events)]
    np.testing.assert_array_equal(events[:, 1:], expected[:, 1:])
    assert held_back.size == 0 or held_back[0, 0] > expected[-1, 0] - HELD_US
    assert held_back.size == 0 or np.ptp(held_back[:, 0]) < HELD_US
    late = (events[:, 0] - expected[:, 0])[expected[:, 0] > SETTLED_US]
    assert late.size == 0 or np.ptp(late) == 0
    assert len(seen['frame_times']) >= frames
    assert len(seen['imu']) > samples
