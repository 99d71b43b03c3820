# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A little of the fuzz of the nodes over DDS, and that a failing callback would be seen."""

from __future__ import annotations

from random import Random

import pytest
import typer

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('event_camera_msgs', reason='needs the built workspace: source install/setup')

from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import CameraInfo

from mixtac_lab.bench import fuzz_nodes as bench
from mixtac_lab.bench.fuzz_nodes import fuzz_target, leaves, mutate
from mixtac_lab.bench.programs.fuzz_node import DirectTarget, LiveTarget, Mutations, sound_message

NODES = {
    'fger': ('mixtac_fger.fger_node', 'invalid_force:=publish'),
    'slip_control': ('mixtac_slip_control.slip_control_node', 'arm:=fr3'),
    'alignment': ('mixtac_alignment.alignment_node',),
}


@pytest.mark.dds
@pytest.mark.parametrize('name', NODES)
def test_no_message_and_no_request_ends_a_node(node_under_test, tmp_path, monkeypatch, name):
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    graph = node_under_test
    module, *parameters = NODES[name]
    graph.start(module, *parameters, remap=('__ns:=/mixtac',))
    target = LiveTarget(
        graph.node, lambda: graph.executor.spin_once(timeout_sec=0.05), f'/mixtac/{name}'
    )
    rng = Random(1)
    sent = fuzz_target(target, rng, Mutations(rng), 100, 5)
    graph.check()
    assert '/mixtac/events' in sent
    assert '/clock' in sent
    assert target.unanswered == 0
    assert 'Traceback' not in graph.process.stderr


@pytest.mark.parametrize('kind', [EventPacket, CameraInfo, SetParameters.Request])
def test_mutations_reach_every_field_and_stay_serialisable(kind):
    from rclpy.serialization import deserialize_message, serialize_message

    rng, changed = Random(2), set()
    for _ in range(300):
        message = sound_message(kind)
        before = {(type(owner), name): getattr(owner, name) for owner, name, _ in leaves(message)}
        mutate(rng, message)
        after = {(type(owner), name): getattr(owner, name) for owner, name, _ in leaves(message)}
        changed |= {key for key in before if str(before[key]) != str(after.get(key))}
        if kind is not SetParameters.Request:
            deserialize_message(serialize_message(message), kind)
    assert changed == set(before)


def test_a_failing_callback_is_counted():
    class Subscription:
        topic_name, msg_type, raw = 'force', WrenchStamped, False

        def callback(self, message: WrenchStamped) -> None:
            raise ValueError(message.header.frame_id)

    class Node:
        subscriptions = (Subscription(),)

    target, mutated = DirectTarget(Node()), Mutations(Random(3))
    for _ in range(10):
        target.send('force', mutated(WrenchStamped))
    assert sum(target.errors.values()) > 5
    assert target.slowest_ms['force'] > 0.0


@pytest.mark.parametrize(('errors', 'ended'), [(['1 x force: ValueError'], ''), ([], 'gone')])
def test_command_fails_where_a_node_ended_or_raised(monkeypatch, errors, ended):
    run = {'node': 'fger', 'live': True, 'sent': {}, 'errors': errors, 'ended': ended}
    monkeypatch.setattr(bench, 'fuzz_live', lambda *_: run)
    with pytest.raises(typer.Exit) as left:
        bench.fuzz_nodes(messages=0, node='fger')
    assert left.value.exit_code == 1
