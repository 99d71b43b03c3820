# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The slip control node as a process of its own, over real topics, with the FR3's planner."""

from __future__ import annotations

import json
import math
import os
import threading
import time
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_events.codec import encode

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')
pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')

from .slip_windows import parameters

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.dds
EPOCH_US = 1_700_000_000_000_000
READY = [0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4]
NAMES = [f'fr3_joint{k}' for k in range(1, 8)]
TOPIC = '/fr3_arm_controller/joint_trajectory'


# An arm backend of another package: it writes down what it is sent, and fails where it is told to.
BACKEND = """
import json, time
from pathlib import Path
import numpy as np
from mixtac_slip_control.arm.trajectory import ArmState
from mixtac_slip_control.errors import BackendError

HERE = Path(__file__).parent

class Arm:
    def __init__(self, parameters, arm):
        self.log = (HERE / 'log').open('a', buffering=1)

    def state(self):
        if (HERE / 'broken').exists():
            raise BackendError('the arm is broken')
        q = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
        if (HERE / 'unknown').exists():
            q += np.random.default_rng().normal(0.0, 1e-4, 7)
            return ArmState(time.time(), q, np.zeros(7))
        return ArmState(time.time(), q, np.zeros(7), q + 1e-3)

    def send(self, trajectory):
        print(json.dumps(trajectory.q[[0, -1]].tolist()), file=self.log)

    def stop(self):
        print('stopped', file=self.log)
"""


