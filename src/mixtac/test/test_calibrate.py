# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate`: from frames of a bag, or over DDS, to a camera_info file."""

from __future__ import annotations

import itertools
import re
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
sys.path.insert(0, str(Path(__file__).parents[2] / 'mixtac_driver/test'))

from board_camera import HEIGHT, WIDE, WIDTH, BoardCamera, good_poses  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from mixtac.calibrate import bag_images, calibrate, labelled  # noqa: E402
from mixtac_core.node.base_node import QOS_SENSOR  # noqa: E402
from mixtac_core.node.images import fill  # noqa: E402
from mixtac_core.node.topics import IMAGE_RAW  # noqa: E402
from mixtac_core.recordings.bag import blank_message, typestore  # noqa: E402
from mixtac_core.recordings.bag_writer import BagWriter  # noqa: E402
from mixtac_core.recordings.messages import set_header  # noqa: E402
from mixtac_core.recordings.recording import RecordingError  # noqa: E402
from mixtac_driver.calibration import RefusedError  # noqa: E402
from mixtac_driver.camera_info import CalibrationError, read_camera_info  # noqa: E402

TOPIC = '/mixtac/image_raw'
PERIOD_NS = 200_000_000


def image_message(image, stamp_ns=0):
    message = blank_message(IMAGE_RAW.type_name)
    set_header(message, stamp_ns, 'camera')
    fill(message, image, 'mono16')
    return message


def write_bag(path, images, topic=TOPIC, period_ns=PERIOD_NS):
    writer = BagWriter(path)
    connection = writer.add_topic(topic, IMAGE_RAW.type_name, latched=False)
    for index, image in enumerate(images):
        stamp = 10**9 + index * period_ns
        data = typestore().serialize_cdr(image_message(image, stamp), IMAGE_RAW.type_name)
        writer.write(connection, stamp, bytes(data))
    writer.close()
    return path


@pytest.fixture(scope='module')
def frames():
    camera, rng = BoardCamera(), np.random.default_rng(3)
    empty = np.clip(rng.normal(400, 4, (HEIGHT, WIDTH)), 0, 1023).astype(np.uint16) << 6
    return [empty, *(camera.image(*each, rng) for each in good_poses('equidistant', 18, 21, 8))]


@pytest.fixture(scope='module')
def bag(tmp_path_factory, frames):
    return write_bag(tmp_path_factory.mktemp('bags') / 'board', frames)


def run_cli(*arguments):
    app = typer.Typer()
    app.command()(calibrate)
    return CliRunner().invoke(app, list(map(str, arguments)))


def test_a_bag_gives_a_camera_file(tmp_path, bag):
    words = ('--board', '9x6', '--square', '0.004', '--out', tmp_path / 'camera.yaml')
    result = run_cli(bag, *words)
    assert result.exit_code == 0, result.output
    calibration = read_camera_info(tmp_path / 'camera.yaml')
    fx, fy, cx, cy, _ = WIDE['equidistant']
    assert calibration.model == 'equidistant'
    assert calibration.camera_matrix[0, 0] == pytest.approx(fx, rel=0.01)
    assert calibration.camera_matrix[1, 1] == pytest.approx(fy, rel=0.01)
    assert calibration.camera_matrix[0, 2] == pytest.approx(cx, abs=0.5)
    assert calibration.camera_matrix[1, 2] == pytest.approx(cy, abs=0.5)
    error, views = re.search(r'error ([0-9.]+) px, (\d+) views', result.output).groups()
    assert float(error) < 0.3
    assert int(views) > 8
    boards, images = re.search(r'found in (\d+) of (\d+) images', result.output).groups()
    assert int(boards) >= 13
    assert int(images) == 19


def test_without_out_it_goes_where_the_driver_looks(tmp_path, bag, monkeypatch):
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    calibrate(bag=bag, name='fingertip')
    assert read_camera_info(tmp_path / 'camera_info' / 'fingertip.yaml').name == 'fingertip'


def test_few_views_are_refused_and_nothing_is_written(tmp_path, frames):
    bag = write_bag(tmp_path / 'few', frames[:5])
    with pytest.raises(RefusedError) as caught:
        calibrate(bag=bag, out=tmp_path / 'camera.yaml')
    assert caught.value.reason == 'too few views'
    assert not (tmp_path / 'camera.yaml').exists()


@pytest.mark.parametrize(
    ('change', 'value'),
    [
        ({'board': '9by6'}, '9by6'),
        ({'square': 0.0}, 'square'),
        ({'model': 'fisheye'}, 'fisheye'),
        ({'name': 'a/b'}, 'a/b'),
    ],
)
def test_wrong_options_are_named_before_anything_is_read(change, value):
    with pytest.raises(CalibrationError) as caught:
        calibrate(bag=Path('no such bag'), **change)
    assert value in str(caught.value)


def test_a_topic_that_is_not_there_or_no_image_is_named(tmp_path, bag):
    with pytest.raises(RecordingError) as caught:
        list(bag_images(bag, '/other'))
    assert '/other' in str(caught.value)
    with pytest.raises(RecordingError) as caught:
        list(bag_images(tmp_path / 'none', TOPIC))
    assert str(tmp_path / 'none') in str(caught.value)


def test_a_recording_is_thinned_out(tmp_path, frames):
    bag = write_bag(tmp_path / 'fast', frames[:8], period_ns=PERIOD_NS // 4)
    labels = [label for label, _ in bag_images(bag, TOPIC)]
    assert labels == ['1.000', '1.200']


class Camera:
    """Publishes frames again and again, as a driver would."""

    def __init__(self, frames) -> None:
        self._messages = [Image() for _ in frames]
        for message, image in zip(self._messages, frames, strict=True):
            fill(message, image, 'mono16')
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work)

    def __enter__(self) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node('camera', context=self._context)
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


@pytest.mark.dds
@pytest.mark.usefixtures('ros_domain')
def test_live_images_are_collected_until_there_are_enough(tmp_path, frames, monkeypatch, capfd):
    monkeypatch.setattr('mixtac_driver.calibration.WANTED_VIEWS', 10)
    with Camera(frames):
        calibrate(out=tmp_path / 'camera.yaml')
    saved = read_camera_info(tmp_path / 'camera.yaml')
    assert saved.camera_matrix[0, 0] == pytest.approx(155.0, rel=0.01)
    # One line for each view.
    assert capfd.readouterr().out.count('coverage') >= 10


def test_ctrl_c_ends_collecting_and_calibrates(tmp_path, frames, monkeypatch):
    def interrupted(_topic, _device):
        for image in frames:
            yield labelled(image_message(image))
        raise KeyboardInterrupt

    monkeypatch.setattr('mixtac.calibrate.live_images', interrupted)
    monkeypatch.setattr('mixtac_driver.calibration.WANTED_VIEWS', 1000)
    calibrate(out=tmp_path / 'camera.yaml')
    assert (tmp_path / 'camera.yaml').exists()
