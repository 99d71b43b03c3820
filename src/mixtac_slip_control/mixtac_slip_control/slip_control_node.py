# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Detect slip in events, publish `slip`, and stream trajectories that advance the arm.

Everything happens in the callback of the event packet: no timer lies between an event and the
resulting trajectory. The node starts disabled. It is not a safety-rated function.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Empty, Float64MultiArray, Header
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from mixtac_core.events.codec import decode_message, warm_up
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.frames import PICTURE_KERNELS
from mixtac_core.events.packets import CodecError, SequenceCounter, read_packet
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_SENSOR, BaseNode, answering, declare, run
from mixtac_core.node.diagnostics import ERROR, OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.images import grey
from mixtac_core.node.topics import stamp_to_ns, stamp_to_us, us_to_stamp
from mixtac_msgs.msg import Contact, ForceQuality, SlipState
from mixtac_slip_control.arm.following import MAX_SAG_RAD
from mixtac_slip_control.arm.model import (
    CONTINUES,
    SAFE_SETTINGS,
    TRAJECTORY,
    ArmBackend,
    ArmParts,
    TrajectoryBackend,
    make_arm,
    open_backend,
    unsafe_setting,
)
from mixtac_slip_control.arm.trajectory import (
    PlannedTrajectory,
    serialised,
    settling_trajectory,
)
from mixtac_slip_control.controller import SlipController, SlipStep
from mixtac_slip_control.detectors import LEARNING_S
from mixtac_slip_control.errors import BackendError, SlipControlError
from mixtac_slip_control.gripper import GripperGoal
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import MAX_AGE_S, InterlockState

STEP_FIELDS = tuple(f.name for f in dataclasses.fields(SlipStep) if f.name != 'end_us')
REASONS = {
    getattr(ForceQuality, name): name.lower().replace('_', ' ')
    for name in dir(type(ForceQuality))
    if name.isupper()
}
"""Why a force is not valid, by the number in the message."""
WATCH_PERIOD_S = 5e-3
"""Period of the watchdogs while nothing arrives [s]."""
STATE_PERIOD_S = 0.1
"""Period of `slip` while no window arrives [s]."""
SETTINGS_PERIOD_S = 1.0
"""Period at which the parameters of the arm's controller are read [s]."""
SETTINGS = (*CONTINUES, *SAFE_SETTINGS)
"""Parameters of the arm's controller that are read."""
FRAME_ID = 'mixtac_contact'
"""Frame of `slip`: z points from the contact into the gel."""


