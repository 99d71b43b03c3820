# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fuzzes one node, in this process or over DDS, and prints the figures as one JSON object.

In process, the estimator also estimates a simulated trial before and after: `force_difference_n` is
the largest difference between its forces afterwards and those of one that was not fuzzed [N].
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import TimeReference
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from mixtac_alignment.alignment_node import AlignmentNode
from mixtac_alignment.force_error_node import ForceErrorNode
from mixtac_events.arrays import Events
from mixtac_events.codec import encode
from mixtac_fger.fger_node import FgerNode
from mixtac_lab.bench.fuzz_nodes import NAMESPACE, fuzz_target, mutate, nodes, octets, revive
from mixtac_lab.bench.harness import send
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_learning.trials.trial import TrialArrays
from mixtac_node.graph import yaml_value
from mixtac_node.images import fill, set_octets
from mixtac_node.stamps import stamp_to_us, us_to_stamp
from mixtac_node.topics import message_class
from mixtac_recordings.messages import left_aligned, ros_message
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.virtual_arm_node import VirtualArmNode
from mixtac_sim.world.training_trials import TrialSpec
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.slip_control_node import SlipControlNode

CLASSES = {
    'slip_control': SlipControlNode,
    'alignment': AlignmentNode,
    'force_error': ForceErrorNode,
    'virtual_arm': VirtualArmNode,
}
ORIGIN_US = 1_700_000_000_000_000
PACKET_US = 1000
ANSWER_S = 120.0
"""Longest time to wait for an answer [s]; a first configuration compiles."""
PACE_S = 0.0005
DISCOVERY_S = 2.0
SERIAL = 'FUZZ1'
MUTATED = 0.8
"""Share of the messages that are mutated; the others carry the streams on."""


class Mutations:
    """Makes mutated messages of streams, serialised: times and numbers of each type go on.

    Args:
        rng: Random numbers.
    """

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._sound: dict[Any, bytes] = {}
        self._made: Counter[Any] = Counter()

    def __call__(self, kind: Any) -> bytes:  # noqa: ANN401
        """Return a mutated message of a type."""
        if kind not in self._sound:
            self._sound[kind] = serialize_message(sound_message(kind))
        message = deserialize_message(self._sound[kind], kind)
        self._made[kind] += 1
        _go_on(message, self._made[kind])
        if self._rng.random() < MUTATED:
            mutate(self._rng, message)
        data = bytes(serialize_message(message))
        return data[:4] + octets(self._rng, data[4:]) if self._rng.random() < 0.1 else data


def _go_on(message: Any, number: int) -> None:  # noqa: ANN401
    now_us = ORIGIN_US + PACKET_US * number
    if hasattr(message, 'header'):
        message.header.stamp = us_to_stamp(now_us)
    if hasattr(message, 'time_base'):
        message.seq, message.time_base = number, 1000 * now_us
    if hasattr(message, 'exposure_start'):
        message.exposure_start = us_to_stamp(now_us - 500)
        message.exposure_end = us_to_stamp(now_us + 500)


def sound_message(kind: Any) -> Any:  # noqa: ANN401
    """Return a message as a node expects it, as far as that matters."""
    message, rng = kind(), np.random.default_rng(0)
    joints = list(SerialArm.fr3().names)
    numbers = [0.0] * len(joints)
    joint_values = (('name', joints), ('joint_names', joints), ('position', numbers))
    for name, held in (('width', WIDTH), ('height', HEIGHT), *joint_values):
        # The position of a contact is a point.
        if '/' not in kind.get_fields_and_field_types().get(name, '/'):
            setattr(message, name, held)
    if 'points' in kind.get_fields_and_field_types():
        point = JointTrajectoryPoint(positions=numbers, velocities=numbers, accelerations=numbers)
        message.points = [point, point]
    if kind.__name__ == 'EventPacket':
        return packet(random_events(rng, 200), ORIGIN_US + PACKET_US, 0)
    if kind.__name__ == 'Image':
        return image(rng.integers(0, 1023, (HEIGHT, WIDTH)).astype(np.uint16), ORIGIN_US)
    return message


