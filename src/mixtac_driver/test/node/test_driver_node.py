# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process of its own, on a virtual camera, over real DDS."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip('event_camera_msgs.msg')
pytest.importorskip('mixtac_msgs.msg')
pytest.importorskip('mixtac_sim.usb.server')

from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from sensor_msgs.msg import CameraInfo, Image, Imu, Temperature, TimeReference
from std_srvs.srv import Trigger

from mixtac_core.events.codec import decode_message
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_LATCHED, QOS_SENSOR, qos
from mixtac_core.node.stamps import stamp_to_ns, stamp_to_us
from mixtac_msgs.msg import ExternalEdge, FrameExposure

pytestmark = pytest.mark.dds
RELIABLE = qos(topics.EVENTS, offered=True)
"""A test on a busy machine must not lose packets."""
DRIVER = 'mixtac_driver.node.driver_node'
NAME = 'mixtac/driver'
MINUTE_US = 60_000_000
"""A busy machine may take so long."""


@pytest.fixture
def graph(camera, node_under_test):
    """Return what `node_under_test` is, to be closed before the camera."""
    return node_under_test


def test_everything_is_published_on_one_clock(camera, graph):
    camera.plug_in()
    graph.listen(EventPacket, '/mixtac/events', RELIABLE)
    graph.listen(Image, '/mixtac/image_raw', QOS_SENSOR)
    graph.listen(CameraInfo, '/mixtac/camera_info', QOS_SENSOR)
    graph.listen(Imu, '/mixtac/imu/data_raw', QOS_SENSOR)
    graph.listen(TimeReference, '/mixtac/camera_clock', QOS_LATCHED)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    graph.start(DRIVER, camera.device, 'background_activity_filter_enabled:=false')
    images, packets = graph.got['/mixtac/image_raw'], graph.got['/mixtac/events']
    graph.spin_until(
        lambda: (
            all(graph.got.values())
            and len(images) > 5
            and len(packets) > 300
            and graph.diagnostics(NAME).get('message', '').startswith('streaming')
        )
    )
    check_packets(packets)
    image = images[-1]
    assert (image.width, image.height, image.encoding, image.step) == (346, 260, 'mono16', 692)
    pixels = np.frombuffer(image.data, np.uint16).reshape(260, 346)
    assert (pixels % 64 == 0).all()
    assert any((pixels >> 6 == sent).all() for sent in camera.scene.frames)
    now_us = time.time_ns() // 1000
    for topic in ('/mixtac/image_raw', '/mixtac/imu/data_raw'):
        assert abs(stamp_to_us(graph.got[topic][-1].header.stamp) - now_us) < MINUTE_US
    stamps = {stamp_to_us(info.header.stamp) for info in graph.got['/mixtac/camera_info']}
    assert len(stamps & {stamp_to_us(each.header.stamp) for each in images}) > 2
    imu = graph.got['/mixtac/imu/data_raw'][-1]
    assert imu.linear_acceleration.z == pytest.approx(9.81, rel=3e-3)
    assert imu.orientation_covariance[0] == -1.0
    clock = graph.got['/mixtac/camera_clock'][-1]
    assert clock.source == 'V0000042'
    assert abs(stamp_to_ns(clock.header.stamp) - stamp_to_ns(clock.time_ref)) < 1_000_000_000
    values = graph.diagnostics(NAME)
    assert values['hardware_id'] == 'V0000042'
    assert values['simulated'] == 'True'
    assert 'simulated' in values['message']
    code, output = graph.stop()
    assert (code, 'Traceback' in output) == (0, False)


def check_packets(packets):
    """Sequence without holes, packets of at most a millisecond, time that always progresses."""
    sequence = np.array([packet.seq for packet in packets])
    assert (np.diff(sequence) == 1).all()
    complete = 0
    for packet in packets:
        decoded = decode_message(packet)
        assert decoded.complete_until > complete
        if len(decoded.events):
            assert decoded.events.t[0] >= complete
            assert decoded.events.t[-1] - decoded.events.t[0] < 1000
            arrival_us = stamp_to_us(packet.header.stamp)
            assert -100_000 < arrival_us - decoded.events.t[0] < MINUTE_US
        complete = decoded.complete_until


