# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual sensor node as a process of its own, over real DDS."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from mixtac_core.node.base_node import QOS_FORCE
from mixtac_core.node.topics import stamp_to_ns
from mixtac_msgs.srv import Touch
from mixtac_sim.usb.endpoints import serial_number
from mixtac_sim.usb.pyusb_backend import open_backend

pytestmark = pytest.mark.dds
REFERENCE, TRUTH = '/ft_sensor/wrench', '/mixtac/truth/wrench'
NODE = 'mixtac_sim.virtual_sensor_node'
NAME = 'mixtac/virtual_sensor'


@pytest.fixture(scope='module')
def path(tmp_path_factory):
    return tmp_path_factory.mktemp('usb') / 'camera.sock'


@pytest.fixture(scope='module')
def graph(module_node_under_test, path):
    """Return what `node_under_test` does, with the sensor running and listening to it."""
    graph = module_node_under_test
    for topic in (REFERENCE, TRUTH):
        graph.listen(WrenchStamped, topic, QOS_FORCE)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    graph.listen(Clock, '/clock', 10)
    graph.began_ns = time.time_ns()
    options = ('device_seed:=3', 'seed:=5', 'scenario:=press', 'seconds:=10.0')
    graph.start(NODE, f'socket:={path}', 'publish_clock:=true', *options)
    return graph


def times(messages):
    return np.array([stamp_to_ns(message.header.stamp) for message in messages])


def normal_force(messages):
    return np.array([message.wrench.force.z for message in messages])


def test_publishes_reference_and_truth_and_plays_on_request(graph, path):
    reference, truth = graph.got[REFERENCE], graph.got[TRUTH]
    clock = graph.got['/clock']
    graph.spin_until(lambda: len(truth) > 500 and len(clock) > 50 and graph.diagnostics(NAME))
    # The clock stands still with simulated time.
    newest_ns = [stamp_to_ns(each.clock) for each in clock]
    assert newest_ns == sorted(newest_ns)
    assert newest_ns[-1] <= time.time_ns()
    # Whole periods of 1.25 ms of the reference's own clock; stalls of the host shift the truth.
    truth_ns, reference_ns = np.diff(times(truth)), np.diff(times(reference))
    assert set((reference_ns % 1_250_000).tolist()) == {0}
    assert min(truth_ns.min(), reference_ns.min()) > 0
    assert graph.began_ns < times(truth)[0]
    assert times(truth)[-1] < time.time_ns()
    assert truth[0].header.frame_id == 'mixtac_contact'
    assert reference[0].header.frame_id == 'ft_sensor'
    assert normal_force(truth).max() == 0.0

    answer = graph.call(Trigger, '/mixtac/virtual_sensor/play')
    assert answer.success
    assert 'press' in answer.message
    graph.spin_until(lambda: truth[-1].wrench.force.z > 0.1)
    graph.spin_until(lambda: reference[-1].wrench.force.z > 0.07)

    camera = open_backend(f'virtual:{path}')
    assert list(camera.enumerate_devices()) == ['virtual']
    graph.spin_until(lambda: 'playing' in graph.diagnostics(NAME)['message'])
    values = graph.diagnostics(NAME)
    assert 'SIMULATED' in values['message']
    assert values['hardware_id'] == serial_number(3)
    assert values['simulated'] == 'True'


def test_touches_on_request_and_follows_commanded_forces(graph, path):
    truth = graph.got[TRUTH]
    graph.spin_until(lambda: len(truth) > 100)

    def sideways():
        return np.hypot(truth[-1].wrench.force.x, truth[-1].wrench.force.y)

    service, weight = '/mixtac/virtual_sensor/touch', {'object': 'weight_20_g', 'hold': 0.0}
    for request, reached in (
        ({'gesture': 'press', 'force': 0.4}, lambda f: abs(f[-1] - 0.4) < 0.02),
        ({'gesture': 'pull', 'force': 1.0, 'pull': 0.2}, lambda _: abs(sideways() - 0.2) < 0.02),
        ({'gesture': 'load'}, lambda f: abs(f[-1] - 0.196) < 0.01),
        ({'gesture': 'release'}, lambda f: f[-1] == 0.0),
        ({'gesture': 'drop'}, lambda f: f.max() > 1.0),
    ):
        answer = graph.call(Touch, service, Touch.Request(**weight, **request))
        assert answer.success
        assert answer.message
        graph.spin_until(lambda reached=reached: reached(normal_force(truth[-100:])))
    answer = graph.call(Touch, service, Touch.Request(gesture='press', force=99.0))
    assert not answer.success
    assert '99.0' in answer.message
    camera = open_backend(f'virtual:{path}')
    assert graph.stop()[0] == 0
    assert not list(camera.enumerate_devices())


def test_a_wrong_scenario_ends_with_one_clear_line(node_under_test, tmp_path):
    node_under_test.start(NODE, f'socket:={tmp_path}/camera.sock', 'scenario:=dancing')
    process = node_under_test.process
    assert process.wait(60) == 1
    lines = (process.stdout + process.stderr).strip().splitlines()
    assert len(lines) == 1
    assert 'dancing' in lines[0]
    assert 'press' in lines[0]
