# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record` over real topics, read by rosbags alone; what it counts; how it ends."""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rosbags.highlevel import AnyReader

from mixtac.main import main
from mixtac.record import Listener, TopicMeter, verdict
from mixtac_core.events.packets import EncodedPacket, PacketWriter
from mixtac_core.node.base_node import qos
from mixtac_core.node.topics import EVENTS, IMAGE_RAW
from mixtac_core.recordings.bag import BagFile

if TYPE_CHECKING:
    from pathlib import Path

ENOUGH = 3_000_000
"""Size of a bag with some hundred packets [bytes]; a busy machine starts to record late."""


def payload(index: int) -> bytes:
    return np.random.default_rng(index).bytes(500 * (index % 40))


def publish_all(graph, bag: Path) -> None:
    """Publish packets, and the state of a simulated driver, until enough is recorded."""
    from event_camera_msgs.msg import EventPacket

    publisher = graph.node.create_publisher(EventPacket, '/here/events', qos(EVENTS))
    state = graph.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    simulated = [KeyValue(key='simulated', value='True')]
    states = [
        DiagnosticStatus(name=name, hardware_id=serial, values=simulated)
        for serial, name in (('0042', 'here/driver'), ('0043', 'other/here/driver'))
    ]
    index, file = 0, bag / f'{bag.name}.mcap'
    while not file.exists() or file.stat().st_size < ENOUGH:
        message = EventPacket(height=260, width=346, seq=index, encoding='libcaer_cmp')
        message.events.frombytes(payload(index))
        publisher.publish(message)
        if index % 50 == 0:
            state.publish(DiagnosticArray(status=states))
        index += 1
        time.sleep(0.001)


@pytest.mark.dds
def test_rosbags_alone_reads_every_packet_and_its_bytes_are_those_sent(
    node_under_test, ros_domain, tmp_path
):
    bag = tmp_path / 'one'
    words = [sys.executable, '-m', 'mixtac', 'record', str(bag), '--namespace', 'here']
    words += ['--wait', 'inf']
    with subprocess.Popen(words, env=ros_domain, stdout=subprocess.PIPE, text=True) as process:
        try:
            publish_all(node_under_test, bag)
            process.send_signal(signal.SIGINT)
            output, _ = process.communicate()
        finally:
            process.kill()
    assert process.returncode == 0, output
    numbers = []
    with AnyReader([bag]) as reader:
        chosen = [c for c in reader.connections if c.topic == '/here/events']
        for connection, _, data in reader.messages(chosen):
            message = reader.deserialize(data, connection.msgtype)
            numbers.append(message.seq)
            assert message.events.tobytes() == payload(message.seq)
    assert numbers == sorted(set(numbers))
    # On a loaded machine some get lost on the way, which the command has to know.
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    (described,) = yaml.safe_load((tmp_path / 'dataset.yaml').read_text())['trials']
    assert described['topics']['events']['missing'] == missing
    assert described['topics']['events']['messages'] == len(numbers) > 0
    assert described['not_written'] == 0
    assert (described['serial'], described['simulated']) == ('0042', True)


@pytest.mark.dds
@pytest.mark.usefixtures('ros_domain')
def test_without_a_sensor_nothing_is_recorded(tmp_path, capfd):
    assert main(['record', str(tmp_path / 'bag'), '--wait', '0']) == 1
    assert '/mixtac/events' in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.dds
@pytest.mark.usefixtures('ros_domain')
def test_an_error_leaves_a_bag_that_is_whole(tmp_path):
    def fail():
        with Listener.opened('record', 'mixtac') as listener:
            listener.listen('/ft_sensor/wrench')
            listener.start(tmp_path / 'bag')
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    with BagFile(tmp_path / 'bag') as found:
        assert found.damage == ''


def packet(number: int) -> bytes:
    """Return a serialised event packet."""
    encoded = EncodedPacket(7, np.zeros(4, np.uint8))
    return PacketWriter('camera', (346, 260)).write(encoded, number, 10**9)


def stamped(stamp_ns: int) -> bytes:
    return b'\0\1\0\0' + struct.pack('<iI', *divmod(stamp_ns, 10**9)) + bytes(8)


def test_packets_missing_by_number_are_counted_and_reported():
    meter = TopicMeter(EVENTS)
    for received, seq in enumerate([5, 6, 9, 10, 0, 1]):
        meter.add(10**9 + received, packet(seq))
    assert (meter.messages, meter.missing) == (6, 2)
    nothing = {'seconds': 1.0, 'not_written': 0, 'stopped': '', 'topics': {}}
    assert 'no losses' in verdict(nothing)
    said = verdict(nothing | {'not_written': 7, 'topics': {'events': meter.figures()}})
    assert '2 of events' in said
    assert '7 ' in said
    meter.restart()
    meter.add(10**9, packet(700))
    assert (meter.messages, meter.missing) == (1, 0)


def test_topics_without_numbers_show_rate_and_longest_gap_since_the_restart():
    meter = TopicMeter(IMAGE_RAW)
    meter.add(1, stamped(10**9))
    meter.restart()
    for n in (0, 1, 2, 5, 6):
        meter.add(10**9 + n * 25_000_000, stamped(10**9))
    assert (meter.messages, meter.missing) == (5, 0)
    assert meter.figures()['longest_gap_s'] == pytest.approx(0.075)
    assert meter.rate_hz == pytest.approx(4 / 0.15)


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', bytes(8), b'\0\1\0\0' + b'\xff' * 30])
def test_damaged_packets_are_lost(data):
    meter = TopicMeter(EVENTS)
    assert not meter.add(10**9, data)
    assert meter.add(10**9, packet(7))
    assert (meter.messages, meter.missing) == (1, 1)