def test_settings_change_while_running_and_the_device_does_not(camera, graph):
    camera.plug_in()
    graph.listen(EventPacket, '/mixtac/events', RELIABLE)
    graph.listen(Image, '/mixtac/image_raw', QOS_SENSOR)
    graph.start(DRIVER, camera.device, 'aps_exposure:=2000')
    graph.spin_until(lambda: graph.got['/mixtac/events'])
    device = camera.scene.device
    assert device.exposure_us == 2000
    assert graph.change('/mixtac/driver', aps_exposure=6000).successful
    assert device.exposure_us == 6000
    refused = graph.change('/mixtac/driver', device='davis346')
    assert not refused.successful
    assert 'restart' in refused.reason
    assert not graph.change('/mixtac/driver', aps_exposure=-1).successful
    assert not graph.change('/mixtac/driver', ONBn_fine=256).successful
    assert graph.change('/mixtac/driver', ONBn_fine=100, imu_acc_scale=3).successful
    assert (device.register(5, 11) >> 4 & 255, device.register(3, 7)) == (100, 3)
    # What contradicts another value is refused before anything is written.
    refused = graph.change('/mixtac/driver', aps_exposure=1000, roi_start_col=300, roi_end_col=299)
    assert not refused.successful
    assert '300 .. 299' in refused.reason
    assert (device.register(1, 41), device.exposure_us) == (0, 6000)
    assert graph.change('/mixtac/driver', dvs_enabled=False).successful
    assert device.register(1, 3) == 0
    # The scene is brighter than the target, so the exposure shrinks frame by frame.
    assert graph.change(
        '/mixtac/driver', aps_auto_exposure=True, aps_auto_exposure_minimum=3000
    ).successful
    graph.spin_until(lambda: device.exposure_us == 3000)
    assert graph.change('/mixtac/driver', aps_auto_exposure=False).successful
    assert device.exposure_us == 6000
    images = graph.got['/mixtac/image_raw']
    assert graph.change('/mixtac/driver', aps_roi_start_col=11, aps_roi_end_row=99).successful
    images.clear()
    graph.spin_until(lambda: images and images[-1].width == 335)
    assert (images[-1].height, images[-1].step) == (100, 670)


def test_a_snapshot_its_exposure_and_edges(camera, graph):
    camera.plug_in()
    graph.listen(EventPacket, '/mixtac/events', RELIABLE)
    graph.listen(Image, '/mixtac/image_raw', QOS_SENSOR)
    graph.listen(FrameExposure, '/mixtac/image_exposure', QOS_SENSOR)
    graph.listen(ExternalEdge, '/mixtac/external_edges', 100)
    graph.listen(Temperature, '/mixtac/temperature', QOS_SENSOR)
    graph.start(DRIVER, camera.device, 'aps_enabled:=false', 'hot_pixels_duration:=0.3')
    images, exposures = graph.got['/mixtac/image_raw'], graph.got['/mixtac/image_exposure']
    graph.spin_until(lambda: graph.got['/mixtac/events'] and graph.got['/mixtac/temperature'])
    assert graph.got['/mixtac/temperature'][-1].temperature == pytest.approx(40, abs=0.1)
    assert not images
    answer = graph.call(Trigger, '/mixtac/driver/snapshot')
    assert answer.success, answer.message
    graph.spin_until(lambda: images and exposures)
    assert (len(images), len(exposures)) == (1, 1)
    (exposure,), (image,) = exposures, images
    assert exposure.header == image.header
    assert f'{stamp_to_us(image.header.stamp) / 1e6:.6f}' in answer.message
    marks = ('frame_start', 'exposure_start', 'exposure_end', 'frame_end')
    times = [stamp_to_us(getattr(exposure, mark)) for mark in marks]
    assert np.diff(times).tolist() == [6000, 4000, 6000]
    assert stamp_to_us(image.header.stamp) == times[1] + 2000
    assert exposure.shutter == FrameExposure.GLOBAL_SHUTTER
    edges = graph.got['/mixtac/external_edges']
    for _ in range(3):
        camera.scene.device.feed(np.array([3, 2], np.uint16))
    graph.spin_until(lambda: len(edges) == 6)
    assert [edge.kind for edge in edges] == [3, 2] * 3
    assert [edge.seq for edge in edges] == list(range(6))
    assert abs(stamp_to_us(edges[-1].header.stamp) - time.time_ns() // 1000) < MINUTE_US
    answer = graph.call(Trigger, '/mixtac/driver/find_hot_pixels')
    assert answer.success, answer.message
    assert '0 masked' in answer.message


@pytest.mark.parametrize(('device', 'words'), [('davis346', 'virtual'), ('nonsense', 'davis346')])
def test_without_a_camera_one_line_says_what_to_do(graph, device, words):
    graph.start(DRIVER, f'device:={device}')
    assert graph.process.wait(30) == 1
    lines = [line for line in graph.process.stderr.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1
    assert words in lines[0]
    assert 'Traceback' not in graph.process.stderr


def is_in_error(graph):
    """Return None before the first diagnostics."""
    level = graph.diagnostics(NAME).get('level')
    return level and level == '2'


def test_an_absent_camera_is_an_error_until_it_is_there_and_packets_go_on(camera, graph):
    graph.listen(EventPacket, '/mixtac/events', RELIABLE)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    packets = graph.got['/mixtac/events']
    graph.start(DRIVER, camera.device)
    graph.spin_until(lambda: is_in_error(graph))
    camera.plug_in()
    graph.spin_until(lambda: len(packets) > 50 and is_in_error(graph) is False)
    exposure = {camera.scene.device.exposure_us}
    camera.scene.device.unplug()
    graph.spin_until(lambda: is_in_error(graph))
    values = graph.diagnostics(NAME)
    assert values['state'] in {'waiting to reconnect', 'connecting'}
    assert values['message']
    before = len(packets)
    camera.scene.device.plug_in()
    graph.spin_until(lambda: len(packets) > before + 50 and is_in_error(graph) is False)
    assert {camera.scene.device.exposure_us} == exposure
    sequence = [packet.seq for packet in packets]
    assert sequence == list(range(sequence[0], sequence[0] + len(packets)))
    times = [packet.time_base for packet in packets]
    assert times == sorted(times)
    assert graph.stop()[0] == 0