VALUES = {
    'arm': 'fr3',
    'controller_state_topic': 'none',
    'detector': 'count',
    'learning_time': 0.2,
    'settling_time': 0.05,
    'max_events_age': 1.0,
    'max_force_age': 1.0,
    'max_joint_age': 1.0,
    'max_heartbeat_age': 5.0,
    'max_following_error': 0.005,
}
"""A short learning time, and ages for a loaded machine; the arm of these tests never moves."""


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a package with a backend, which nodes find."""
    (tmp_path / 'recorded_arm.py').write_text(BACKEND)
    info = tmp_path / 'recorded_arm-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: recorded-arm\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text('[mixtac.arm_backends]\nrecorded = recorded_arm:Arm\n')
    path = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    monkeypatch.setenv('PYTHONPATH', path)
    return tmp_path


class Peer:
    """Plays driver, estimator, arm and supervisor; collects what the node says."""

    def __init__(self, graph: Any) -> None:
        from event_camera_msgs.msg import EventPacket
        from geometry_msgs.msg import WrenchStamped
        from sensor_msgs.msg import Image, JointState
        from std_msgs.msg import Empty
        from trajectory_msgs.msg import JointTrajectory

        from mixtac_msgs.msg import SlipState
        from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, QOS_SENSOR

        self.graph, self.executor = graph, graph.executor
        self.states: dict[int, Any] = {}
        self.heard: list[Any] = []
        self._types = (EventPacket, WrenchStamped, JointState, Empty)
        make = graph.node.create_publisher
        self._events = make(EventPacket, '/mixtac/events', QOS_EVENTS)
        self._force = make(WrenchStamped, '/mixtac/force', QOS_FORCE)
        self._image_type = Image
        self._images = make(Image, '/mixtac/image_raw', QOS_SENSOR)
        self._joints = make(JointState, '/joint_states', 10)
        self._heartbeat = make(Empty, '/mixtac/slip_control/heartbeat', 10)
        graph.node.create_subscription(SlipState, '/mixtac/slip', self._on_slip, QOS_FORCE)
        self.trajectories = graph.listen(JointTrajectory, TOPIC, 10)
        self._packets = self._sent = 0
        self._started_s = math.inf
        self.force, self.pull = 0.5, 0.0

    def start(self, *parameters: str, trajectories: bool = True) -> None:
        """Start the node and wait until both sides know each other."""
        values = [f'{name}:={value}' for name, value in VALUES.items()]
        self.graph.start('mixtac_slip_control.slip_control_node', *values, *parameters)
        inputs = [self._events, self._force, self._heartbeat, self._images]
        inputs += [self._joints] * trajectories
        outputs = ['/mixtac/slip'] + [TOPIC] * trajectories
        self.graph.spin_until(lambda: all(each.get_subscription_count() for each in inputs))
        self.graph.spin_until(lambda: all(map(self.graph.node.count_publishers, outputs)))
        time.sleep(0.5)  # the other side may not have matched yet

    def enable(self, wanted: bool) -> Any:
        from std_srvs.srv import SetBool

        request = SetBool.Request(data=wanted)
        return self.graph.call(SetBool, '/mixtac/slip_control/enable', request)

    def trigger(self, name: str) -> Any:
        from std_srvs.srv import Trigger

        return self.graph.call(Trigger, f'/mixtac/slip_control/{name}')

    def send(self, counts: list[int], *, inputs: bool = True) -> list[Any]:
        """Send one packet per count and millisecond; return the states of their windows."""
        # The clock of the camera goes on while nothing is sent.
        self._started_s = min(self._started_s, time.monotonic())
        first = max(self._sent, round(1e3 * (time.monotonic() - self._started_s)))
        self._sent = first
        for count in counts:
            if inputs and self._sent % 2 == 0:
                self._send_inputs()
            self._send_packet(count)
            self.executor.spin_once(timeout_sec=0.002)
        wanted = [EPOCH_US + (k + 1) * 1000 for k in range(first, self._sent)]
        deadline = time.monotonic() + 30.0
        while wanted[-1] not in self.states and time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.05)
        return [self.states[end] for end in wanted if end in self.states]

    def rest(self, seconds: float) -> None:
        """Send a still contact until so much host time is over."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.send(quiet(20))

    def go_on(self) -> None:
        """Send a window of a still contact, even if nobody receives it."""
        self._send_inputs()
        self._send_packet(30)
        self.executor.spin_once(timeout_sec=0.002)

    def send_frame(self) -> None:
        """Send a frame that is brighter to the right."""
        ramp = np.tile(np.linspace(200, 60_000, 346).astype('<u2'), (260, 1))
        message = self._image_type(height=260, width=346, encoding='mono16', step=692)
        now_us = EPOCH_US + self._sent * 1000
        message.header.stamp.sec, rest = divmod(now_us, 1_000_000)
        message.header.stamp.nanosec = rest * 1000
        message.data.frombytes(ramp.tobytes())
        self._images.publish(message)

    def _send_packet(self, count: int) -> None:
        start = EPOCH_US + self._sent * 1000
        t = start + np.arange(count, dtype=np.int64) * 1000 // max(count, 1)
        place = np.full(count, 130, np.uint16)  # at the contact
        polarity = np.ones(count, np.bool_)
        packet = encode(Events(t, place, place, polarity), complete_until=start + 1000)
        message = self._types[0](
            width=346,
            height=260,
            seq=self._packets,
            time_base=packet.time_base,
            encoding=packet.encoding,
        )
        message.events.frombytes(packet.payload)
        self._events.publish(message)
        self._sent += 1
        self._packets += 1

    def _send_inputs(self) -> None:
        _, wrench, joints, empty = self._types
        force = wrench()
        now_us = EPOCH_US + self._sent * 1000
        force.header.stamp.sec, rest = divmod(now_us, 1_000_000)
        force.header.stamp.nanosec = rest * 1000
        force.wrench.force.x, force.wrench.force.z = self.pull, self.force
        self._force.publish(force)
        # The arm's order of joints is its own affair.
        self._joints.publish(joints(name=NAMES[::-1], position=READY[::-1]))
        self._heartbeat.publish(empty())

    def _on_slip(self, message: Any) -> None:
        self.heard.append(message)
        stamp = message.header.stamp
        self.states[stamp.sec * 1_000_000 + stamp.nanosec // 1000] = message


def quiet(number: int) -> list[int]:
    return [30 + k % 5 for k in range(number)]


def test_slip_moves_the_arm_when_enabled_and_a_fault_stops_it(node_under_test: Any) -> None:
    peer = Peer(node_under_test)
    peer.start()
    assert not peer.enable(wanted=True).success
    states = peer.send(quiet(400))
    assert len(states) > 300
    assert states[-1].background == pytest.approx(32.0, abs=2.0)
    assert not any(s.slipping or s.enabled for s in states)

    assert not any(s.flow for s in states)

    def flows() -> bool:
        return any(s.flow > 0.0 for s in peer.send(quiet(20)))

    peer.graph.spin_until(flows, peer.send_frame)

    disabled = peer.send([30, 600, *quiet(250)])
    assert any(s.slipping and s.count_slipping and s.count == 600 for s in disabled)
    assert all(s.advance == 0.0 for s in disabled)
    assert peer.trajectories == []

    answer = peer.enable(wanted=True)
    assert answer.success, answer.message
    peer.graph.spin_until(lambda: len(peer.trajectories) == 1)
    assert np.allclose(peer.trajectories[0].points[-1].positions, READY)
    peer.rest(0.3)  # the settling time runs on the host clock
    slips = peer.send([30, 600, 600, *quiet(40)])
    assert all(s.enabled and s.state == s.ENABLED for s in slips), slips[-1].reason
    assert slips[-1].total_advance > 0.0
    peer.graph.spin_until(lambda: len(peer.trajectories) > 1)
    check_trajectory(peer.trajectories[-1])
    assert not peer.trigger('tare').success
    assert not peer.trigger('reset').success
    assert slips[-1].header.frame_id == 'mixtac_contact'

    peer.force = 3.0
    peer.send(quiet(10))
    stopped = peer.send([600] * 3)
    assert stopped[-1].state == stopped[-1].STOPPED
    assert stopped[-1].advance == 0.0
    assert not peer.enable(wanted=True).success
    assert not peer.trigger('reset').success
    peer.force = 0.5
    peer.rest(0.3)  # the filtered force comes back after some samples
    assert peer.trigger('reset').success
    assert peer.enable(wanted=True).success
    assert peer.enable(wanted=False).success
    assert peer.trigger('tare').success


def test_a_backend_of_another_package_drives_the_arm_and_its_fault_stops(
    node_under_test: Any, arm: Path
) -> None:
    peer = Peer(node_under_test)
    peer.start('arm_backend:=recorded', trajectories=False)
    peer.send(quiet(400))
    answer = peer.enable(wanted=True)
    assert answer.success, answer.message

    def sent() -> list[Any]:
        return [json.loads(line) for line in (arm / 'log').read_text().splitlines()]

    # It reports commanded positions: no trajectory leads to the measured ones.
    assert sent() == []
    states = peer.send([30, 600, 600, *quiet(40)])
    assert states[-1].total_advance > 0.0
    assert np.allclose(sent()[0][0], np.array(READY) + 1e-3, atol=1e-6)
    (arm / 'broken').touch()
    peer.graph.spin_until(lambda: peer.send(quiet(20))[-1].state == states[-1].STOPPED)
    assert 'broken' in peer.enable(wanted=True).message
    assert peer.trajectories == []

    # No more events: the state goes on to be told, with why.
    peer.heard.clear()
    peer.graph.spin_until(lambda: len(peer.heard) > 2)
    assert {m.state for m in peer.heard} == {states[-1].STOPPED}
    assert all('broken' in m.reason for m in peer.heard)


def test_the_plan_begins_where_the_controller_was_led(node_under_test: Any, arm: Path) -> None:
    (arm / 'unknown').touch()  # what it commands; what it measures has noise
    peer = Peer(node_under_test)
    peer.start('arm_backend:=recorded', trajectories=False)
    peer.send(quiet(400))
    answer = peer.enable(wanted=True)
    assert answer.success, answer.message
    peer.rest(0.3)
    peer.send([30, 600, 600, *quiet(40)])
    led, planned = [json.loads(line) for line in (arm / 'log').read_text().splitlines()][:2]
    assert np.allclose(planned[0], led[-1], rtol=0.0, atol=1e-9)


def check_trajectory(message: Any) -> None:
    """Hold a trajectory against what joint_trajectory_controller asks for."""
    assert list(message.joint_names) == NAMES
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
    assert len(times) > 2
    assert all(later > earlier for earlier, later in pairwise(times))
    last = message.points[-1]
    assert np.allclose(last.velocities, 0.0, atol=1e-9)
    assert np.allclose(last.accelerations, 0.0, atol=1e-6)
    moved = np.array([p.positions for p in message.points]) - READY
    assert 0.0 < np.abs(moved).max() < 0.02
    age = time.time() - (message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
    assert 0.0 <= age < 60.0


def asked_of_gripper(peer: Peer, graph: Any, law: str) -> list[Any]:
    """Start slip control with a gripper and a valid force that pulls; return what it asks for."""
    from std_msgs.msg import Float64MultiArray

    from mixtac_msgs.msg import ForceQuality
    from mixtac_node.base_node import QOS_FORCE

    quality = graph.node.create_publisher(ForceQuality, '/mixtac/force_quality', QOS_FORCE)
    asked: list[Any] = graph.listen(Float64MultiArray, '/mixtac/grip', 10)
    peer.pull = 0.3
    peer.start(f'gripper:={law}', 'gripper_rate:=100.0')
    graph.spin_until(quality.get_subscription_count)
    quality.publish(ForceQuality(valid=True, sideways_known=True, deviation=0.05))
    return asked


def test_a_gripper_is_told_the_force_of_the_margin(node_under_test: Any) -> None:
    peer, graph = Peer(node_under_test), node_under_test
    asked = asked_of_gripper(peer, graph, 'force')
    graph.spin_until(lambda: peer.send(quiet(20)) and asked)
    states = peer.send(quiet(600))
    # It never falls while the object is held: a margin that becomes better known loosens nothing.
    assert asked[-1].data[0] >= states[-1].wanted_force > peer.force
    assert asked[-1].data[0] <= 1.0


def test_a_gripper_closes_no_further_when_slip_control_ends(node_under_test: Any) -> None:
    peer, graph = Peer(node_under_test), node_under_test
    asked = asked_of_gripper(peer, graph, 'speed')
    graph.spin_until(lambda: peer.send(quiet(20)) and asked and asked[-1].data[0] > 0.0)
    ending = threading.Thread(target=graph.stop)
    ending.start()
    while ending.is_alive():
        peer.go_on()
    for _ in range(50):
        peer.executor.spin_once(timeout_sec=0.01)
    assert asked[-1].data[0] == 0.0


def test_the_status_says_what_is_missing() -> None:
    from mixtac_node.diagnostics import ERROR, WARN
    from mixtac_slip_control.controller import SlipController
    from mixtac_slip_control.slip_control_node import FeedCounts, node_status

    controller, counts = SlipController(parameters()), FeedCounts()
    level, message, values = node_status(controller, counts, None, 1.0)
    assert level == WARN
    assert message
    assert values['force age [s]'] == 'never'
    counts.problem = 'image of another size'
    assert 'another size' in node_status(controller, counts, None, 1.0)[1]
    controller.interlock.enable(None)
    controller.interlock.stop('force is nan')
    assert node_status(controller, counts, None, 1.0)[:2] == (ERROR, 'stopped: force is nan')
