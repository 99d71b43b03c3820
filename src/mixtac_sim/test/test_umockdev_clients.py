# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drivers that know nothing of Mixtac read the virtual camera and see what was put in.

Their libusb talks to umockdev, a bridge forwards to the virtual camera's socket. Run by name of an
interpreter with the clients: ``MIXTAC_CLIENT_PYTHON``, else the running one if it has them.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import mixtac_sim.usb.wire
from mixtac_events.arrays import Events
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.imu_words import ImuReading
from mixtac_sim.usb.server import UsbServer

pytestmark = pytest.mark.umockdev

HERE = Path(__file__).parent
DEBIAN_PYTHON = '/usr/bin/python3'
MODULES = {
    'neuromorphic': 'neuromorphic_drivers',
    'dv': 'dv_processing',
    'libcaer': 'event_camera_drivers',
}
DURATION_US = 1_000_000
LEAD_US = 300_000
LIBCAER_BUFFER = 1024
LIMIT_US = 60_000_000


def client_python(client):
    """Return an interpreter that can import the client, or skip the test."""
    module = MODULES[client]
    named = os.environ.get('MIXTAC_CLIENT_PYTHON')
    if named:
        code = subprocess.run([named, '-c', f'import {module}'], capture_output=True, check=False)
        if code.returncode == 0:
            return named
        pytest.skip(f'MIXTAC_CLIENT_PYTHON={named} has no {module}')
    if importlib.util.find_spec(module) is None:
        pytest.skip(f'no {module}: name an interpreter that has it in MIXTAC_CLIENT_PYTHON')
    return sys.executable


@pytest.fixture
def umockdev():
    """Skip where the system packages are missing."""
    if shutil.which('umockdev-wrapper') is None:
        pytest.skip('no umockdev-wrapper: apt-get install umockdev gir1.2-umockdev-1.0 python3-gi')
    probe = "import gi; gi.require_version('UMockdev', '1.0')"
    run = subprocess.run([DEBIAN_PYTHON, '-c', probe], capture_output=True, check=False)
    if run.returncode:
        pytest.skip(f'{DEBIAN_PYTHON} lacks gi or UMockdev: apt-get install gir1.2-umockdev-1.0')


@dataclass
class Frame:
    """A frame as the simulation hands it over."""

    frame_start_us: int
    exposure_start_us: int
    exposure_end_us: int
    frame_end_us: int
    reset: np.ndarray
    signal: np.ndarray


@dataclass
class Script:
    """What the camera sees; times count from the start of the script."""

    events: Events
    frames: list
    readings: list


def make_script():
    rng = np.random.default_rng(346)
    t = np.sort(rng.integers(0, DURATION_US, 60_000))
    events = Events(
        t.astype(np.int64),
        rng.integers(0, 346, len(t)).astype(np.uint16),
        rng.integers(0, 260, len(t)).astype(np.uint16),
        rng.integers(0, 2, len(t)).astype(bool),
    )
    frames = []
    for start in range(5_000, DURATION_US - 40_000, 100_000):
        reset = rng.integers(370, 1024, (260, 346)).astype(np.uint16)
        signal = rng.integers(0, 1024, (260, 346)).astype(np.uint16)
        times = (start, start + 6_000, start + 10_000, start + 16_000)
        frames.append(Frame(*times, reset, signal))
    readings = [
        ImuReading(t, (k * 0.01, -1.0, 0.5), (k - 50.0, 20.0, 0.0), 30.0 + k * 0.1)
        for k, t in enumerate(range(1_000, DURATION_US, 10_000))
    ]
    return Script(events, frames, readings)


def moved(script, by):
    events = script.events.shifted(by)
    frames = [
        Frame(
            *(f.frame_start_us + by, f.exposure_start_us + by),
            *(f.exposure_end_us + by, f.frame_end_us + by),
            *(f.reset, f.signal),
        )
        for f in script.frames
    ]
    readings = [
        ImuReading(r.t_us + by, r.acceleration_g, r.rate_dps, r.temperature_c)
        for r in script.readings
    ]
    return Script(events, frames, readings)


class Camera:
    """A virtual camera in real time that plays the script once a client is ready."""

    def __init__(self, folder):
        self.start = time.monotonic_ns()
        self.device = VirtualDavis346('V0000346', clock=self.now)
        self.server = UsbServer(self.device, str(folder / 'camera.sock'))
        self.ready = folder / 'ready'
        self.began = None

    def now(self):
        return (time.monotonic_ns() - self.start) // 1000

    def play_until(self, process, script):
        while process.poll() is None:
            now = self.now()
            assert now < LIMIT_US, 'the client neither finished nor gave up'
            if self.began is None and self.ready.exists():
                self.began = now + LEAD_US
                data = moved(script, self.began)
                self.device.submit(data.events, data.frames, data.readings)
            self.device.advance(now)
            time.sleep(0.001)


@dataclass
class Result:
    """What a client saw, and the script on the clock of the camera it saw."""

    seen: dict
    script: Script
    losses: dict


