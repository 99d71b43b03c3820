# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process of its own, on a recording, over real DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('event_camera_msgs.msg')

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from recording_samples import START_US, Bag, assert_equal, some_events
from sensor_msgs.msg import Image, Imu

from mixtac_events.arrays import Events
from mixtac_events.codec import decode_message
from mixtac_node.base_node import QOS_EVENTS, QOS_SENSOR
from mixtac_node.stamps import stamp_to_us

pytestmark = pytest.mark.dds
COMMAND = [sys.executable, '-m', 'mixtac_driver.node.driver_node', '--ros-args']
LENGTH_US = 500_000
EVENTS = some_events(length_us=LENGTH_US)
FRAMES = range(START_US + 100_000, START_US + LENGTH_US, 100_000)


class Graph:
    """The driver on a recording, and a node that listens."""

    def __init__(self, env):
        self.env, self.process = env, None
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node('listener', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.got = {}

    def start_driver(self, device, *parameters):
        args = [word for each in (f'device:={device}', *parameters) for word in ('-p', each)]
        self.process = subprocess.Popen(
            [*COMMAND, *args], env=self.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )

    def listen(self, kind, topic, qos):
        self.got[topic] = []
        self.node.create_subscription(kind, topic, self.got[topic].append, qos)

    def spin_until(self, condition, seconds=30.0):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, {k: len(v) for k, v in self.got.items()}
            assert self.process.poll() is None, self.process.stdout.read().decode()
            self.executor.spin_once(timeout_sec=0.1)

    def change(self, **values):
        client = self.node.create_client(SetParameters, '/mixtac/driver/set_parameters')
        self.spin_until(client.service_is_ready)
        parameters = [Parameter(n, value=value).to_parameter_msg() for n, value in values.items()]
        future = client.call_async(SetParameters.Request(parameters=parameters))
        self.spin_until(future.done)
        return future.result().results

    def status(self):
        for array in reversed(self.got['/diagnostics']):
            for status in array.status:
                if status.name == 'mixtac/driver':
                    return status, {each.key: each.value for each in status.values}
        return None, {}

    def stop_driver(self):
        self.process.send_signal(signal.SIGINT)
        output, _ = self.process.communicate(timeout=15)
        return self.process.returncode, output.decode()

    def close(self):
        if self.process is not None and self.process.poll() is None:
            # Killed, it would still be a peer of the node here, whose end then crashes at times.
            self.process.terminate()
            self.process.communicate(timeout=30)
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def graph(ros_domain):
    graph = Graph(ros_domain)
    yield graph
    graph.close()


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('replay') / 'bag'
    with Bag(path) as bag:
        bag.events(EVENTS)
        for number, t_us in enumerate(FRAMES):
            bag.image(np.full((260, 346), number << 6, np.uint16), t_us)
            bag.imu(t_us + 1, (0.0, 0.0, 9.8), (0.1, 0.2, 0.3))
    return path


def test_a_bag_is_published_as_it_was_recorded(graph, bag):
    for kind, topic, qos in (
        (EventPacket, '/mixtac/events', QOS_EVENTS),
        (Image, '/mixtac/image_raw', QOS_SENSOR),
        (Imu, '/mixtac/imu', QOS_SENSOR),
        (DiagnosticArray, '/diagnostics', 10),
    ):
        graph.listen(kind, topic, qos)
    # Paused, so that nothing is played before the listener is known to the driver.
    graph.start_driver(bag, 'playback_paused:=true')
    topics = ('/mixtac/events', '/mixtac/image_raw', '/mixtac/imu')
    graph.spin_until(lambda: all(graph.node.count_publishers(topic) for topic in topics))
    graph.spin_until(lambda: graph.status()[1].get('playback') == 'paused')
    (result,) = graph.change(playback_paused=False)
    assert result.successful
    graph.spin_until(lambda: graph.status()[1].get('playback') == 'ended')
    packets = graph.got['/mixtac/events']
    decoded = [decode_message(packet) for packet in packets]
    assert_equal(Events.concatenate([each.events for each in decoded]), EVENTS)
    assert (np.diff([packet.seq for packet in packets]) == 1).all()
    assert (np.diff([each.complete_until for each in decoded]) > 0).all()
    images = graph.got['/mixtac/image_raw']
    assert [stamp_to_us(image.header.stamp) for image in images] == list(FRAMES)
    values = [np.frombuffer(image.data, np.uint16)[0] >> 6 for image in images]
    assert values == list(range(len(FRAMES)))
    stamps = [stamp_to_us(imu.header.stamp) for imu in graph.got['/mixtac/imu']]
    assert stamps == [t_us + 1 for t_us in FRAMES]
    status, values = graph.status()
    assert status.level == b'\x00'
    assert 'ended' in status.message
    assert (values['replayed'], values['simulated']) == ('True', 'False')
    assert values['failures'] == '0'
    code, output = graph.stop_driver()
    assert (code, 'Traceback' in output, 'simulated' in output) == (0, False, False)


def test_loops_and_jumps_while_it_runs(graph, bag):
    graph.listen(EventPacket, '/mixtac/events', QOS_EVENTS)
    graph.start_driver(bag, 'playback_loop:=true', 'playback_rate:=2.0')
    packets = graph.got['/mixtac/events']
    graph.spin_until(lambda: packets and packets[-1].time_base // 1000 > START_US + LENGTH_US)
    (result,) = graph.change(playback_seek=0.25)
    assert result.successful
    before = len(packets)
    graph.spin_until(lambda: len(packets) > before + 200)
    times = [decode_message(packet).complete_until for packet in packets]
    assert (np.diff(times) > 0).all()
    (refused,) = graph.change(playback_restamp=True)
    assert not refused.successful
    (refused,) = graph.change(playback_rate=-1.0)
    assert not refused.successful
    assert graph.stop_driver()[0] == 0


@pytest.mark.parametrize('name', ['missing.mcap', 'text.aedat4'])
def test_what_cannot_be_played_ends_the_node_with_one_line(tmp_path, ros_domain, name):
    (tmp_path / 'text.aedat4').write_text('not a recording')
    done = subprocess.run(
        [*COMMAND, '-p', f'device:={tmp_path / name}'],
        env=ros_domain,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    lines = [line for line in done.stderr.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1
    assert name in lines[0]
    assert 'Traceback' not in done.stderr