def random_events(rng: np.random.Generator, count: int) -> Events:
    """Return events of one packet."""
    return Events(
        np.sort(rng.integers(ORIGIN_US, ORIGIN_US + PACKET_US, count)),
        rng.integers(0, WIDTH, count).astype(np.uint16),
        rng.integers(0, HEIGHT, count).astype(np.uint16),
        rng.random(count) < 0.5,
    )


def packet(events: Events, until_us: int, sequence: int) -> Any:  # noqa: ANN401
    """Return the message of some events."""
    encoded = encode(events, complete_until=until_us)
    message = ros_message('event_camera_msgs/msg/EventPacket')
    message.width, message.height, message.seq = WIDTH, HEIGHT, sequence
    message.time_base, message.encoding = encoded.time_base, encoded.encoding
    set_octets(message, 'events', encoded.payload)
    return message


def image(pixels: Any, middle_us: int) -> Any:  # noqa: ANN401
    """Return the message of a frame of 10 bits."""
    message = ros_message('sensor_msgs/msg/Image')
    message.header.stamp = us_to_stamp(middle_us)
    fill(message, left_aligned(pixels), 'mono16')
    return message


class DirectTarget:
    """A node in this process, whose callbacks are called.

    Args:
        node: The node; nobody spins it.

    Attributes:
        errors: Exceptions by kind and place.
        slowest_ms: Largest CPU time of a callback, by topic or service.
    """

    def __init__(self, node: Any) -> None:  # noqa: ANN401
        self._node = node
        self.errors: Counter[str] = Counter()
        self.slowest_ms: dict[str, float] = {}

    def settle(self) -> None:
        """Return: in this process everything is known at once."""

    def topics(self) -> Mapping[str, Any]:
        """Return the message types of what it subscribes to, by topic."""
        return {each.topic_name: each.msg_type for each in self._node.subscriptions}

    def services(self) -> Mapping[str, Any]:
        """Return the types of its services, by name."""
        return {each.service_name: each.srv_type for each in self._node.services}

    def send(self, topic: str, payload: bytes) -> None:
        """Hand a serialised message to the callback, if the middleware would."""
        for each in list(self._node.subscriptions):
            if each.topic_name == topic:
                try:
                    message = deserialize_message(payload, each.msg_type)
                except Exception:  # noqa: BLE001, S112 - never comes as far as a callback
                    continue
                self._timed(topic, each.callback, payload if each.raw else message)

    def ask(self, service: str, request: Any) -> Any:  # noqa: ANN401
        """Call a service and return its answer."""
        for each in list(self._node.services):
            if each.service_name == service:
                return self._timed(service, each.callback, request, each.srv_type.Response())
        return None

    def _timed(self, name: str, callback: Callable[..., Any], *arguments: Any) -> Any:  # noqa: ANN401
        began_s = time.thread_time()
        try:
            return callback(*arguments)
        except Exception as error:  # noqa: BLE001 - what is looked for
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f'{Path(place.filename).name}:{place.lineno}'
            self.errors[f'{name}: {type(error).__name__}: {error} ({where})'[:300]] += 1
        finally:
            taken_ms = 1e3 * (time.thread_time() - began_s)
            self.slowest_ms[name] = max(self.slowest_ms.get(name, 0.0), round(taken_ms, 2))
        return None


