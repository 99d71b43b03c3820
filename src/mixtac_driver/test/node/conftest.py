# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera for the driver node, to be plugged in and unplugged."""

from __future__ import annotations

import pytest


class Camera:
    """A camera in the test's process.

    Args:
        path: Its socket.

    Attributes:
        device: The driver's parameter that names it.
        scene: What it sees, and the device; None before it is plugged in.
    """

    def __init__(self, path):
        self.path, self.device = path, f'device:=virtual:{path}'
        self.scene = self._server = None

    def plug_in(self):
        from virtual_scene import Scene

        from mixtac_sim.usb.server import UsbServer

        self.scene = Scene()
        self._server = UsbServer(self.scene.device, self.path)

    def unplug(self):
        if self._server is not None:
            self._server.close()
            self.scene.close()
            self._server = None


@pytest.fixture
def camera(tmp_path):
    """Return a camera that is not plugged in yet."""
    camera = Camera(str(tmp_path / 'camera.sock'))
    yield camera
    camera.unplug()
