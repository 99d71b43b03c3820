# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""An object held between the virtual sensor and a wall, as a node.

The camera outputs all data about 20 ms after they were simulated, because a frame must be known
before its readout begins. The response of the arm therefore reaches the object 20 ms later than on
a real bench. `mixtac experiments slip` does not have this delay. If the host cannot keep up,
simulated time runs slower than the clock of the host; with `publish_clock`, nodes that use `/clock`
slow down as well.
"""

from __future__ import annotations

from functools import partial
from threading import Event, Thread

import numpy as np
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from mixtac_core.events.packets import header_stamp_ns
from mixtac_core.node import topics
from mixtac_core.node.base_node import QOS_SENSOR, BaseNode, answering, declare, run
from mixtac_core.node.diagnostics import ERROR, OK, DiagnosticsPublisher, Status
from mixtac_core.node.topics import ns_to_stamp, stamp_to_us
from mixtac_sim.arm import JOINT_NAMES, SIDEWAYS, flange_place
from mixtac_sim.grasp.live import AnswerPace, LiveGrasp, PacedClock
from mixtac_sim.grasp.objects import draw_setup
from mixtac_sim.grids import stream
from mixtac_sim.live.virtual_sensor import make_virtual_sensor
from mixtac_sim.parameters import VirtualGraspParameters
from mixtac_sim.usb.server import UsbServer, check_free
from mixtac_sim.usb.wire import default_socket_path
from mixtac_sim.virtual_sensor_node import publish_wrenches
from mixtac_sim.world.effects import preset
from mixtac_sim.world.instruments import WrenchSamples

PUBLISH_PERIOD_S = 2e-3
CLOCK_PERIOD_NS = 2_000_000
"""Simulated time between two messages on `/clock` [ns], on a slow host too."""
SLIP_AHEAD_US = 4_000
"""Simulated time is so far beyond the last answer of slip control at most [us]: less than the lead
of its trajectories, which therefore never reach the arm too late."""
ARM_AHEAD_US = 10_000
"""The same for the arm [us], whose joint states come every 4 ms, and for a force estimator."""


class VirtualGraspNode(BaseNode, Node):  # type: ignore[misc]
    """Runs sensor and grasp, follows the virtual arm, and strikes the object on request.

    The fingertip reaches what the arm reports about 20 ms later. Only then is it published as joint
    states: events, force and joint states of one stamp belong together.

    Services: ``~/knock`` strikes the object, ``~/put_back`` starts the grasp again. Topics:
    ``truth/wrench`` and ``truth/object`` (its position, y upwards in m). The fingertip touches
    nothing until the first ``~/put_back``.
    """

    def __init__(self) -> None:
        super().__init__('virtual_grasp')
        self._settings = declare(self, VirtualGraspParameters, self._change)
        settings = self._settings
        path = settings.socket or default_socket_path()
        check_free(path)
        self._start_m: np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None = None
        self._stop = Event()
        self._knocks = 0
        self._slip_pace, self._arm_pace = AnswerPace(SLIP_AHEAD_US), AnswerPace(ARM_AHEAD_US)
        self._force_pace = AnswerPace(ARM_AHEAD_US)
        paces = (self._slip_pace, self._arm_pace, self._force_pace)
        self._time = PacedClock(paces if settings.publish_clock else ())
        level = preset(settings.preset)
        self._grasp = LiveGrasp(
            draw_setup(
                settings.object, stream(settings.seed, 'virtual grasp'), margin=settings.margin
            ),
            *(settings.device_seed, settings.seed, level, self._time),
            open_first=True,
        )
        self._sensor = make_virtual_sensor(
            device_seed=settings.device_seed,
            seed=settings.seed,
            skew_ppm=settings.skew_ppm,
            preset=level,
            simulation=self._grasp,
            clock=self._time,
        )
        self._wire(settings)
        self._sensor.start()
        # The first step compiles: a driver that came before would see time stand still.
        self._server = UsbServer(self._sensor.device, path)
        self._diagnostics = DiagnosticsPublisher(self, self._sensor.device.serial, self._status)
        self._thread = Thread(target=self._publish_all, name='publish', daemon=True)
        self._thread.start()

    def _wire(self, settings: VirtualGraspParameters) -> None:
        self._truth = self.publish_topic(topics.TRUTH_WRENCH)
        self._wrenches = topics.WrenchWriter(topics.CONTACT_FRAME)
        self._place = self.publish_topic(topics.TRUTH_OBJECT)
        self._clock_topic = None
        if settings.publish_clock:
            self._clock_topic = self.create_publisher(Clock, '/clock', 1)
            # Serialised: only the stamp matters, a thousand times a second.
            self.subscribe_topic(topics.SLIP, partial(self._on_answer, self._slip_pace), raw=True)
            answer = partial(self._on_answer, self._force_pace)
            self.subscribe_topic(topics.FORCE_QUALITY, answer, raw=True)
        self.create_subscription(JointState, settings.arm_topic, self._on_joints, QOS_SENSOR)
        self._joints = self.create_publisher(JointState, settings.joint_state_topic, 10)
        self.create_service(Trigger, '~/knock', answering(self._on_knock))
        self.create_service(Trigger, '~/put_back', answering(self._on_put_back))

    def close(self) -> None:
        """End threads, remove the socket."""
        self._stop.set()
        self._thread.join(5.0)
        self._sensor.close()
        self._server.close()

    def _change(self, settings: VirtualGraspParameters) -> None:
        self._settings = settings

    def _on_answer(self, pace: AnswerPace, message: bytes) -> None:
        # The camera's clock drifts away from simulated time.
        now_us = self._time.now_us()
        late_us = self._sensor.device.stamp_us(now_us) - header_stamp_ns(message) // 1000
        pace.answer(now_us - late_us, now_us)

    def _on_joints(self, message: JointState) -> None:
        if tuple(message.name) != JOINT_NAMES:
            return
        self._arm_pace.answer(stamp_to_us(message.header.stamp), self._time.now_us())
        posture = tuple(message.position)
        place = flange_place(np.array(posture))
        if self._start_m is None:
            self._start_m = place
        self._grasp.move(1e3 * float((place - self._start_m) @ SIDEWAYS), posture)

    def _on_knock(self, _request: Trigger.Request) -> str:
        self._grasp.strike(self._settings.knock)
        self._knocks += 1
        return f'{self._settings.knock:g} mm/s'

    def _on_put_back(self, _request: Trigger.Request) -> str:
        # The wall moves with the fingertip: the object is held as at the start.
        self._start_m = None
        self._grasp.put_back()
        return ''

    def _publish_all(self) -> None:
        due_ns = 0
        while not self._stop.wait(PUBLISH_PERIOD_S):
            now_ns = self._sensor.time_ns()
            if self._clock_topic is not None and now_ns >= due_ns:
                self._clock_topic.publish(Clock(clock=ns_to_stamp(now_ns)))
                due_ns = now_ns + CLOCK_PERIOD_NS
            start_ns = self._time.start_epoch_ns
            for t_us, posture in self._grasp.take_reached((now_ns - start_ns) // 1000):
                joints = JointState(name=JOINT_NAMES, position=posture)
                joints.header.stamp = ns_to_stamp(start_ns + 1000 * t_us)
                self._joints.publish(joints)
            self._sensor.take_reference()
            for batch in self._sensor.take_truth():
                self._publish_truth(batch)

    def _publish_truth(self, batch: WrenchSamples) -> None:
        publish_wrenches(self._truth, batch, self._wrenches)
        if len(batch.t_ns):
            place = PointStamped()
            place.header.stamp = ns_to_stamp(int(batch.t_ns[-1]))
            place.header.frame_id = topics.CONTACT_FRAME
            place.point.y = -1e-3 * self._grasp.object_mm
            self._place.publish(place)

    def _status(self) -> Status:
        state = self._sensor.state()
        if not state.running:
            return Status(ERROR, 'SIMULATED grasp, stopped by an internal error: see the log', {})
        return Status(
            OK,
            f'SIMULATED grasp of a {self._settings.object}',
            {
                'simulated': True,
                'grasp_force': self._grasp.grasp_n,
                'object_mm': self._grasp.object_mm,
                'knocks': self._knocks,
                'lost_s': 1e-6 * self._time.lost_us,
                'socket': self._server.path,
            },
        )


main = partial(run, VirtualGraspNode)