class LiveTarget:
    """A node in another process.

    Args:
        node: A node of this process.
        spin: Lets it receive for a moment.
        name: Absolute name of the other node.
    """

    def __init__(self, node: Node, spin: Callable[[], object], name: str) -> None:
        self._node, self._spin = node, spin
        self._space, _, self._name = name.rpartition('/')
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self.unanswered = 0
        ready = f'{name}/list_parameters'
        self._wait(lambda: ready in self.services())
        # It answers once it is complete.
        self.ask(ready, self.services()[ready].Request())
        self.settle()

    def settle(self) -> None:
        """Wait until what it listens to, which is discovered one by one, stays the same."""
        found, end_s = (self.topics(), self.services()), time.monotonic() + DISCOVERY_S
        while time.monotonic() < end_s:
            self._spin()
            latest = self.topics(), self.services()
            if latest != found:
                found, end_s = latest, time.monotonic() + DISCOVERY_S

    def topics(self) -> Mapping[str, Any]:
        """Return the message types of what it subscribes to, by topic."""
        found = self._node.get_subscriber_names_and_types_by_node(self._name, self._space)
        return {name: message_class(kinds[0]) for name, kinds in found}

    def services(self) -> Mapping[str, Any]:
        """Return the types of its services, by name."""
        try:
            found = self._node.get_service_names_and_types_by_node(self._name, self._space)
        except rclpy.node.NodeNameNonExistentError:
            return {}
        return {name: message_class(kinds[0]) for name, kinds in found}

    def send(self, topic: str, payload: bytes) -> None:
        """Publish a serialised message."""
        if topic not in self._publishers:
            kind = self.topics()[topic]
            profile = QoSProfile(
                depth=100,
                reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
            )
            self._publishers[topic] = self._node.create_publisher(kind, topic, profile)
            self._wait(self._publishers[topic].get_subscription_count)
        # The middleware itself refuses bytes that do not fit a type of fixed size.
        with contextlib.suppress(rclpy_implementation.RCLError):
            self._publishers[topic].publish(payload)
        time.sleep(PACE_S)

    def ask(self, service: str, request: Any) -> Any:  # noqa: ANN401
        """Call a service and return its answer; None without one."""
        if service not in self._clients:
            kind = self.services()[service]
            self._clients[service] = self._node.create_client(kind, service)
            self._wait(self._clients[service].service_is_ready)
        future = self._clients[service].call_async(request)
        if not self._wait(future.done):
            self.unanswered += 1
            return None
        return future.result()

    def _wait(self, condition: Callable[[], object]) -> bool:
        end_s = time.monotonic() + ANSWER_S
        while not condition():
            if time.monotonic() > end_s:
                return False
            self._spin()
        return True


