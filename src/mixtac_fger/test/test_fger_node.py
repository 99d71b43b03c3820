# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node over real DDS: its own process, packets and images of the toy sensor, lifecycle."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_core.events.codec import encode
from mixtac_fger.config import FgerConfig
from mixtac_fger.weights import write_model

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('event_camera_msgs', reason='needs the built workspace: source install/setup')

from diagnostic_msgs.msg import DiagnosticArray
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, PointCloud2, TimeReference
from std_srvs.srv import Trigger

from mixtac_core.node.topics import stamp_to_us, us_to_stamp
from mixtac_fger.reference import Reference, reference_name
from mixtac_fger.validity import Reason
from mixtac_msgs.msg import Contact, ForceQuality

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.dds
NAME = 'mixtac/fger'
ORIGIN_US = 1_700_000_000_000_000
PACKET_US = 1000
QOS = QoSProfile(depth=2000)
RELIABLE = {
    f'qos_overrides./mixtac/{topic}.reliability': 'reliable'
    for topic in (
        'events.subscription',
        'image_raw.subscription',
        'force.publisher',
        'force_quality.publisher',
    )
}
"""Best effort would lose messages on a machine that is busy with other things."""


class Estimator:
    """The estimator in a graph of the test, and its services."""

    def __init__(self, graph, model, **parameters: object) -> None:
        self.graph = graph
        values = {'model': model, **RELIABLE, **parameters}
        assignments = [f'{name}:={value}' for name, value in values.items()]
        graph.start('mixtac_fger.fger_node', *assignments, remap=('__ns:=/mixtac',))

    @property
    def errors(self) -> list[str]:
        return self.graph.process.stderr.splitlines()

    def tare(self) -> Trigger.Response:
        return self.graph.call(Trigger, '/mixtac/fger/tare')

    def state(self) -> int:
        return self.graph.call(GetState, '/mixtac/fger/get_state').current_state.id

    def transition(self, transition: int) -> tuple[bool, int]:
        """Ask for a transition; return whether it was made, and the state."""
        before, request = self.state(), ChangeState.Request()
        request.transition.id = transition
        answer = self.graph.call(ChangeState, '/mixtac/fger/change_state', request)
        after = self.state()
        # Asked twice, it is refused the second time.
        return answer.success or before != after, after


@pytest.fixture
def estimator(node_under_test, tmp_path, model, monkeypatch) -> Estimator:
    path = tmp_path / 'toy.safetensors'
    write_model(path, model)
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    # All that the toy sensor does is below this threshold, so that ~/tare does not refuse.
    # Random weights give forces that no sensor gives, and the toy's frames have no noise.
    return Estimator(
        node_under_test,
        str(path),
        contact_threshold=10.0,
        reference='reference.npz',
        invalid_force='publish',
        assume_free=True,
        displacement='frames',
        use_sim_time='true',
    )


def packets(trial) -> Iterator[tuple[int, EventPacket]]:
    """Yield (camera time [us] since the start, packet) every millisecond."""
    events = trial.events.shifted(ORIGIN_US)
    for sequence, until in enumerate(range(PACKET_US, int(trial.t_us[-1]), PACKET_US)):
        now = ORIGIN_US + until
        encoded = encode(events.between(now - PACKET_US, now), complete_until=now)
        message = EventPacket(height=260, width=346, seq=sequence, encoding=encoded.encoding)
        message.time_base = encoded.time_base
        message.events.frombytes(encoded.payload.tobytes())
        yield until, message


def image(trial, index: int) -> Image:
    message = Image(height=260, width=346, encoding='mono16', step=692)
    middle = (trial.exposure_start_us[index] + trial.exposure_end_us[index]) // 2
    message.header.stamp = us_to_stamp(ORIGIN_US + int(middle))
    message.data.frombytes(trial.frames[index].tobytes())
    return message


