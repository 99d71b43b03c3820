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
from sensor_msgs.msg import CameraInfo, Image, Imu, TimeReference

from mixtac_core.events.codec import decode_message
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_SENSOR, qos
from mixtac_core.node.topics import stamp_to_ns, stamp_to_us

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
    graph.listen(TimeReference, '/mixtac/camera_clock', qos(topics.CAMERA_CLOCK))
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
    check_settings(graph, camera.scene.device)
    code, output = graph.stop()
    assert (code, 'Traceback' in output) == (0, False)


def check_settings(graph, device):
    """Settings change while the camera streams; contradictions and the device do not."""
    assert graph.change('/mixtac/driver', aps_exposure=6000, ONBn_fine=100).successful
    # A camera that a busy computer is opening again gets them then.
    graph.spin_until(lambda: (device.exposure_us, device.register(5, 11) >> 4 & 255) == (6000, 100))
    for change in (
        {'device': 'davis346'},
        {'aps_exposure': -1},
        {'roi_start_col': 9, 'roi_end_col': 8},
    ):
        assert not graph.change('/mixtac/driver', **change).successful
    assert (device.register(1, 41), device.exposure_us) == (0, 6000)


def check_packets(packets):
    """Packets of at most a millisecond in order, time that always progresses.

    A subscriber on a busy machine may miss some.
    """
    sequence = [packet.seq for packet in packets]
    assert sequence == sorted(set(sequence))
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
    assert sequence == sorted(set(sequence))
    times = [packet.time_base for packet in packets]
    assert times == sorted(times)
    assert graph.stop()[0] == 0
