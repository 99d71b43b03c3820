# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node over real DDS: its own process, packets and images of the toy sensor, lifecycle."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_events.codec import encode
from mixtac_fger.weights import write_model

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('event_camera_msgs', reason='needs the built workspace: source install/setup')

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger

from mixtac_fger.reference import Reference
from mixtac_msgs.msg import ForceQuality
from mixtac_node.base_node import QOS_SENSOR
from mixtac_node.stamps import stamp_to_us, us_to_stamp

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.dds
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


class Harness:
    """A node process and the client side of everything it offers."""

    def __init__(self, env: dict[str, str], model: str, **parameters: object) -> None:
        command = [sys.executable, '-m', 'mixtac_fger.fger_node', '--ros-args']
        command += ['-r', '__ns:=/mixtac', '-p', f'model:={model}']
        for name, value in {**RELIABLE, **parameters}.items():
            command += ['-p', f'{name}:={value}']
        self.process = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)
        self.errors: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        rclpy.init()
        self.node = rclpy.create_node('harness', namespace='mixtac')
        self.change = self.node.create_client(ChangeState, 'fger/change_state')
        self.state = self.node.create_client(GetState, 'fger/get_state')
        self.tare = self.node.create_client(Trigger, 'fger/tare')
        for client in (self.change, self.state, self.tare):
            assert client.wait_for_service(timeout_sec=60), self.errors
        self.present_state()

    def _read(self) -> None:
        self.errors.extend(self.process.stderr)

    def call(self, client, request, tries: int = 6):
        """Call a service; what is asked must not matter if it is asked twice.

        A server does not wait for a client that it has not discovered yet: its reply is lost.
        """
        for _ in range(tries):
            future = client.call_async(request)
            rclpy.spin_until_future_complete(self.node, future, timeout_sec=20)
            if future.done():
                return future.result()
        raise AssertionError(self.errors)

    def present_state(self) -> int:
        return self.call(self.state, GetState.Request()).current_state.id

    def transition(self, transition: int) -> tuple[bool, int]:
        before = self.present_state()
        request = ChangeState.Request()
        request.transition.id = transition
        future = self.change.call_async(request)
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=60)
        after = self.present_state()
        return future.result().success if future.done() else before != after, after

    def until(self, condition, action=lambda: None, timeout_s: float = 60.0) -> None:
        """Do something again and again until a condition holds."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, self.errors
            action()
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()
        self.process.terminate()
        assert self.process.wait(60) == 0, self.errors
        self._reader.join(5)


@pytest.fixture
def harness(ros_domain, tmp_path, model) -> Iterator[Harness]:
    path = tmp_path / 'toy.safetensors'
    write_model(path, model)
    # All that the toy sensor does is below this threshold, so that ~/tare does not refuse.
    env = {**ros_domain, 'MIXTAC_HOME': str(tmp_path)}
    harness = Harness(env, str(path), contact_threshold=10.0, reference='reference.npz')
    yield harness
    harness.close()


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


def play(harness: Harness, trial) -> tuple[list[WrenchStamped], list[ForceQuality]]:
    """Publish the trial and return the forces that came back, and their quality.

    The trial waits for a slow node: its length in time does not matter to the camera clock.
    """
    node, received, quality = harness.node, [], []
    node.create_subscription(ForceQuality, 'force_quality', quality.append, QOS)
    events = node.create_publisher(EventPacket, 'events', QOS)
    images = node.create_publisher(Image, 'image_raw', QOS)
    node.create_subscription(WrenchStamped, 'force', received.append, QOS)
    deadline = time.monotonic() + 10
    while not (events.get_subscription_count() and images.get_subscription_count()):
        rclpy.spin_once(node, timeout_sec=0.05)
        assert time.monotonic() < deadline
    frame = 0

    def behind_us(until: int) -> int:
        return ORIGIN_US + until - stamp_to_us(received[-1].header.stamp) if received else 0

    for until, message in packets(trial):
        while frame < len(trial.frames) and trial.arrival_us[frame] <= until:
            images.publish(image(trial, frame))
            frame += 1
        events.publish(message)
        rclpy.spin_once(node, timeout_sec=0)
        # Without a force so far, the node is still reading the first frames.
        time.sleep(PACKET_US * (1e-6 if received else 5e-6))
        harness.until(lambda until=until: behind_us(until) < 100_000)
    last_us = ORIGIN_US + int(trial.t_us[-1]) - 2000
    harness.until(lambda: stamp_to_us(received[-1].header.stamp) >= last_us if received else False)
    harness.until(lambda: len(quality) >= len(received))
    return received, quality


def diagnostics(node) -> list[DiagnosticStatus]:
    """Return a list that fills with what the estimator says of itself."""
    found: list[DiagnosticStatus] = []

    def keep(message: DiagnosticArray) -> None:
        found.extend(status for status in message.status if status.name == 'mixtac/fger')

    node.create_subscription(DiagnosticArray, '/diagnostics', keep, 10)
    return found


def check_quality(received, quality) -> None:
    forces = {stamp_to_us(m.header.stamp): m.wrench.force.z for m in received}
    assert len(quality) == len(received)
    for message in quality:
        assert message.force == forces[stamp_to_us(message.header.stamp)]
        assert message.deviation > 0
        assert 0 <= message.frame_age < 10
        assert not message.saturated


def tare_with_still_frames(harness, trial) -> None:
    images = harness.node.create_publisher(Image, 'image_raw', QOS_SENSOR)
    replies = []

    def ask() -> None:
        images.publish(image(trial, 0))
        replies.append(harness.call(harness.tare, Trigger.Request()))

    harness.until(lambda: bool(replies) and replies[-1].success, ask)
    assert 'reference.npz' in replies[-1].message


def test_forces_come_every_2_ms_of_the_camera_clock(harness, trial, tmp_path, config):
    refused = harness.call(harness.tare, Trigger.Request())
    assert not refused.success
    assert 'not active' in refused.message
    assert harness.transition(Transition.TRANSITION_CONFIGURE) == (
        True,
        State.PRIMARY_STATE_INACTIVE,
    )
    assert harness.transition(Transition.TRANSITION_ACTIVATE) == (True, State.PRIMARY_STATE_ACTIVE)
    reports = diagnostics(harness.node)
    received, quality = play(harness, trial)
    stamps = np.array([stamp_to_us(message.header.stamp) for message in received])
    assert {message.header.frame_id for message in received} == {'mixtac_contact'}
    assert (stamps % 2000 == 0).all()
    assert (np.diff(stamps) == 2000).all()
    # A transition that is not possible now is refused, and the node goes on.
    assert harness.transition(Transition.TRANSITION_CONFIGURE) == (
        False,
        State.PRIMARY_STATE_ACTIVE,
    )
    assert stamps[-1] - ORIGIN_US == trial.t_us[-1] - 2000
    # The first frames are the reference: more than half of the windows come after them.
    assert len(stamps) * 2000 > trial.t_us[-1] / 2
    check_quality(received, quality)
    assert any(report.message for report in reports)
    tare_with_still_frames(harness, trial)
    assert Reference(config).load(tmp_path / 'reference.npz').shape == config.frame_shape
    assert harness.transition(Transition.TRANSITION_DEACTIVATE) == (
        True,
        State.PRIMARY_STATE_INACTIVE,
    )
    assert harness.transition(Transition.TRANSITION_ACTIVATE) == (True, State.PRIMARY_STATE_ACTIVE)


def test_a_camera_that_does_not_fit_is_refused_before_and_after_the_start(harness):
    node, size = harness.node, [640, 480]
    infos = node.create_publisher(CameraInfo, 'camera_info', QOS_SENSOR)
    reports = diagnostics(node)

    def show() -> None:
        infos.publish(CameraInfo(width=size[0], height=size[1]))

    def refused() -> bool:
        if not harness.transition(Transition.TRANSITION_CONFIGURE)[0]:
            return True
        assert harness.transition(Transition.TRANSITION_CLEANUP)[0]
        return False

    harness.until(refused, show)
    assert any('640 x 480' in line for line in harness.errors)
    size[:] = 346, 260
    harness.until(lambda: harness.transition(Transition.TRANSITION_CONFIGURE)[0], show)
    assert harness.transition(Transition.TRANSITION_ACTIVATE)[0]
    assert not any('640' in report.message for report in reports)
    assert harness.transition(Transition.TRANSITION_ACTIVE_SHUTDOWN) == (
        True,
        State.PRIMARY_STATE_FINALIZED,
    )
    harness.until(lambda: bool(reports) and 'not active' in reports[-1].message)


@pytest.mark.parametrize('kind', ['missing', 'another architecture'])
def test_a_model_that_cannot_be_used_fails_the_configuration(ros_domain, tmp_path, kind):
    from safetensors.numpy import save_file

    path = tmp_path / 'model.safetensors'
    if kind != 'missing':
        save_file({'w': np.zeros(1)}, path, metadata={'architecture': 'resnet18'})
    harness = Harness(ros_domain, str(path))
    try:
        assert harness.transition(Transition.TRANSITION_CONFIGURE) == (
            False,
            State.PRIMARY_STATE_UNCONFIGURED,
        )
    finally:
        harness.close()
    assert len([line for line in harness.errors if str(path) in line]) == 1
    assert not any('Traceback' in line for line in harness.errors)


def test_parameters_take_effect_at_once_or_are_refused(harness, tmp_path):
    setter = harness.node.create_client(SetParameters, 'fger/set_parameters')
    assert setter.wait_for_service(timeout_sec=30)

    def set_to(**values: object) -> str:
        request = SetParameters.Request(
            parameters=[
                Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
            ]
        )
        (result,) = harness.call(setter, request).results
        return '' if result.successful else result.reason

    harness.transition(Transition.TRANSITION_CONFIGURE)
    harness.transition(Transition.TRANSITION_ACTIVATE)
    assert set_to(force_scale=2.0) == ''
    assert set_to(deadline=0.01) == ''
    assert 'clean up' in set_to(model='fger_small')
    before = sorted(tmp_path.iterdir())
    for name in ('/etc/passwd', '../outside.npz', '.hidden', 'a/b.npz'):
        assert set_to(reference=name) != ''
    assert set_to(reference='toy.safetensors') != ''
    assert set_to(reference='other.npz') == ''
    assert sorted(tmp_path.iterdir()) == before