def play(graph, trial) -> tuple[list[WrenchStamped], list[ForceQuality]]:
    """Publish the trial and return the forces that came back, and their quality.

    The trial waits for a slow node: its length in time does not matter to the camera clock. Nor
    does `/clock`, which begins in 1970 here and runs ten times as fast as the camera clock.
    """
    events = graph.node.create_publisher(EventPacket, '/mixtac/events', QOS)
    images = graph.node.create_publisher(Image, '/mixtac/image_raw', QOS)
    quality = graph.listen(ForceQuality, '/mixtac/force_quality', QOS)
    received = graph.listen(WrenchStamped, '/mixtac/force', QOS)
    graph.spin_until(events.get_subscription_count)
    graph.spin_until(images.get_subscription_count)
    clock = graph.node.create_publisher(Clock, '/clock', 10)
    frame = 0

    def behind_us(until: int) -> int:
        return ORIGIN_US + until - stamp_to_us(received[-1].header.stamp) if received else 0

    for until, message in packets(trial):
        while frame < len(trial.frames) and trial.arrival_us[frame] <= until:
            images.publish(image(trial, frame))
            frame += 1
        events.publish(message)
        clock.publish(Clock(clock=us_to_stamp(10 * until)))
        graph.executor.spin_once(timeout_sec=0)
        # Without a force so far, the node is still reading the first frames.
        time.sleep(PACKET_US * (1e-6 if received else 5e-6))
        graph.spin_until(lambda until=until: behind_us(until) < 100_000)
    last_us = ORIGIN_US + int(trial.t_us[-1]) - 2000
    graph.spin_until(
        lambda: stamp_to_us(received[-1].header.stamp) >= last_us if received else False
    )
    graph.spin_until(lambda: len(quality) >= len(received))
    return received, quality


def test_the_numbers_of_the_reasons_are_those_of_the_message():
    for reason in Reason:
        assert getattr(ForceQuality, reason.name) == reason


def check_quality(received, quality) -> None:
    forces = {stamp_to_us(m.header.stamp): m.wrench.force.z for m in received}
    for message in quality:
        assert message.force == forces.pop(stamp_to_us(message.header.stamp))
        assert message.deviation > 0
        assert 0 <= message.frame_age < 10
        assert not message.saturated
        assert message.valid == (message.reason == ForceQuality.TRUSTED)
    assert not forces


def tare_with_still_frames(estimator, trial) -> None:
    images = estimator.graph.node.create_publisher(Image, '/mixtac/image_raw', QOS)
    replies = []

    def ask() -> None:
        images.publish(image(trial, 0))
        replies.append(estimator.tare())

    estimator.graph.spin_until(lambda: bool(replies) and replies[-1].success, ask)
    assert 'reference.npz' in replies[-1].message


def test_forces_come_every_2_ms_of_the_camera_clock(estimator, trial, tmp_path, config):
    refused = estimator.tare()
    assert not refused.success
    assert 'not active' in refused.message
    inactive, active = State.PRIMARY_STATE_INACTIVE, State.PRIMARY_STATE_ACTIVE
    assert estimator.transition(Transition.TRANSITION_CONFIGURE) == (True, inactive)
    assert estimator.transition(Transition.TRANSITION_ACTIVATE) == (True, active)
    estimator.graph.listen(DiagnosticArray, '/diagnostics', 10)
    contacts = estimator.graph.listen(Contact, '/mixtac/contact', QOS)
    clouds = estimator.graph.listen(PointCloud2, '/mixtac/displacement/points', QOS)
    received, quality = play(estimator.graph, trial)
    assert {each.header.frame_id for each in [*contacts, *clouds]} == {'mixtac_contact'}
    assert all(each.in_contact or not each.located for each in contacts)
    points = np.frombuffer(clouds[-1].data, np.float32).reshape(-1, 6)
    assert len(points) == clouds[-1].width * clouds[-1].height
    assert np.isfinite(points).all()
    stamps = np.array([stamp_to_us(message.header.stamp) for message in received])
    assert {message.header.frame_id for message in received} == {'mixtac_contact'}
    assert (stamps % 2000 == 0).all()
    assert (np.diff(stamps) == 2000).all()
    # A transition that is not possible now is refused, and the node goes on.
    assert estimator.transition(Transition.TRANSITION_CONFIGURE) == (False, active)
    assert stamps[-1] - ORIGIN_US == trial.t_us[-1] - 2000
    # The first frames are the reference: more than half of the windows come after them.
    assert len(stamps) * 2000 > trial.t_us[-1] / 2
    check_quality(received, quality)
    assert estimator.graph.diagnostics(NAME)['message']
    tare_with_still_frames(estimator, trial)
    assert Reference(config).load(tmp_path / 'reference.npz').shape == config.frame_shape
    assert estimator.transition(Transition.TRANSITION_DEACTIVATE) == (True, inactive)
    assert estimator.transition(Transition.TRANSITION_ACTIVATE) == (True, active)