class WatchedFger(FgerNode):
    """The estimator, whose forces are kept: (stamp [us], force [N])."""

    def __init__(self) -> None:
        self.forces: list[tuple[int, float]] = []
        super().__init__()

    def publish_topic(self, topic: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a publisher; keep what goes to `force`."""
        publisher = super().publish_topic(topic, **options)
        if topic.name == 'force':
            publisher.publish = self._keep
        return publisher

    def _keep(self, data: bytes) -> None:
        message = deserialize_message(data, WrenchStamped)
        self.forces.append((stamp_to_us(message.header.stamp), message.wrench.force.z))

    def settle(self) -> None:
        """Wait for the frames that are being encoded, so that a run can be repeated."""
        if self._feed is not None:
            self._feed.estimator.drain()


def play(node: WatchedFger, target: DirectTarget, trial: TrialArrays, shift_us: int) -> None:
    """Hand a trial to the estimator, its times shifted [us]."""
    topics = {name.rpartition('/')[2]: name for name in target.topics()}
    middle_us = (trial.exposure_start_us + trial.exposure_end_us) // 2
    clock = TimeReference(source=SERIAL)
    target.send(topics['camera_clock'], serialize_message(clock))
    frame = 0
    for number, until_us in enumerate(range(PACKET_US, int(trial.arrival_us[-1]), PACKET_US)):
        while trial.arrival_us[frame] <= until_us:
            shown = image(np.minimum(trial.frames[frame], 1023), shift_us + int(middle_us[frame]))
            target.send(topics['image_raw'], serialize_message(shown))
            node.settle()
            frame += 1
        events = trial.events.between(until_us - PACKET_US, until_us).shifted(shift_us)
        message = packet(events, shift_us + until_us, number + shift_us // PACKET_US % 10**9)
        target.send(topics['events'], serialize_message(message))


def estimated(
    trial: TrialArrays, between: Callable[[DirectTarget], object]
) -> tuple[Any, DirectTarget]:
    """Return the forces of a trial after something was done between two plays of it."""
    node = WatchedFger()
    target = DirectTarget(node)
    revive(target)
    play(node, target, trial, ORIGIN_US)
    between(target)
    node.forces.clear()
    play(node, target, trial, ORIGIN_US + 100_000_000)
    node.close()
    forces = np.array(node.forces)
    node.destroy_node()
    return forces[forces[:, 0] > ORIGIN_US + 101_000_000], target


def keep_reference(trial: TrialArrays) -> None:
    """Store the no-contact reference of the trial's sensor, as an owner does once."""
    node = WatchedFger()
    target = DirectTarget(node)
    revive(target)
    play(node, target, trial, ORIGIN_US)
    answer = target.ask(f'/{NAMESPACE}/fger/tare', Trigger.Request())
    if not answer.success:
        raise SystemExit(answer.message)
    node.close()
    node.destroy_node()


def fuzz_in_process(name: str, rng: Random, messages: int) -> dict[str, Any]:
    """Fuzz a node of `DIRECT`, and return the figures."""
    sent: dict[str, int] = {}

    def attack(target: DirectTarget) -> None:
        sent.update(fuzz_target(target, rng, Mutations(rng), messages, max(20, messages // 100)))
        for topic, kind in target.topics().items():
            if topic.endswith('/camera_info'):
                # The camera goes on telling the truth.
                target.send(topic, serialize_message(sound_message(kind)))
                revive(target)

    figures: dict[str, Any] = {}
    if name != 'fger':
        node = CLASSES[name]()
        target = DirectTarget(node)
        attack(target)
    else:
        trial = SimulatedSource(TrialSpec(3, 4, 'press', 3.0)).load()
        keep_reference(trial)
        # The attack configures it anew, which ends what the sensor has shown of itself.
        before, _ = estimated(trial, revive)
        after, target = estimated(trial, attack)
        same = before.shape == after.shape and (before[:, 0] == after[:, 0]).all()
        figures['forces'] = len(after)
        difference = np.abs(before - after)[:, 1].max() if same else None
        figures['force_difference_n'] = difference
    errors = [f'{count} x {text}' for text, count in target.errors.most_common()]
    return {**figures, 'sent': sent, 'errors': errors, 'ended': '', 'slowest_ms': target.slowest_ms}


def fuzz_over_dds(name: str, rng: Random, messages: int) -> dict[str, Any]:
    """Fuzz a node in another process, and return the figures."""
    node = rclpy.create_node('fuzz')
    target = LiveTarget(
        node, lambda: rclpy.spin_once(node, timeout_sec=0.05), f'/{NAMESPACE}/{name}'
    )
    sent = fuzz_target(target, rng, Mutations(rng), messages, max(20, messages // 10))
    return {'sent': sent, 'unanswered': target.unanswered}


def main() -> None:
    """Fuzz."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('node')
    parser.add_argument('--messages', type=int, required=True)
    parser.add_argument('--seed', type=int, required=True)
    parser.add_argument('--folder', type=Path, required=True)
    parser.add_argument('--live', action='store_true')
    options = parser.parse_args()
    os.environ['MIXTAC_HOME'] = str(options.folder)
    rng = Random(options.seed)  # noqa: S311 - not for secrets
    arguments = ['-r', f'__ns:=/{NAMESPACE}', '--log-level', 'fatal']
    if not options.live:
        for parameter, held in nodes(options.folder)[options.node].overrides.items():
            arguments += ['-p', f'{parameter}:={yaml_value(held)}']
    rclpy.init(args=['--ros-args', *arguments])
    kind = fuzz_over_dds if options.live else fuzz_in_process
    figures = kind(options.node, rng, options.messages)
    send(**figures)
    sys.stdout.flush()
    os._exit(0)


if __name__ == '__main__':
    main()
