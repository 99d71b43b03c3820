# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs a client on a virtual camera under umockdev."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from umockdev_scene import DURATION_US, WRAP_US, make_hard_words, make_scene

import mixtac_sim.usb.wire
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.server import UsbServer

HERE = Path(__file__).parent
DEBIAN_PYTHON = '/usr/bin/python3'
MODULE = 'event_camera_drivers'
CLIENTS = ['ours', 'libcaer']
LEAD_US = 100_000
LIMIT_US = 90_000_000
TAIL_INTERVAL_S = 0.02
FIFO_BYTES = 32 << 20
WRITABLE = {
    0: range(6),
    1: (*range(3, 6), *range(11, 27), *range(31, 35), *range(41, 45), 51, 52, 61, 62, 63),
    2: (4, 5, *range(7, 14)),
    3: (*range(2, 8), 9, 10),
    4: (*range(6), *range(11, 17)),
    5: (*range(5), *range(8, 28), *range(34, 37), *range(128, 139), *range(140, 145)),
    9: (0, 1),
}
"""Parameters that a host may set, by module."""


def client_python(client):
    """Return an interpreter that can import the client, or skip the test."""
    if client == 'ours':
        return sys.executable
    named = os.environ.get('MIXTAC_CLIENT_PYTHON')
    if named:
        code = subprocess.run([named, '-c', f'import {MODULE}'], capture_output=True, check=False)
        if code.returncode == 0:
            return named
        pytest.skip(f'MIXTAC_CLIENT_PYTHON={named} has no {MODULE}')
    if importlib.util.find_spec(MODULE) is None:
        pytest.skip(f'no {MODULE}: name an interpreter that has it in MIXTAC_CLIENT_PYTHON')
    return sys.executable


def need_umockdev():
    """Skip where the system packages are missing."""
    if shutil.which('umockdev-wrapper') is None:
        pytest.skip('no umockdev-wrapper: apt-get install umockdev gir1.2-umockdev-1.0 python3-gi')
    probe = "import gi; gi.require_version('UMockdev', '1.0')"
    run = subprocess.run([DEBIAN_PYTHON, '-c', probe], capture_output=True, check=False)
    if run.returncode:
        pytest.skip(f'{DEBIAN_PYTHON} lacks gi or UMockdev: apt-get install gir1.2-umockdev-1.0')


class Camera:
    """A virtual camera in real time that plays both parts once a client is ready."""

    def __init__(self, folder, kind=VirtualDavis346):
        self.start = time.monotonic_ns()
        self.device = kind('V0000346', clock=self.now, fifo_bytes=FIFO_BYTES)
        self.server = UsbServer(self.device, str(folder / 'camera.sock'))
        self.ready, self.done = folder / 'ready', folder / 'done'
        self.scene = self.hard = None
        self.registers = {}

    def now(self):
        return (time.monotonic_ns() - self.start) // 1000

    def play(self, process):
        """Play to a client until it ends."""
        while process.poll() is None and not (self.ready.exists() and self.device.streaming):
            self.device.advance(self.now())
            self._rest()
        if process.poll() is None:
            self._play_scene()
            self._play_hard_words()
        while process.poll() is None:
            if not self.device.backlog:
                self.done.touch()
            # Time that passes lets every client hand on what it holds back.
            self.device.feed(np.array([0x7001], np.uint16))
            self._rest(TAIL_INTERVAL_S)

    def _play_scene(self):
        began = self.now() + LEAD_US
        scene = make_scene().moved(began)
        self.device.submit(scene.events, scene.frames, scene.readings)
        for t, code in [*scene.edges, (began + DURATION_US, None)]:
            while self.now() < t:
                self.device.advance(min(self.now(), t))
                self._rest()
            self.device.advance(t)
            if code is not None:
                low = (t - self.device.clock_origin_us) % WRAP_US
                # After a wrap the time is known: the camera never sends a stamp of zero.
                self._feed([0x8000 | low, code] if low else [code])
        self.scene = scene.moved(-self.device.clock_origin_us)

    def _play_hard_words(self):
        end = self.scene.edges[0][0] - make_scene().edges[0][0] + DURATION_US
        self.hard = make_hard_words(end // WRAP_US * WRAP_US)
        self._feed(self.hard.words)
        self.registers = {
            (module, param): self.device.register(module, param)
            for module, params in WRITABLE.items()
            for param in params
        }

    def _feed(self, words):
        assert self.device.feed(np.array(words, np.uint16)), 'the camera does not stream any more'

    def _rest(self, pause_s=0.001):
        assert self.now() < LIMIT_US, 'the client neither finished nor gave up'
        time.sleep(pause_s)


@dataclass
class Result:
    """What a client saw and wrote, and what there was to see, on the clock of the camera."""

    client: str
    seen: dict
    scene: object
    hard: object
    losses: dict
    registers: dict

    @property
    def frames(self):
        return [self.seen[f'frame_{k}'] for k in range(len(self.seen['frame_times']))]


@contextlib.contextmanager
def bridged(camera, *command, stderr=None):
    """Run a program that finds the camera on its USB; yield the process and end it with the rest.

    The wrapper, the bridge and the program are one process group.
    """
    process = subprocess.Popen(
        [
            *('umockdev-wrapper', DEBIAN_PYTHON, str(HERE / 'umockdev_bridge.py')),
            *('--socket', camera.server.path, '--wire', mixtac_sim.usb.wire.__file__, '--'),
            *command,
        ],
        stderr=stderr,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        camera.server.close()


def run_client(client, folder):
    """Let a client read the camera and return what it saw."""
    python = client_python(client)
    camera = Camera(folder)
    out = folder / 'seen.npz'
    script = str(HERE / 'umockdev_clients.py')
    arguments = client, str(out), str(camera.ready), str(camera.done)
    with bridged(camera, python, script, *arguments) as process:
        camera.play(process)
    assert process.returncode == 0
    with np.load(out) as saved:
        seen = dict(saved)
    parts = camera.scene, camera.hard, camera.device.losses, camera.registers
    return Result(client, seen, *parts)
