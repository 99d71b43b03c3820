# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process of its own, over real DDS, while its camera fails."""

from __future__ import annotations

import pytest

pytest.importorskip('event_camera_msgs.msg')
pytest.importorskip('mixtac_sim.usb.server')

from diagnostic_msgs.msg import DiagnosticArray
from driver_graph import Graph
from event_camera_msgs.msg import EventPacket

from mixtac_node.base_node import QOS_EVENTS
from mixtac_sim.usb.faults import Fault, FaultKind
from mixtac_sim.usb.pyusb_backend import inject

pytestmark = pytest.mark.dds
ERROR = b'\x02'


@pytest.fixture
def graph(tmp_path, ros_domain):
    graph = Graph(tmp_path, ros_domain)
    graph.plug_in()
    graph.listen(EventPacket, '/mixtac/events', QOS_EVENTS)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    yield graph
    graph.close()


def is_at(graph, level):
    status = graph.latest_diagnostics()
    return status is not None and (status.level == ERROR) == (level == ERROR)


def test_unplugged_camera_is_an_error_until_it_is_back_and_packets_go_on(graph):
    packets = graph.got['/mixtac/events']
    graph.start_driver()
    graph.spin_until(lambda: len(packets) > 50 and is_at(graph, b'\0'))
    exposure = {graph.scene.device.exposure_us}
    inject(graph.path, Fault(FaultKind.UNPLUG))
    graph.spin_until(lambda: is_at(graph, ERROR))
    status = graph.latest_diagnostics()
    values = {each.key: each.value for each in status.values}
    assert values['state'] in {'waiting to reconnect', 'connecting'}
    assert status.message
    before = len(packets)
    inject(graph.path, Fault(FaultKind.PLUG_IN))
    graph.spin_until(lambda: len(packets) > before + 50 and is_at(graph, b'\0'))
    assert {graph.scene.device.exposure_us} == exposure
    sequence = [packet.seq for packet in packets]
    assert sequence == list(range(sequence[0], sequence[0] + len(packets)))
    times = [packet.time_base for packet in packets]
    assert times == sorted(times)
    assert graph.stop_driver()[0] == 0


def test_fail_stop_ends_the_process_with_one_line_and_status_1(graph):
    graph.start_driver('recovery_policy:=fail_stop')
    graph.spin_until(lambda: len(graph.got['/mixtac/events']) > 20)
    inject(graph.path, Fault(FaultKind.UNPLUG))
    output, _ = graph.process.communicate(timeout=15)
    assert graph.process.returncode == 1
    lines = [line for line in output.decode().splitlines() if line.startswith('error: ')]
    assert len(lines) == 1
    assert 'unplugged' in lines[0]
    assert b'Traceback' not in output
