# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Watches events for slip, publishes `slip`, and streams trajectories that advance the arm.

Everything happens in the callback of the event packet: no timer lies between an event and the
trajectory that answers it. The node starts disabled. This is not a safety-rated function.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import TYPE_CHECKING, Any

from event_camera_msgs.msg import EventPacket
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mixtac_events.codec import decode_message, warm_up
from mixtac_events.errors import MixtacError
from mixtac_events.packets import CodecError
from mixtac_msgs.msg import SlipState
from mixtac_node.base_node import QOS_EVENTS, QOS_FORCE, QOS_SENSOR, BaseNode, declare, run
from mixtac_node.diagnostics import DiagnosticsPublisher, Status
from mixtac_node.images import grey
from mixtac_node.stamps import stamp_to_us, us_to_stamp
from mixtac_slip_control.arm.model import JointOrder, make_arm
from mixtac_slip_control.arm.trajectory import TrajectoryMessage
from mixtac_slip_control.controller import FeedCounts, SlipController, SlipStep, node_status
from mixtac_slip_control.features import GuideMaker
from mixtac_slip_control.parameters import SlipControlParameters, slip_settings

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_slip_control.arm.trajectory import PlannedTrajectory
    from mixtac_slip_control.parameters import SlipSettings


STEP_FIELDS = tuple(f.name for f in dataclasses.fields(SlipStep) if f.name != 'end_us')
WATCH_PERIOD_S = 5e-3
"""How often the watchdogs look where nothing arrives [s]."""


