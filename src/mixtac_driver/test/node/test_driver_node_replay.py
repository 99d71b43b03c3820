# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process of its own, on a recording, over real DDS."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('event_camera_msgs.msg')

from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from recording_samples import START_US, Bag, assert_equal, some_events
from sensor_msgs.msg import Image, Imu

from mixtac_events.arrays import Events
from mixtac_events.codec import decode_message
from mixtac_node.base_node import QOS_EVENTS, QOS_SENSOR
from mixtac_node.stamps import stamp_to_us

pytestmark = pytest.mark.dds
DRIVER = 'mixtac_driver.node.driver_node'
LENGTH_US = 500_000
EVENTS = some_events(length_us=LENGTH_US)
FRAMES = range(START_US + 100_000, START_US + LENGTH_US, 100_000)


def change(graph, **values):
    """Set parameters one by one."""
    parameters = [Parameter(n, value=value).to_parameter_msg() for n, value in values.items()]
    request = SetParameters.Request(parameters=parameters)
    return graph.call(SetParameters, '/mixtac/driver/set_parameters', request).results


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('replay') / 'bag'
    with Bag(path) as bag:
        bag.events(EVENTS)
        for number, t_us in enumerate(FRAMES):
            bag.image(np.full((260, 346), number << 6, np.uint16), t_us)
            bag.imu(t_us + 1, (0.0, 0.0, 9.8), (0.1, 0.2, 0.3))
    return path


def test_a_bag_is_published_as_it_was_recorded(node_under_test, bag):
    graph = node_under_test
    for kind, topic, qos in (
        (EventPacket, '/mixtac/events', QOS_EVENTS),
        (Image, '/mixtac/image_raw', QOS_SENSOR),
        (Imu, '/mixtac/imu/data_raw', QOS_SENSOR),
        (DiagnosticArray, '/diagnostics', 10),
    ):
        graph.listen(kind, topic, qos)
    # Paused, so that nothing is played before the listener is known to the driver.
    graph.start(DRIVER, f'device:={bag}', 'playback_paused:=true')
    topics = ('/mixtac/events', '/mixtac/image_raw', '/mixtac/imu/data_raw')
    graph.spin_until(lambda: all(graph.node.count_publishers(topic) for topic in topics))
    graph.spin_until(lambda: graph.diagnostics('mixtac/driver').get('playback') == 'paused')
    (result,) = change(graph, playback_paused=False)
    assert result.successful
    graph.spin_until(lambda: graph.diagnostics('mixtac/driver').get('playback') == 'ended')
    packets = graph.got['/mixtac/events']
    # Diagnostics may overtake what is still in the listener's queues.
    graph.spin_until(lambda: decode_message(packets[-1]).complete_until >= EVENTS.t[-1])
    graph.spin_until(lambda: all(len(graph.got[topic]) == len(FRAMES) for topic in topics[1:]))
    decoded = [decode_message(packet) for packet in packets]
    assert_equal(Events.concatenate([each.events for each in decoded]), EVENTS)
    assert (np.diff([packet.seq for packet in packets]) == 1).all()
    assert (np.diff([each.complete_until for each in decoded]) > 0).all()
    images = graph.got['/mixtac/image_raw']
    assert [stamp_to_us(image.header.stamp) for image in images] == list(FRAMES)
    values = [np.frombuffer(image.data, np.uint16)[0] >> 6 for image in images]
    assert values == list(range(len(FRAMES)))
    stamps = [stamp_to_us(imu.header.stamp) for imu in graph.got['/mixtac/imu/data_raw']]
    assert stamps == [t_us + 1 for t_us in FRAMES]
    values = graph.diagnostics('mixtac/driver')
    assert values['level'] == '0'
    assert 'ended' in values['message']
    assert (values['replayed'], values['simulated']) == ('True', 'False')
    assert values['failures'] == '0'
    code, output = graph.stop()
    assert (code, 'Traceback' in output, 'simulated' in output) == (0, False, False)


def test_loops_and_jumps_while_it_runs(node_under_test, bag):
    graph = node_under_test
    graph.listen(EventPacket, '/mixtac/events', QOS_EVENTS)
    graph.start(DRIVER, f'device:={bag}', 'playback_loop:=true', 'playback_rate:=2.0')
    packets = graph.got['/mixtac/events']
    graph.spin_until(lambda: packets and packets[-1].time_base // 1000 > START_US + LENGTH_US)
    (result,) = change(graph, playback_seek=0.25)
    assert result.successful
    before = len(packets)
    graph.spin_until(lambda: len(packets) > before + 200)
    times = [decode_message(packet).complete_until for packet in packets]
    assert (np.diff(times) > 0).all()
    (refused,) = change(graph, playback_restamp=True)
    assert not refused.successful
    (refused,) = change(graph, playback_rate=-1.0)
    assert not refused.successful
    assert graph.stop()[0] == 0


@pytest.mark.parametrize('name', ['missing.mcap', 'text.aedat4'])
def test_what_cannot_be_played_ends_the_node_with_one_line(tmp_path, node_under_test, name):
    (tmp_path / 'text.aedat4').write_text('not a recording')
    node_under_test.start(DRIVER, f'device:={tmp_path / name}')
    process = node_under_test.process
    assert process.wait(60) == 1
    lines = [line for line in process.stderr.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1
    assert name in lines[0]
    assert 'Traceback' not in process.stderr
