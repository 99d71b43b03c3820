# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process of its own, on a virtual camera, over real DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('event_camera_msgs.msg')
pytest.importorskip('mixtac_sim.usb.server')

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image, Imu, TimeReference
from virtual_scene import Scene

from mixtac_events.codec import decode_message
from mixtac_node.base_node import QOS_EVENTS, QOS_LATCHED, QOS_SENSOR, stamp_to_ns, stamp_to_us
from mixtac_sim.usb.server import UsbServer

pytestmark = pytest.mark.dds
COMMAND = [sys.executable, '-m', 'mixtac_driver.driver_node', '--ros-args']


class Graph:
    """A scene, the driver on it, and a node that listens."""

    def __init__(self, tmp_path, env):
        self.env = env
        self.path = str(tmp_path / 'camera.sock')
        self.scene = self.server = self.process = None
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node('listener', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.got = {}

    def plug_in(self):
        self.scene = Scene()
        self.server = UsbServer(self.scene.device, self.path)

    def unplug(self):
        self.server.close()
        self.scene.close()
        self.server = None

    def start_driver(self, *parameters):
        assignments = [f'device:=virtual:{self.path}', *parameters]
        args = [word for each in assignments for word in ('-p', each)]
        self.process = subprocess.Popen(
            [*COMMAND, *args], env=self.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )

    def listen(self, kind, topic, qos):
        self.got[topic] = []
        self.node.create_subscription(kind, topic, self.got[topic].append, qos)

    def spin_until(self, condition, seconds=20.0):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, {k: len(v) for k, v in self.got.items()}
            assert self.process.poll() is None, self.process.stdout.read().decode()
            self.executor.spin_once(timeout_sec=0.1)

    def latest_diagnostics(self):
        for array in reversed(self.got['/diagnostics']):
            for status in array.status:
                if status.name == 'mixtac/driver':
                    return status
        return None

    def stop_driver(self):
        self.process.send_signal(signal.SIGINT)
        output, _ = self.process.communicate(timeout=15)
        return self.process.returncode, output.decode()

    def close(self):
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        if self.server is not None:
            self.unplug()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def graph(tmp_path, ros_domain):
    graph = Graph(tmp_path, ros_domain)
    yield graph
    graph.close()


def test_everything_is_published_on_one_clock(graph):
    graph.plug_in()
    graph.listen(EventPacket, '/mixtac/events', QOS_EVENTS)
    graph.listen(Image, '/mixtac/image_raw', QOS_SENSOR)
    graph.listen(CameraInfo, '/mixtac/camera_info', QOS_SENSOR)
    graph.listen(Imu, '/mixtac/imu', QOS_SENSOR)
    graph.listen(TimeReference, '/mixtac/camera_clock', QOS_LATCHED)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    graph.start_driver('background_activity_filter_enabled:=false')
    images, packets = graph.got['/mixtac/image_raw'], graph.got['/mixtac/events']
    graph.spin_until(
        lambda: (
            all(graph.got.values())
            and len(images) > 5
            and len(packets) > 300
            and graph.latest_diagnostics().message.startswith('streaming')
        )
    )
    check_packets(packets)
    image = images[-1]
    assert (image.width, image.height, image.encoding, image.step) == (346, 260, 'mono16', 692)
    pixels = np.frombuffer(image.data, np.uint16).reshape(260, 346)
    assert (pixels % 64 == 0).all()
    assert any((pixels >> 6 == sent).all() for sent in graph.scene.frames)
    now_us = time.time_ns() // 1000
    for topic in ('/mixtac/image_raw', '/mixtac/imu'):
        assert abs(stamp_to_us(graph.got[topic][-1].header.stamp) - now_us) < 2_000_000
    stamps = {stamp_to_us(info.header.stamp) for info in graph.got['/mixtac/camera_info']}
    assert len(stamps & {stamp_to_us(each.header.stamp) for each in images}) > 2
    imu = graph.got['/mixtac/imu'][-1]
    assert imu.linear_acceleration.z == pytest.approx(9.81, rel=3e-3)
    assert imu.orientation_covariance[0] == -1.0
    clock = graph.got['/mixtac/camera_clock'][-1]
    assert clock.source == 'V0000042'
    assert abs(stamp_to_ns(clock.header.stamp) - stamp_to_ns(clock.time_ref)) < 50_000_000
    status = graph.latest_diagnostics()
    values = {each.key: each.value for each in status.values}
    assert status.hardware_id == 'V0000042'
    assert values['simulated'] == 'True'
    assert 'simulated' in status.message
    code, output = graph.stop_driver()
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
            assert -5000 < arrival_us - decoded.events.t[0] < 1_000_000
        complete = decoded.complete_until


def test_waits_for_the_camera_and_comes_back_after_it_was_unplugged(graph):
    graph.listen(EventPacket, '/mixtac/events', QOS_EVENTS)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    graph.start_driver()
    packets = graph.got['/mixtac/events']
    graph.spin_until(lambda: graph.latest_diagnostics() is not None)
    assert graph.latest_diagnostics().level == b'\x02'
    graph.plug_in()
    graph.spin_until(lambda: len(packets) > 50)
    graph.unplug()
    graph.spin_until(lambda: graph.latest_diagnostics().level == b'\x02')
    before = packets[-1].time_base
    packets.clear()
    graph.plug_in()
    graph.spin_until(lambda: len(packets) > 50)
    assert packets[0].time_base > before
    assert graph.stop_driver()[0] == 0


def test_exposure_changes_while_running_and_the_device_does_not(graph):
    graph.plug_in()
    graph.listen(EventPacket, '/mixtac/events', QOS_EVENTS)
    graph.start_driver('aps_exposure:=2000')
    client = graph.node.create_client(SetParameters, '/mixtac/driver/set_parameters')
    graph.spin_until(lambda: graph.got['/mixtac/events'] and client.service_is_ready())
    assert graph.scene.device.exposure_us == 2000

    def change(name, value):
        parameter = Parameter(name, value=value).to_parameter_msg()
        future = client.call_async(SetParameters.Request(parameters=[parameter]))
        graph.spin_until(future.done)
        return future.result().results[0]

    assert change('aps_exposure', 6000).successful
    assert graph.scene.device.exposure_us == 6000
    refused = change('device', 'davis346')
    assert not refused.successful
    assert 'restart' in refused.reason
    assert not change('aps_exposure', -1).successful
    assert not change('ONBn_fine', 256).successful
    assert change('ONBn_fine', 100).successful


@pytest.mark.parametrize(
    ('device', 'words'), [('davis346', 'virtual'), ('nonsense', 'known are davis346')]
)
def test_without_a_camera_one_line_says_what_to_do(ros_domain, device, words):
    done = subprocess.run(
        [*COMMAND, '-p', f'device:={device}'],
        env=ros_domain,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 1
    lines = [line for line in done.stderr.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1
    assert words in lines[0]
    assert 'Traceback' not in done.stderr