def test_a_camera_brings_its_kept_reference_or_none(node_under_test, tmp_path, model, monkeypatch):
    path = tmp_path / 'toy.safetensors'
    write_model(path, model)
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    config = FgerConfig.from_dict(model.config)
    kept = Reference(config)
    kept.use(np.zeros(config.frame_shape, np.float32))
    kept.save(tmp_path / reference_name('V2'))
    (tmp_path / reference_name('V3')).write_bytes(b'no reference')
    estimator = Estimator(node_under_test, str(path))
    graph = estimator.graph
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    clocks = graph.node.create_publisher(TimeReference, '/mixtac/camera_clock', latched)
    graph.listen(DiagnosticArray, '/diagnostics', 10)
    assert estimator.transition(Transition.TRANSITION_CONFIGURE)[0]
    assert estimator.transition(Transition.TRANSITION_ACTIVATE)[0]
    for serial, waits in (('V1', 'reference'), ('V2', 'for a frame'), ('V3', 'reference')):
        graph.spin_until(
            lambda waits=waits: waits in graph.diagnostics(NAME).get('message', ''),
            lambda serial=serial: clocks.publish(TimeReference(source=serial)),
        )
    graph.spin_until(lambda: any(reference_name('V3') in line for line in estimator.errors))


def test_autostart_activates_once_and_never_again(node_under_test, tmp_path, model):
    path = tmp_path / 'toy.safetensors'
    write_model(path, model)
    estimator = Estimator(node_under_test, str(path), autostart='true')
    node_under_test.spin_until(lambda: estimator.state() == State.PRIMARY_STATE_ACTIVE)
    for number in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        assert estimator.transition(number)[0]
    # Somebody who configures it by hand may not want it active.
    inactive = State.PRIMARY_STATE_INACTIVE
    assert estimator.transition(Transition.TRANSITION_CONFIGURE) == (True, inactive)
    end_s = time.monotonic() + 1.0
    node_under_test.spin_until(lambda: time.monotonic() > end_s)
    assert estimator.state() == inactive


def test_parameters_take_effect_at_once_or_are_refused(estimator, tmp_path):
    def set_to(**values: object) -> str:
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        request = SetParameters.Request(parameters=[p.to_parameter_msg() for p in parameters])
        answer = estimator.graph.call(SetParameters, '/mixtac/fger/set_parameters', request)
        (result,) = answer.results
        return '' if result.successful else result.reason

    def field_offered() -> bool:
        topic = '/mixtac/displacement/points'
        return bool(estimator.graph.node.get_publishers_info_by_topic(topic))

    estimator.transition(Transition.TRANSITION_CONFIGURE)
    estimator.transition(Transition.TRANSITION_ACTIVATE)
    for displacement in ('off', 'frames'):
        assert set_to(displacement=displacement) == ''
        estimator.transition(Transition.TRANSITION_DEACTIVATE)
        estimator.transition(Transition.TRANSITION_ACTIVATE)
        estimator.graph.spin_until(lambda on=displacement != 'off': field_offered() == on)
    assert set_to(force_scale=2.0) == ''
    assert set_to(deadline=0.01) == ''
    assert 'clean up' in set_to(model='fger_small')
    before = sorted(tmp_path.iterdir())
    for name in ('/etc/passwd', '../outside.npz', '.hidden', 'a/b.npz'):
        assert set_to(reference=name) != ''
    assert set_to(reference='toy.safetensors') != ''
    assert set_to(reference='other.npz') == ''
    assert sorted(tmp_path.iterdir()) == before