class SlipControlNode(BaseNode, Node):  # type: ignore[misc]
    """Connects the slip controller with topics, services and the arm."""

    def __init__(self) -> None:
        super().__init__('slip_control')
        p = self._settings = declare(self, SlipControlParameters, self._apply)
        self._diagnostics = DiagnosticsPublisher(self, 'slip_control', self._status)
        with self._diagnostics.compiling('the packet codec'):
            warm_up()
        arm = self._arm = make_arm(p)
        self._controller = (
            SlipController(p)
            if arm is None
            else SlipController(p, arm.planner, arm.normal, arm.checks.check)
        )
        self._packets = SequenceCounter()
        self._refused = self._windows = self._trajectories = 0
        self._problem = 'check that the driver runs'
        self._moving = False
        self._settings_client: Any = None
        self._settings_read = False
        with self._diagnostics.compiling(PICTURE_KERNELS):
            self._controller.features.warm_up()
        self._backend = None if arm is None else self._open_backend(arm)
        self._arm_stamp_s: float | None = None
        self._slip = self.publish_topic(topics.SLIP)
        self._gripper = GripperGoal()
        self._grip = None if p.gripper == 'none' else self.publish_topic(topics.GRIP)
        self._message = SlipState()
        self._message.header.frame_id = FRAME_ID
        self.create_service(SetBool, '~/enable', answering(self._on_enable))
        self.create_service(Trigger, '~/reset', answering(self._on_reset))
        self.create_service(Trigger, '~/tare', answering(self._on_tare))
        self.subscribe_topic(topics.EVENTS, self._on_events, raw=True)
        self.subscribe_topic(topics.IMAGE_RAW, self._on_image)
        self.subscribe_topic(topics.FORCE, self._on_force)
        if p.contact_place is None:
            self.subscribe_topic(topics.CONTACT, self._on_contact)
        self.subscribe_topic(topics.FORCE_QUALITY, self._on_quality)
        self.create_subscription(Empty, p.heartbeat_topic, self._on_heartbeat, QOS_SENSOR)
        self.create_timer(WATCH_PERIOD_S, self._watch)
        self._reported = 0
        self.create_timer(STATE_PERIOD_S, self._report)

    def _open_backend(self, arm: ArmParts) -> ArmBackend:
        p = self._settings
        if p.arm_backend != TRAJECTORY:
            return open_backend(p, arm.arm)
        publisher = self.create_publisher(JointTrajectory, f'{p.controller}/joint_trajectory', 10)
        backend = TrajectoryBackend(arm.arm.names, lambda t: publisher.publish(serialised(t)))

        def on_joints(joints: JointState) -> None:
            stamp_s = self._stamp_s(joints.header)
            if backend.on_joint_state(joints.name, joints.position, stamp_s):
                self._read_arm()
                self._brake()

        self.create_subscription(JointState, p.joint_state_topic, on_joints, QOS_SENSOR)
        self._listen_to_controller(backend)
        self._settings_client = self.create_client(GetParameters, f'{p.controller}/get_parameters')
        self.create_timer(SETTINGS_PERIOD_S, self._read_settings)
        return backend

    def _listen_to_controller(self, backend: TrajectoryBackend) -> None:
        """Read the commanded positions, where the messages are installed."""
        topic = f'{self._settings.controller}/controller_state'
        try:
            messages = importlib.import_module('control_msgs.msg')
        except ImportError:
            self.get_logger().warning(
                f'control_msgs is not installed: {topic} cannot be read. Install it'
            )
            return

        def on_state(state: Any) -> None:  # noqa: ANN401
            reference = getattr(state, 'reference', None) or state.desired
            q = backend.ordered(state.joint_names, reference.positions)
            if q is not None:
                stamp_s = self._stamp_s(state.header)
                self._controller.on_commanded(q.tolist(), stamp_s, self._now_s())
                self._brake()

        kind = messages.JointTrajectoryControllerState
        self.create_subscription(kind, topic, on_state, QOS_SENSOR)

    def _read_settings(self) -> None:
        """Ask the arm's controller for its parameters, and whether it reports its state."""
        following, client = self._controller.following, self._settings_client
        topic = f'{self._settings.controller}/controller_state'
        if following is not None and self.count_publishers(topic):
            following.needs_commands = True
        if client is None or self._controller.enabled or not client.service_is_ready():
            return

        def on_answer(future: Any) -> None:  # noqa: ANN401
            values = [parameter_value_to_python(value) for value in future.result().values]
            self._controller.unsafe = unsafe_setting(dict(zip(SETTINGS, values, strict=False)))
            self._settings_read = True

        client.call_async(GetParameters.Request(names=list(SETTINGS))).add_done_callback(on_answer)

    def _stamp_s(self, header: Header) -> float:
        """Return the time of a message [s]; now if it has none."""
        return 1e-9 * stamp_to_ns(header.stamp) or self._now_s()

    def close(self) -> None:
        """Stop a closing gripper, bring the arm to rest, and release it."""
        self._ask_gripper(None)
        if self._backend is not None:
            self._backend.stop()

    def _apply(self, parameters: SlipControlParameters) -> None:
        self._controller.configure(parameters)
        self._settings = parameters

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _on_events(self, data: bytes) -> None:
        try:
            message = read_packet(data)
            packet = decode_message(message)
        except CodecError as error:
            self._refuse(str(error))
            return
        now_s = self._now_s()
        self._packets.update(message.seq)
        self._controller.features.resize(message.width, message.height)
        steps = self._controller.on_events(
            packet.events, packet.complete_until, now_s, lost=not self._packets.continuous
        )
        # The arm first: after a stall many windows are published at once.
        self._send(self._controller.plan(now_s))
        for step in steps:
            self._publish(step)
        self._moving = self._moving or self._controller.enabled
        self._brake()

    def _refuse(self, problem: str) -> None:
        self._refused += 1
        self._problem = problem
        self.get_logger().warning(problem, throttle_duration_sec=5.0)

    def _on_image(self, message: Image) -> None:
        try:
            stamp_us = stamp_to_us(message.header.stamp)
            self._controller.on_frame(grey(message), stamp_us, self._now_s())
        except MixtacError as error:
            self._refuse(str(error))

    def _on_force(self, message: topics.ForceMessage) -> None:
        stamp_us = stamp_to_us(message.header.stamp)
        self._controller.on_force(topics.normal_force(message), stamp_us, self._now_s())
        self._brake()

    def _on_contact(self, message: Contact) -> None:
        if message.located:
            self._controller.features.contact_at(message.column, message.row)

    def _on_quality(self, message: ForceQuality) -> None:
        # The quality of a force has its stamp and arrives with it: at most one window too late.
        untrusted = '' if message.valid else REASONS.get(message.reason, 'unknown reason')
        self._controller.on_quality(untrusted, self._now_s())
        self._brake()

    def _on_heartbeat(self, _message: Empty) -> None:
        self._controller.on_heartbeat(self._now_s())

    def _watch(self) -> None:
        self._read_arm()
        now_s = self._now_s()
        self._controller.tick(now_s)
        # Without events nothing is planned; a target that waited for its turn still goes out.
        self._send(self._controller.plan(now_s))
        self._brake()

    def _read_arm(self) -> None:
        """Pass a new state of the arm to the controller; a fault of the arm stops slip control."""
        if self._backend is None:
            return
        try:
            state = self._backend.state()
        except BackendError as error:
            self._controller.interlock.stop(str(error))
            return
        if state is not None and state.stamp_s != self._arm_stamp_s:
            self._arm_stamp_s = state.stamp_s
            now_s = self._now_s()
            if state.commanded is not None:
                self._controller.on_commanded(state.commanded.tolist(), state.stamp_s, now_s)
            self._controller.on_joint_state(state.q.tolist(), now_s, state.stamp_s)

    def _send(self, trajectory: PlannedTrajectory | None) -> None:
        if trajectory is None or self._backend is None:
            return
        try:
            self._backend.send(trajectory)
        except BackendError as error:
            self._controller.interlock.stop(str(error))
            return
        self._trajectories += 1

    def _brake(self) -> None:
        """End the motion once when slip control has stopped or was disabled."""
        if not self._moving or self._controller.enabled:
            return
        self._moving = False
        self._send(self._controller.braking(self._now_s()))
        reason = self._controller.interlock.reason
        if reason:
            self.get_logger().error(f'stopped: {reason}')
        self._publish_state()

    def _report(self) -> None:
        if self._reported == self._windows:
            self._publish_state()
            self._ask_gripper(None)
        self._reported = self._windows

    def _publish_state(self) -> None:
        """Publish the state of now, with the figures of the latest window."""
        controller, message = self._controller, self._message
        message.slipping = message.count_slipping = message.flow_slipping = False
        message.state, message.enabled = int(controller.interlock.state), controller.enabled
        message.advance, message.total_advance = 0.0, controller.law.total
        message.reason = controller.reason(self._now_s())
        self._slip.publish(message)

    def _publish(self, step: SlipStep) -> None:
        # One message for all: a thousand new ones a second would cost more than the detectors.
        message = self._message
        message.header.stamp = us_to_stamp(step.end_us)
        for name in STEP_FIELDS:
            setattr(message, name, getattr(step, name))
        self._slip.publish(message)
        self._ask_gripper(step)
        self._windows += 1

    def _ask_gripper(self, step: SlipStep | None) -> None:
        """Publish a command for a gripper; without a window, a closing speed of zero."""
        if self._grip is None:
            return
        watch = self._controller.watch
        if step is None:
            goal = 0.0 if self._settings.gripper == 'speed' else None
        else:
            trusted = watch.trusts_force(self._now_s())
            given = step.end_us, watch.force, self._settings
            goal = self._gripper.update(*given, slipping=step.slipping, trusted=trusted)
        if goal is not None:
            self._grip.publish(Float64MultiArray(data=[goal]))

    def _on_enable(self, request: SetBool.Request) -> str:
        if not request.data:
            self._controller.disable()
            self._brake()
            return 'slip control disabled'
        if self._settings_client is not None and not self._settings_read:
            self._read_settings()
            if self._settings_client.service_is_ready():
                raise SlipControlError(
                    'slip control stays disabled: the controller has not sent its parameters yet',
                    remedy='try again in a moment',
                )
        now_s = self._now_s()
        state = self._backend.state() if self._backend is not None else None
        commanded = None if state is None else state.commanded
        if commanded is None and self._controller.following is not None:
            commanded = self._controller.following.commanded(now_s)
        if state is None or commanded is not None:
            self._controller.enable(now_s, commanded=commanded)
        elif not self._controller.enabled and self._arm is not None:
            p, arm = self._settings, self._arm
            # The controller may see the trajectory later, by as much as the lead allows.
            settling_s = p.lead + arm.settling_s(MAX_SAG_RAD, p.limit_share)
            self._controller.enable(now_s, settling_s=settling_s)
            self._send(settling_trajectory(arm.arm, arm.planner.start, now_s, settling_s))
        self._moving = True
        return 'slip control enabled'

    def _on_reset(self, _request: Trigger.Request) -> str:
        stopped = self._controller.interlock.state is InterlockState.STOPPED
        self._controller.reset(self._now_s())
        what = 'stop reset' if stopped else 'nothing to reset'
        return f'{what}; slip control is disabled'

    def _on_tare(self, _request: Trigger.Request) -> str:
        self._controller.tare()
        self._gripper.start()
        return f'learning the background: keep the contact still for {LEARNING_S:g} s'

    def _status(self) -> Status:
        controller, now_s = self._controller, self._now_s()
        law = controller.law
        values: dict[str, object] = {
            'state': controller.interlock.state.name.lower(),
            'lost packets': self._packets.lost,
            'unreadable messages': self._refused,
            'trajectories': self._trajectories,
            'phase': law.step.phase.name.lower(),
            'total advance [m]': law.total,
            'advance limit [m]': law.limit,
            'stiffness [N/m]': law.contact.stiffness,
            'contrast [1/px]': controller.features.contrast,
        }
        for name in MAX_AGE_S:
            age = controller.watch.age(name, now_s)
            values[f'{name} age [s]'] = age if math.isfinite(age) else 'never'
        return Status(*self._summary(now_s), values)

    def _summary(self, now_s: float) -> tuple[int, str]:
        """Return level and one line of the diagnostics."""
        controller = self._controller
        if controller.interlock.state is InterlockState.STOPPED:
            return ERROR, f'stopped: {controller.interlock.reason}'
        if not self._windows:
            return WARN, f'no events yet: {self._problem}'
        if not controller.detectors.count.learned:
            return WARN, 'learning the background: keep the contact still'
        if controller.enabled:
            return OK, 'enabled'
        reason = controller.reason(now_s)
        return OK, f'watching; cannot be enabled: {reason}' if reason else 'watching; ready'


main = partial(run, SlipControlNode)