def run_client(client, folder):
    python = client_python(client)
    script = make_script()
    camera = Camera(folder)
    out = folder / 'seen.npz'
    counts = (len(script.events), len(script.frames), len(script.readings))
    counts = counts if client != 'libcaer' else (len(script.events), 0, 0)
    process = subprocess.Popen(
        [
            *('umockdev-wrapper', DEBIAN_PYTHON, str(HERE / 'umockdev_bridge.py')),
            *('--socket', camera.server.path, '--wire', mixtac_sim.usb.wire.__file__, '--'),
            *(python, str(HERE / 'umockdev_clients.py'), client, str(out), str(camera.ready)),
            *(str(count) for count in counts),
        ],
        start_new_session=True,
    )
    try:
        camera.play_until(process, script)
    finally:
        # The wrapper, the bridge and the client are one process group.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        camera.server.close()
    assert process.returncode == 0
    assert camera.began is not None
    with np.load(out) as saved:
        seen = dict(saved)
    return Result(
        seen, moved(script, camera.began - camera.device.clock_origin_us), camera.device.losses
    )


def expected_events(script):
    e = script.events
    return np.stack([e.t, e.x, e.y, e.polarity], axis=1).astype(np.int64)


def expected_frame_times(script):
    return np.array(
        [
            (f.frame_start_us, f.exposure_start_us, f.exposure_end_us, f.frame_end_us)
            for f in script.frames
        ]
    )


def neuromorphic_pixels(frame):
    difference = frame.reset.astype(int) - frame.signal
    over = (frame.reset < 384) | (frame.signal == 0)
    return np.where(over, 1023, np.clip(difference, 0, 1023)) << 6


def dv_pixels(frame):
    reset, signal = frame.reset.astype(int) >> 2, frame.signal.astype(int) >> 2
    return np.where((reset < 96) | (signal == 0), 255, np.maximum(reset - signal, 0))


def test_neuromorphic_drivers_sees_the_script(umockdev, tmp_path):
    result = run_client('neuromorphic', tmp_path)
    np.testing.assert_array_equal(result.seen['events'], expected_events(result.script))
    np.testing.assert_array_equal(result.seen['frame_times'], expected_frame_times(result.script))
    for image, frame in zip(result.seen['frames'], result.script.frames, strict=True):
        np.testing.assert_array_equal(image, neuromorphic_pixels(frame))
    check_imu(result, gravity=9.80665, degree=np.pi / 180)
    assert result.losses['events_dropped'] == 0


def test_dv_processing_sees_the_script(umockdev, tmp_path):
    result = run_client('dv', tmp_path)
    np.testing.assert_array_equal(result.seen['events'], expected_events(result.script))
    np.testing.assert_array_equal(
        result.seen['frame_times'][:, 1:3], expected_frame_times(result.script)[:, 1:3]
    )
    for image, frame in zip(result.seen['frames'], result.script.frames, strict=True):
        np.testing.assert_array_equal(image.reshape(260, 346), dv_pixels(frame))
    check_imu(result, gravity=1.0, degree=1.0)
    assert result.losses['events_dropped'] == 0


def test_libcaer_sees_the_events(umockdev, tmp_path):
    result = run_client('libcaer', tmp_path)
    expected, seen = expected_events(result.script), result.seen['events']
    # The wrapper hands out full buffers and repeats some events from one to the next: each
    # buffer must be a stretch of the script, and none may be left out in between. It ends when
    # it has counted enough events, repeats included: the last few percent stay unread.
    place = {tuple(event): k for k, event in enumerate(expected.tolist())}
    end = 0
    for batch in np.split(seen, range(LIBCAER_BUFFER, len(seen), LIBCAER_BUFFER)):
        first = place[tuple(batch[0].tolist())]
        assert first <= end
        end = first + len(batch)
        np.testing.assert_array_equal(batch, expected[first:end])
    assert end > 0.9 * len(expected)


def check_imu(result, *, gravity, degree):
    readings = result.script.readings
    seen = result.seen['imu']
    np.testing.assert_array_equal(seen[:, 0], [r.t_us for r in readings])
    acceleration = np.array([r.acceleration_g for r in readings]) * gravity
    rate = np.array([r.rate_dps for r in readings]) * degree
    # Half a step of 16 bits at the widest full scale (16 g, 2000 deg/s).
    np.testing.assert_allclose(seen[:, 1:4], acceleration, atol=16 / 32768 * gravity)
    np.testing.assert_allclose(seen[:, 4:7], rate, atol=2000 / 32768 * degree)
    np.testing.assert_allclose(seen[:, 7], [r.temperature_c for r in readings], atol=0.01)


def test_our_decoder_and_the_script_agree(tmp_path):
    """The same script through our own decoder, without a client."""
    from mixtac_driver.decoder import StreamDecoder
    from mixtac_driver.identity import Geometry

    script = make_script()
    device = VirtualDavis346('V0000346', clock=lambda: 0)
    for module, param in ((0, 3), (9, 0), (0, 1), (0, 0), (1, 3), (2, 4), (3, 2), (3, 3), (3, 4)):
        device.control(0x40, 0xBF, module, param, struct.pack('>I', 1))
    device.submit(script.events, script.frames, script.readings)
    decoder = StreamDecoder(Geometry())
    events, frames, samples = [], [], []
    for t in range(0, DURATION_US + 50_000, 1000):
        device.advance(t)
        if not len(device._fifo):
            continue
        for batch in decoder.push(device.read_bulk(0x82, 1 << 20, 1.0)):
            e = batch.events
            events.append(np.stack([e.t, e.x, e.y, e.polarity], axis=1).astype(np.int64))
            frames += batch.frames
            samples += batch.imu.t.tolist()
    np.testing.assert_array_equal(np.concatenate(events), expected_events(script))
    for seen, frame in zip(frames, script.frames, strict=True):
        np.testing.assert_array_equal(seen.image, neuromorphic_pixels(frame) >> 6)
    assert samples == [r.t_us for r in script.readings]
