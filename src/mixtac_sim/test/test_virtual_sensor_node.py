# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual sensor node as a process of its own, over real DDS."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from mixtac_node.base_node import QOS_FORCE
from mixtac_node.stamps import stamp_to_ns
from mixtac_sim.usb.endpoints import serial_number
from mixtac_sim.usb.pyusb_backend import open_backend

pytestmark = pytest.mark.dds
COMMAND = [sys.executable, '-m', 'mixtac_sim.virtual_sensor_node', '--ros-args']
# Building a sensor compiles and solves the layer: slow once, on a machine with an empty cache.
PATIENCE_S = 120.0


class Bench:
    """The node and a listener."""

    def __init__(self, env, path):
        self.env, self.path = env, path
        self.process = None
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = Node('listener', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.reference, self.truth, self.diagnostics = [], [], []
        for topic, kept in (
            ('/ft_sensor/wrench', self.reference),
            ('/mixtac/truth/wrench', self.truth),
        ):
            self.node.create_subscription(WrenchStamped, topic, kept.append, QOS_FORCE)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.diagnostics.append, 10)
        self.client = self.node.create_client(Trigger, '/mixtac/virtual_sensor/play')

    def start(self, *parameters):
        words = [word for each in (f'socket:={self.path}', *parameters) for word in ('-p', each)]
        self.process = subprocess.Popen(
            [*COMMAND, *words], env=self.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )

    def spin_until(self, condition):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, (len(self.reference), len(self.truth))
            assert self.process.poll() is None, self.process.stdout.read().decode()
            self.executor.spin_once(timeout_sec=0.1)

    def finish(self):
        self.process.send_signal(signal.SIGINT)
        output, _ = self.process.communicate(timeout=20)
        return self.process.returncode, output.decode()

    def close(self):
        if self.process is not None and self.process.poll() is None:
            # Killed, it would still be a peer of the node here, whose end then crashes at times.
            self.process.terminate()
            self.process.communicate(timeout=30)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def bench(ros_domain, tmp_path):
    bench = Bench(ros_domain, str(tmp_path / 'camera.sock'))
    yield bench
    bench.close()


def times(messages):
    return np.array([stamp_to_ns(message.header.stamp) for message in messages])


def normal_force(messages):
    return np.array([message.wrench.force.z for message in messages])


def test_publishes_reference_and_truth_and_plays_on_request(bench):
    began_ns = time.time_ns()
    bench.start('device_seed:=3', 'seed:=5', 'scenario:=press', 'seconds:=10.0')
    bench.spin_until(lambda: len(bench.truth) > 500 and bench.diagnostics)
    # Whole periods of 1.25 ms of the reference's own clock; stalls of the host shift the truth.
    truth, reference = np.diff(times(bench.truth)), np.diff(times(bench.reference))
    assert set((reference % 1_250_000).tolist()) == {0}
    assert min(truth.min(), reference.min()) > 0
    assert began_ns < times(bench.truth)[0]
    assert times(bench.truth)[-1] < time.time_ns()
    assert bench.truth[0].header.frame_id == 'mixtac_contact'
    assert bench.reference[0].header.frame_id == 'ft_sensor'
    assert normal_force(bench.truth).max() == 0.0

    future = bench.client.call_async(Trigger.Request())
    bench.spin_until(future.done)
    assert future.result().success
    assert 'press' in future.result().message
    bench.spin_until(lambda: normal_force(bench.truth).max() > 0.1)
    bench.spin_until(lambda: normal_force(bench.reference[-200:]).max() > 0.07)

    camera = open_backend(f'virtual:{bench.path}')
    assert list(camera.enumerate_devices()) == ['virtual']
    bench.spin_until(lambda: 'playing' in status(bench).message)
    assert 'SIMULATED' in status(bench).message
    assert status(bench).hardware_id == serial_number(3)
    values = {pair.key: pair.value for pair in status(bench).values}
    assert values['simulated'] == 'True'
    code, _ = bench.finish()
    assert code == 0
    assert not list(camera.enumerate_devices())


def test_touches_on_request_and_follows_commanded_forces(bench):
    bench.start('device_seed:=3', 'press_force:=0.4', 'hold_seconds:=0.0', 'object:=weight_20_g')
    bench.spin_until(lambda: len(bench.truth) > 100)
    for gesture, words, reached in (
        ('press', '0.4 N', lambda f: abs(f[-1] - 0.4) < 0.02),
        ('load', 'weight_20_g', lambda f: abs(f[-1] - 0.196) < 0.01),
        ('release', 'released', lambda f: f[-1] == 0.0),
        ('drop', '50.0 mm', lambda f: f[-100:].max() > 1.0),
    ):
        client = bench.node.create_client(Trigger, f'/mixtac/virtual_sensor/{gesture}')
        bench.spin_until(client.service_is_ready)
        future = client.call_async(Trigger.Request())
        bench.spin_until(future.done)
        assert future.result().success
        assert words in future.result().message
        bench.spin_until(lambda reached=reached: reached(normal_force(bench.truth)))

    topic = '/mixtac/virtual_sensor/force_command'
    publisher = bench.node.create_publisher(WrenchStamped, topic, QOS_FORCE)
    command = WrenchStamped()

    def commanded(force):
        command.wrench.force.z = force
        publisher.publish(command)
        bench.executor.spin_once(timeout_sec=0.02)
        return abs(normal_force(bench.truth[-1:])[0] - force) < 0.02

    for force in (0.8, 0.3):
        bench.spin_until(lambda force=force: commanded(force))
    bench.spin_until(lambda: normal_force(bench.truth[-1:])[0] == 0.0)
    commanded(float('nan'))
    bench.spin_until(
        lambda: {v.key: v.value for v in status(bench).values}['force_commands_refused'] == '1'
    )
    assert bench.finish()[0] == 0


def status(bench):
    found = [s for array in bench.diagnostics for s in array.status if 'virtual_sensor' in s.name]
    return found[-1]


def test_a_wrong_scenario_ends_with_one_clear_line(bench):
    bench.start('scenario:=dancing')
    output, _ = bench.process.communicate(timeout=60)
    lines = output.decode().strip().splitlines()
    assert bench.process.returncode == 1
    assert len(lines) == 1
    assert 'dancing' in lines[0]
    assert 'press' in lines[0]
