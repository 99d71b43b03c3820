# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process of its own, over real DDS, while its camera fails."""

from __future__ import annotations

import pytest

pytest.importorskip('event_camera_msgs.msg')
pytest.importorskip('mixtac_sim.usb.server')

from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket

from mixtac_node.base_node import QOS_EVENTS
from mixtac_sim.usb.faults import Fault, FaultKind
from mixtac_sim.usb.pyusb_backend import inject

pytestmark = pytest.mark.dds
DRIVER = 'mixtac_driver.node.driver_node'


@pytest.fixture
def graph(camera, node_under_test):
    camera.plug_in()
    node_under_test.listen(EventPacket, '/mixtac/events', QOS_EVENTS)
    node_under_test.listen(DiagnosticArray, '/diagnostics', 10)
    return node_under_test


def is_in_error(graph):
    """Return None before the first diagnostics."""
    level = graph.diagnostics('mixtac/driver').get('level')
    return level and level == '2'


def test_unplugged_camera_is_an_error_until_it_is_back_and_packets_go_on(camera, graph):
    packets = graph.got['/mixtac/events']
    graph.start(DRIVER, camera.device)
    graph.spin_until(lambda: len(packets) > 50 and is_in_error(graph) is False)
    exposure = {camera.scene.device.exposure_us}
    inject(camera.path, Fault(FaultKind.UNPLUG))
    graph.spin_until(lambda: is_in_error(graph))
    values = graph.diagnostics('mixtac/driver')
    assert values['state'] in {'waiting to reconnect', 'connecting'}
    assert values['message']
    before = len(packets)
    inject(camera.path, Fault(FaultKind.PLUG_IN))
    graph.spin_until(lambda: len(packets) > before + 50 and is_in_error(graph) is False)
    assert {camera.scene.device.exposure_us} == exposure
    sequence = [packet.seq for packet in packets]
    assert sequence == list(range(sequence[0], sequence[0] + len(packets)))
    times = [packet.time_base for packet in packets]
    assert times == sorted(times)
    assert graph.stop()[0] == 0


def test_fail_stop_ends_the_process_with_one_line_and_status_1(camera, graph):
    graph.start(DRIVER, camera.device, 'recovery_policy:=fail_stop')
    graph.spin_until(lambda: len(graph.got['/mixtac/events']) > 20)
    inject(camera.path, Fault(FaultKind.UNPLUG))
    assert graph.process.wait(15) == 1
    lines = [line for line in graph.process.stderr.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1
    assert 'unplugged' in lines[0]
    assert 'Traceback' not in graph.process.stderr
