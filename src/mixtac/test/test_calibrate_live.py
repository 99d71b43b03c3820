# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate` on images that arrive over DDS."""

from __future__ import annotations

import itertools
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')

sys.path.insert(0, str(Path(__file__).parents[2] / 'mixtac_driver/test'))

from board_camera import BoardCamera, good_poses  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from mixtac import calibrate  # noqa: E402
from mixtac_core.node.base_node import QOS_SENSOR  # noqa: E402
from mixtac_driver import calibration as view_selection  # noqa: E402
from mixtac_driver.camera_info import read_camera_info  # noqa: E402

pytestmark = pytest.mark.dds
TOPIC = '/mixtac/image_raw'


def image_message(image):
    message = Image(
        height=image.shape[0], width=image.shape[1], encoding='mono16', step=2 * image.shape[1]
    )
    message.data.frombytes(image.tobytes())
    return message


class Camera:
    """Publishes frames again and again, as a driver would."""

    def __init__(self, frames) -> None:
        self._messages = [image_message(each) for each in frames]
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work)

    def __enter__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node('camera', context=self._context)
        self._publisher = self._node.create_publisher(Image, TOPIC, QOS_SENSOR)
        self._thread.start()

    def __exit__(self, *_) -> None:
        self._stopping.set()
        self._thread.join()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _work(self) -> None:
        for message in itertools.cycle(self._messages):
            if self._stopping.wait(0.05):
                return
            self._publisher.publish(message)


@pytest.fixture(scope='module')
def frames():
    camera, rng = BoardCamera(), np.random.default_rng(3)
    return [camera.image(*each, rng) for each in good_poses('equidistant', 16, 21, 8)]


@pytest.mark.usefixtures('ros_domain')
def test_live_images_are_collected_until_there_are_enough(tmp_path, frames, monkeypatch, capfd):
    monkeypatch.setattr(view_selection, 'WANTED_VIEWS', 10)
    with Camera(frames):
        calibrate.calibrate(out=tmp_path / 'camera.yaml')
    saved = read_camera_info(tmp_path / 'camera.yaml')
    assert saved.camera_matrix[0, 0] == pytest.approx(155.0, rel=0.01)
    # One line for each view.
    assert capfd.readouterr().out.count('coverage') >= 10


def test_ctrl_c_ends_collecting_and_calibrates(tmp_path, frames, monkeypatch):
    def interrupted(_topic, _device):
        for image in frames:
            yield calibrate.labelled(image_message(image))
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate, 'live_images', interrupted)
    monkeypatch.setattr(view_selection, 'WANTED_VIEWS', 1000)
    calibrate.calibrate(out=tmp_path / 'camera.yaml')
    assert (tmp_path / 'camera.yaml').exists()
