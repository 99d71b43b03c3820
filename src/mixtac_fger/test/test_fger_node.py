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
from mixtac_fger.weights import ModelCard, save_model

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('event_camera_msgs', reason='needs the built workspace: source install/setup')

import rclpy
from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, QOS_SENSOR, stamp_to_us, us_to_stamp

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.dds
ORIGIN_US = 1_700_000_000_000_000
PACKET_US = 1000


class Harness:
    """A node process and the client side of everything it offers."""

    def __init__(self, env: dict[str, str], model: str) -> None:
        command = [sys.executable, '-m', 'mixtac_fger.fger_node', '--ros-args']
        command += ['-r', '__ns:=/mixtac', '-p', f'model:={model}']
        self.process = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)
        self.errors: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        rclpy.init()
        self.node = rclpy.create_node('harness', namespace='mixtac')
        self.change = self.node.create_client(ChangeState, 'fger/change_state')
        self.state = self.node.create_client(GetState, 'fger/get_state')
        self.tare = self.node.create_client(Trigger, 'fger/tare')
        assert self.change.wait_for_service(timeout_sec=20), self.errors

    def _read(self) -> None:
        self.errors.extend(self.process.stderr)

    def call(self, client, request, timeout_s: float = 60.0):
        future = client.call_async(request)
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=timeout_s)
        assert future.done(), self.errors
        return future.result()

    def transition(self, transition: int) -> tuple[bool, int]:
        request = ChangeState.Request()
        request.transition.id = transition
        success = self.call(self.change, request).success
        return success, self.call(self.state, GetState.Request()).current_state.id

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.try_shutdown()
        self.process.terminate()
        assert self.process.wait(10) == 0, self.errors
        self._reader.join(5)


@pytest.fixture
def harness(ros_domain, tmp_path, model) -> Iterator[Harness]:
    path = tmp_path / 'toy.safetensors'
    save_model(path, model.network, ModelCard())
    harness = Harness(ros_domain, str(path))
    yield harness
    harness.close()


def packets(trial) -> Iterator[tuple[int, EventPacket]]:
    """Yield (camera time [us] since the start, packet) every millisecond."""
    events = trial.events.shifted(ORIGIN_US)
    for sequence, until in enumerate(range(PACKET_US, int(trial.label.t_us[-1]), PACKET_US)):
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


def play(harness: Harness, trial) -> list[WrenchStamped]:
    """Publish the trial in real time and return the forces that came back."""
    node, received = harness.node, []
    events = node.create_publisher(EventPacket, 'events', QOS_EVENTS)
    images = node.create_publisher(Image, 'image_raw', QOS_SENSOR)
    node.create_subscription(WrenchStamped, 'force', received.append, QOS_FORCE)
    deadline = time.monotonic() + 10
    while not (events.get_subscription_count() and images.get_subscription_count()):
        rclpy.spin_once(node, timeout_sec=0.05)
        assert time.monotonic() < deadline
    started, frame = time.monotonic(), 0
    for until, message in packets(trial):
        while frame < len(trial.frames) and trial.arrival_us[frame] <= until:
            images.publish(image(trial, frame))
            frame += 1
        events.publish(message)
        rclpy.spin_once(node, timeout_sec=0)
        time.sleep(max(0.0, started + until * 1e-6 - time.monotonic()))
    for _ in range(200):
        rclpy.spin_once(node, timeout_sec=0.005)
    return received


def test_forces_come_at_500_hz_on_the_camera_clock(harness, trial):
    refused = harness.call(harness.tare, Trigger.Request())
    assert not refused.success
    assert 'not active' in refused.message
    assert harness.transition(Transition.TRANSITION_CONFIGURE) == (
        True,
        State.PRIMARY_STATE_INACTIVE,
    )
    assert harness.transition(Transition.TRANSITION_ACTIVATE) == (True, State.PRIMARY_STATE_ACTIVE)
    received = play(harness, trial)
    stamps = np.array([stamp_to_us(message.header.stamp) for message in received])
    assert {message.header.frame_id for message in received} == {'mixtac_contact'}
    assert (stamps % 2000 == 0).all()
    # A loaded machine may lose packets of a best-effort topic; windows are never lost.
    assert (np.diff(stamps) == 2000).mean() > 0.95
    assert stamps[-1] - ORIGIN_US > trial.label.t_us[-1] - 20_000
    assert len(stamps) > 400
    refused = harness.call(harness.tare, Trigger.Request())
    assert not refused.success
    assert harness.transition(Transition.TRANSITION_DEACTIVATE) == (
        True,
        State.PRIMARY_STATE_INACTIVE,
    )
    assert harness.transition(Transition.TRANSITION_ACTIVATE) == (True, State.PRIMARY_STATE_ACTIVE)


@pytest.mark.parametrize('kind', ['missing', 'another architecture'])
def test_a_model_that_cannot_be_used_fails_the_configuration(ros_domain, tmp_path, kind):
    import torch
    from safetensors.torch import save_file

    path = tmp_path / 'model.safetensors'
    if kind != 'missing':
        save_file({'w': torch.zeros(1)}, path, metadata={'architecture': 'resnet18'})
    harness = Harness(ros_domain, str(path))
    try:
        assert harness.transition(Transition.TRANSITION_CONFIGURE) == (
            False,
            State.PRIMARY_STATE_UNCONFIGURED,
        )
    finally:
        harness.close()
    said = [line for line in harness.errors if str(path) in line]
    assert len(said) == 1
    assert 'mixtac train' in said[0]
    assert not any('Traceback' in line for line in harness.errors)
