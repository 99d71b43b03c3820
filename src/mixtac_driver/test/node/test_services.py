# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Services of the driver on a fake USB camera, without DDS."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from davis_fake import FakeBackend, FakeCamera
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import NO_EDGES, NO_SAMPLES, DecodedBatch
from mixtac_driver.camera import CameraBatch, Davis346
from mixtac_driver.camera_info import CalibratedCamera
from mixtac_driver.clock import Origin
from mixtac_driver.node import driver_node
from mixtac_driver.node.driver_node import DriverServices
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.pixels import PixelMask, load_mask

pytestmark = pytest.mark.live
SIZE = (346, 260)
HOT = [(10 * k + 5, 7) for k in range(10)]


class Node:
    """Keeps the callbacks of services."""

    def __init__(self):
        self.services = {}

    def create_service(self, _kind, name, callback):
        self.services[name] = callback

    def call(self, name):
        return self.services[name](None, SimpleNamespace(success=None, message=None))


class Rig:
    """A camera, the services on it, and a thread that plays the one that decodes."""

    def __init__(self, parameters):
        self.fake = FakeCamera()
        self.settings = DriverSettings(parameters)
        self.camera = Davis346(parameters, backend=FakeBackend(self.fake))
        self.node = Node()
        self.calibration = CalibratedCamera(parameters)
        self.services = DriverServices(self.node, self.camera, self.settings, self.calibration)
        self.stop = threading.Event()
        self.filters = []
        self.time_us = 0

    def decode(self, step):
        def run():
            while not self.stop.wait(0.002):
                self.time_us += 1000
                step()

        self.thread = threading.Thread(target=run)
        self.thread.start()

    def close(self):
        self.stop.set()
        self.thread.join(10)
        self.camera.close()


@pytest.fixture
def rig(monkeypatch, tmp_path):
    monkeypatch.setattr('mixtac_driver.davis346.writes.BIASES_SETTLE_S', 0.0)
    monkeypatch.setattr('mixtac_driver.davis346.writes.LOGIC_SETTLE_S', 0.0)
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    monkeypatch.setattr(driver_node, 'MARGIN_S', 60.0)
    parameters = replace(
        DriverParameters(),
        hot_pixels_duration=0.3,
        hot_pixels_file='mask.png',
        camerainfo_url=str(tmp_path / 'davis346.yaml'),
        aps_enabled=False,
    )
    rig = Rig(parameters)
    yield rig
    rig.close()


def batch(events, time_us):
    decoded = DecodedBatch(events, (), NO_SAMPLES, NO_EDGES, time_us, 0)
    return CameraBatch(decoded, Origin(5_000_000_000, 0), 0)


def events():
    """One event of each hot pixel, more of the first ones."""
    x = np.repeat(np.arange(5, 105, 10), np.arange(10, 0, -1)).astype(np.uint16)
    y = np.full(len(x), 7, np.uint16)
    return Events(np.zeros(len(x), np.int64), x, y, np.zeros(len(x), np.bool_))


def watch(rig):
    rig.filters.append(rig.fake.registers.get((1, 12)))
    rig.services.watch(batch(events(), rig.time_us))


def test_hot_pixels_are_found_masked_and_saved(rig, tmp_path):
    rig.settings.file_mask = PixelMask([(300, 200)], SIZE)
    # Found before, quiet now.
    rig.settings.use_mask(PixelMask([(99, 99)], SIZE), rig.camera.apply)
    rig.camera.open()
    assert rig.fake.registers[1, 12] == 99
    rig.decode(lambda: watch(rig))
    answer = rig.node.call('~/find_hot_pixels')
    assert answer.success, answer.message
    assert answer.message.startswith('10 hot pixels: (5, 7), (15, 7)')
    assert '11 masked, 8 of them by the camera' in answer.message
    # The camera's filters were open meanwhile.
    assert 346 in rig.filters
    slots = [
        (rig.fake.registers[1, 12 + 2 * k], rig.fake.registers[1, 11 + 2 * k]) for k in range(8)
    ]
    assert slots == HOT[:8]
    assert rig.settings.mask.pixels == (*HOT, (300, 200))
    saved = load_mask(str(tmp_path / 'mask.png'))
    assert set(saved.in_camera) == set(HOT[:8])
    assert set(saved.pixels) == {*HOT, (300, 200)}


def test_without_a_stream_the_mask_stays(rig, monkeypatch):
    monkeypatch.setattr(driver_node, 'MARGIN_S', 0.1)
    rig.settings.use_mask(PixelMask([(300, 200)], SIZE), rig.camera.apply)
    rig.camera.open()
    rig.decode(lambda: None)
    answer = rig.node.call('~/find_hot_pixels')
    assert not answer.success
    assert '/diagnostics' in answer.message
    assert rig.fake.registers[1, 12] == 300
    assert rig.settings.mask.pixels == ((300, 200),)


def test_a_calibration_is_stored_and_used(rig):
    rig.decode(lambda: None)
    save = rig.node.services['~/set_camera_info']
    request, response = SetCameraInfo.Request(), SetCameraInfo.Response()
    assert not save(request, response).success
    rig.calibration.use_size(SIZE)
    info = request.camera_info
    info.width, info.height, info.distortion_model, info.d = 346, 260, 'plumb_bob', [0.0] * 5
    info.k = info.r = np.diag([200.0, 200.0, 1.0]).ravel()
    info.p = np.eye(3, 4).ravel()
    assert save(request, response).success, response.status_message
    assert rig.calibration.complete(CameraInfo()).k[0] == 200.0
    info.width = 640
    assert not save(request, response).success
    assert CalibratedCamera(rig.settings.parameters).calibration.size == SIZE


def test_a_snapshot_requests_a_frame(rig):
    rig.decode(lambda: None)
    assert not rig.node.call('~/snapshot').success
    rig.camera.open()
    rig.camera.start()
    # It is open, and no data have arrived.
    answer = rig.node.call('~/snapshot')
    assert not answer.success
    assert answer.message
    rig.fake.send([0x8064, 0x1001, 0x2001])
    next(rig.camera.batches())
    assert rig.node.call('~/snapshot').success
    assert ('many', 2) in rig.fake.log