class SlipControlNode(BaseNode, Node):  # type: ignore[misc]
    """Wires the slip controller to topics and services."""

    def __init__(self) -> None:
        super().__init__('slip_control')
        self._settings = declare(self, SlipControlParameters, self._apply)
        settings = _settings(self._settings)
        arm = self._arm = make_arm(self._settings)
        self._trajectory = TrajectoryMessage(JointTrajectory, JointTrajectoryPoint)
        self._joints = JointOrder(arm.arm.names if arm else ())
        self._controller = (
            SlipController(settings)
            if arm is None
            else SlipController(settings, arm.planner, arm.normal, arm.check)
        )
        self._guides = GuideMaker(settings.guide)
        self._sequence: int | None = None
        self._latest: SlipStep | None = None
        self._counts = FeedCounts()
        self._moving = False
        warm_up()
        self._wire()
        self._diagnostics = DiagnosticsPublisher(self, 'slip_control', self._status)

    def _wire(self) -> None:
        parameters = self._settings
        self._slip = self.create_publisher(SlipState, 'slip', QOS_FORCE)
        self._message = SlipState()
        topic = parameters.trajectory_topic
        self._trajectories = self.create_publisher(JointTrajectory, topic, 10)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(Trigger, '~/tare', self._on_tare)
        self.create_subscription(EventPacket, 'events', self._on_events, QOS_EVENTS)
        self.create_subscription(Image, 'image_raw', self._on_image, QOS_SENSOR)
        self.create_subscription(WrenchStamped, 'force', self._on_force, QOS_FORCE)
        self.create_subscription(
            JointState, parameters.joint_state_topic, self._on_joints, QOS_SENSOR
        )
        self.create_subscription(Empty, parameters.heartbeat_topic, self._on_heartbeat, QOS_SENSOR)
        self.create_timer(WATCH_PERIOD_S, self._watch)

    def _apply(self, parameters: SlipControlParameters) -> None:
        self._controller.configure(_settings(parameters))
        self._settings = parameters

    def _now_s(self) -> float:
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _on_events(self, message: EventPacket) -> None:
        try:
            packet = decode_message(message)
        except CodecError as error:
            self._refuse(str(error))
            return
        now_s = self._now_s()
        lost = self._missing(message.seq)
        steps = self._controller.on_events(packet.events, packet.complete_until, now_s, lost=lost)
        self._send(self._controller.plan(now_s))
        self._moving = self._moving or self._controller.enabled
        for step in steps:
            self._publish(step)
        self._brake()

    def _missing(self, sequence: int) -> bool:
        missing = 0 if self._sequence is None else sequence - self._sequence - 1
        self._sequence = sequence
        self._counts.packets += 1
        self._counts.lost += max(missing, 0)
        return missing != 0

    def _refuse(self, problem: str) -> None:
        self._counts.refused += 1
        self._counts.problem = problem
        self.get_logger().warning(problem, throttle_duration_sec=5.0)

    def _on_image(self, message: Image) -> None:
        try:
            self._controller.guide(
                self._guides.make(grey(message), stamp_to_us(message.header.stamp))
            )
        except MixtacError as error:
            self._refuse(str(error))

    def _on_force(self, message: WrenchStamped) -> None:
        stamp_us = stamp_to_us(message.header.stamp)
        self._controller.on_force(message.wrench.force.z, stamp_us, self._now_s())
        self._brake()

    def _on_joints(self, message: JointState) -> None:
        positions = self._joints.pick(message.name, message.position)
        if positions:
            self._controller.on_joint_state(positions, self._now_s())
            self._brake()

    def _on_heartbeat(self, _message: Empty) -> None:
        self._controller.on_heartbeat(self._now_s())

    def _watch(self) -> None:
        now_s = self._now_s()
        self._controller.tick(now_s)
        # Without events nothing is planned; a target that waited for its turn still goes out.
        self._send(self._controller.plan(now_s))
        self._brake()

    def _send(self, trajectory: PlannedTrajectory | None) -> None:
        if trajectory is None:
            return
        self._trajectories.publish(self._trajectory.fill(trajectory))
        self._counts.trajectories += 1

    def _brake(self) -> None:
        """End the motion once when slip control has stopped or was disabled."""
        if not self._moving or self._controller.enabled:
            return
        self._moving = False
        self._send(self._controller.braking(self._now_s()))
        reason = self._controller.interlock.reason
        if reason:
            self.get_logger().error(f'stopped: {reason}')

    def _publish(self, step: SlipStep) -> None:
        # One message for all: a thousand new ones a second would cost more than the detectors.
        message = self._message
        message.header.stamp = us_to_stamp(step.end_us)
        for name in STEP_FIELDS:
            setattr(message, name, getattr(step, name))
        self._slip.publish(message)
        self._latest = step
        self._counts.windows += 1

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if not request.data:
            return self._answer(response, self._disable, 'slip control disabled')
        return self._answer(response, self._enable, 'slip control enabled')

    def _enable(self) -> None:
        now_s = self._now_s()
        self._controller.enable(now_s)
        self._moving = True
        joints = self._controller.watch.joints
        if self._arm is not None and joints is not None:
            self._send(self._arm.settling(joints, now_s, self._settings.settling_time))

    def _disable(self) -> None:
        self._controller.disable()
        self._brake()

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def reset() -> None:
            self._controller.reset(self._now_s())

        return self._answer(response, reset, 'stop reset; slip control is disabled')

    def _on_tare(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        seconds = self._settings.learning_time
        text = f'learning the background: keep the contact still for {seconds:g} s'
        return self._answer(response, self._controller.tare, text)

    @staticmethod
    def _answer(response: Any, action: Callable[[], None], text: str) -> Any:  # noqa: ANN401
        try:
            action()
        except MixtacError as error:
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, text
        return response

    def _status(self) -> Status:
        now_s = self._now_s()
        return Status(*node_status(self._controller, self._counts, self._latest, now_s))


def _settings(parameters: SlipControlParameters) -> SlipSettings:
    """Return the settings for an arm whose controller may be off its measured positions."""
    return dataclasses.replace(slip_settings(parameters), settling_s=parameters.settling_time)


def main(args: list[str] | None = None) -> int:
    """Run the slip control node."""
    return run(SlipControlNode, args)


if __name__ == '__main__':
    sys.exit(main())
