# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Detection, law, interlock and planner of the arm as one object without ROS.

The node and the simulations drive the same object: inputs arrive by the `on_` methods, `plan`
returns what is to be sent to the arm, `tick` checks the watchdogs when nothing arrives. All `now_s`
are on one host clock, the one that trajectories are stamped with; event and force times are on the
camera clock.

Every trajectory ends at rest, so an arm that receives nothing more stops by itself; `braking` stops
it sooner.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_slip_control.arm.following import FollowingWatch
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.detectors import Detectors
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipFeatures, SlipWindow
from mixtac_slip_control.grip import LATEST_US, GripMargin
from mixtac_slip_control.law import Advance
from mixtac_slip_control.parameters import ADJUSTABLE_WHILE_ENABLED, SlipControlParameters
from mixtac_slip_control.safety import JOINTS, Interlock, InterlockState, SafetyWatch

Normal = Sequence[float] | Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class SlipStep:
    """Result of one window; the fields are those of `mixtac_msgs/SlipState`.

    Attributes:
        end_us: End of the window, camera clock [us].
        count: Events in the window.
        background: Median of the counts at rest.
        background_sigma: Scale of the tail of the counts at rest.
        threshold: Count above which the paper's law detects slip.
        count_slipping: Decision of the paper's law.
        flow: Translation of the skin [px per contrast threshold]; 0 where the events do not agree.
        flow_threshold: Translation above which the flow detector detects slip.
        flow_slipping: Decision of the flow detector.
        slipping: Decision of the chosen detector.
        state: Number of the `InterlockState`.
        enabled: Whether the arm may follow slip.
        advance: Wanted because of this window, along the contact normal [m].
        total_advance: Wanted since enabling [m].
        reason: Why it stopped, else why it cannot be enabled now; empty if it can or is.
        slip_direction: Of the motion of the skin while it slips, from x to y of the contact frame
            [rad]; 0 otherwise.
        slip_rotation: Rotation of the skin about the contact normal within the window, from x to y
            of the contact frame [rad per contrast threshold]; 0 where the events agree on none.
        friction: Friction coefficient as the sensor measures it.
        friction_deviation: Its standard deviation.
        margin: Normal force over the smallest that holds; 0 where it is not known.
        margin_deviation: Its standard deviation.
        wanted_force: Normal force that the grasp needs for `grip_margin` [N]; 0 where it is not
            known.
    """

    end_us: int
    count: int
    background: float
    background_sigma: float
    threshold: float
    count_slipping: bool
    flow: float
    flow_threshold: float
    flow_slipping: bool
    slipping: bool
    state: int
    enabled: bool
    advance: float
    total_advance: float
    reason: str
    slip_direction: float
    slip_rotation: float
    friction: float
    friction_deviation: float
    margin: float
    margin_deviation: float
    wanted_force: float


CALM_US: Final = 200_000
"""Time after a slip in which the sensor's force is not learned from [us]: five frames."""


class SlipController:
    """Watches for slip and, when enabled, advances the arm against it.

    Args:
        parameters: Settings of all parts.
        planner: Plans the arm's motion; None only reports.
        normal: Contact normal (3,) in the arm's base frame, along which the arm advances, or a
            function that returns it for the joint positions at enabling.
        check_state: Returns what is wrong with joint positions [rad], None if nothing is.

    Attributes:
        interlock: Whether the arm may follow.
        watch: Ages and limits.
        following: Whether the arm is where the plan leads it; None without an arm.
        detectors: Both slip detectors.
        features: Cuts the event stream into windows.
        grip: Friction and margin of the grasp.
    """

    def __init__(
        self,
        parameters: SlipControlParameters,
        planner: AdvancePlanner | None = None,
        normal: Normal = (0.0, 0.0, 1.0),
        check_state: Callable[[Sequence[float]], str | None] = lambda _q: None,
    ) -> None:
        self._parameters = parameters
        self.interlock = Interlock()
        self.watch = SafetyWatch(parameters, check_state)
        self.detectors = Detectors(parameters)
        self.features = SlipFeatures(parameters)
        self.grip = GripMargin(parameters)
        self._calm_us = self._end_us = -1
        self._planner = planner
        self._advance = None if planner is None else Advance(parameters, planner, self.grip)
        self.following = None if planner is None else FollowingWatch(parameters, planner)
        self._normal_source = normal
        self._normal = np.zeros(3)
        self._settling = (0.0, 0.0)
        self._latest_s = -math.inf

    @property
    def enabled(self) -> bool:
        """Whether slip moves the arm."""
        return self.interlock.enabled

    @property
    def has_arm(self) -> bool:
        """Whether there is anything to move."""
        return self._planner is not None

    @property
    def total_advance(self) -> float:
        """Wanted advance since enabling [m]."""
        return self._advance.total if self._advance else 0.0

    @property
    def advance_limit(self) -> float:
        """Largest advance at present [m]."""
        return self._advance.limit if self._advance else 0.0

    @property
    def refused_plans(self) -> int:
        """Plans that would have broken a limit of the arm, and were not sent."""
        return self._planner.refused if self._planner else 0

    @property
    def stiffness(self) -> float:
        """Estimated stiffness of the contact [N/m]; 0 without an arm."""
        return self._advance.bound.stiffness.stiffness if self._advance else 0.0

    @property
    def probing(self) -> bool:
        """Whether the stiffness of the contact is being measured by a small press."""
        return self.enabled and self._advance is not None and self._advance.bound.probe.active

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters, except the window and where the contact is.

        Raises:
            SlipControlError: Slip control is enabled, and a parameter other than those of
                `ADJUSTABLE_WHILE_ENABLED` changes.
        """
        old = self._parameters
        changed = {
            f.name for f in fields(old) if getattr(parameters, f.name) != getattr(old, f.name)
        }
        fixed = sorted(changed - ADJUSTABLE_WHILE_ENABLED)
        if self.enabled and fixed:
            raise SlipControlError(
                f'parameter {fixed[0]} is fixed while slip control is enabled',
                remedy='disable it before the change',
            )
        self._parameters = parameters
        self.detectors.configure(parameters)
        self.watch.configure(parameters)
        self.grip.configure(parameters)
        if self._advance is not None and self.following is not None:
            self._advance.configure(parameters)
            self.following.configure(parameters)

    def on_force(
        self,
        force_n: float,
        stamp_us: int,
        now_s: float,
        *,
        deviation: float = 0.0,
        pull_n: float | None = None,
    ) -> None:
        """Take what the sensor measures.

        Args:
            force_n: Normal force [N].
            stamp_us: Its time, camera clock [us].
            now_s: Host time [s].
            deviation: Standard deviation of the force [N]; 0 of one that is only noisy.
            pull_n: Sideways force [N]; None where it is not known.
        """
        # What cannot be trusted teaches nothing.
        new = self.watch.on_force(force_n, stamp_us, now_s, deviation)
        if new and self.watch.trusts_force(now_s):
            calm = self._calm(stamp_us)
            if pull_n is not None and math.isfinite(pull_n):
                self.grip.on_force(force_n, pull_n, stamp_us, still=calm and not self.probing)
            if self._advance is not None:
                given = force_n, stamp_us, now_s, deviation
                self.watch.upper = self._advance.on_force(*given, calm=calm)
        self.tick(now_s)

    def on_quality(self, untrusted: str, now_s: float) -> None:
        """Take why the latest force cannot be trusted; empty if it can."""
        self.watch.on_quality(untrusted)
        self.tick(now_s)

    def on_frame(
        self, image: NDArray[np.uint8] | NDArray[np.uint16], stamp_us: int, now_s: float
    ) -> None:
        """Take a frame.

        Args:
            image: Intensity [height, width], any number of bits.
            stamp_us: Centre of its exposure, camera clock [us].
            now_s: Host time [s].

        Raises:
            SlipControlError: Too small, or of another size than the events.
        """
        self.features.frame(image, stamp_us)
        self.watch.on_frame(stamp_us, self.features.contrast, now_s)

    def on_joint_state(
        self, positions: Sequence[float], now_s: float, stamp_s: float | None = None
    ) -> None:
        """Take the joint positions [rad] of the arm, in the planner's order.

        Args:
            positions: One for each joint.
            now_s: Host time [s].
            stamp_s: When they were measured, on the same clock [s]; None: now.
        """
        measured_s = now_s if stamp_s is None else stamp_s
        self.watch.on_joint_state(positions, measured_s)
        if self.enabled and self.following is not None and self.watch.joints is not None:
            self.following.on_measured(np.array(self.watch.joints), measured_s)
        self.tick(now_s)

    def on_commanded(self, positions: Sequence[float], stamp_s: float, now_s: float) -> None:
        """Take the joint positions [rad] that the arm's controller commands at a time [s]."""
        q = np.asarray(positions, np.float64)
        if self.following is not None and np.isfinite(q).all():
            self.following.on_commanded(q, stamp_s, now_s)
            self.tick(now_s)

    def on_heartbeat(self, now_s: float) -> None:
        """Take a heartbeat of the supervisor."""
        self.watch.on_heartbeat(now_s)

    def on_events(
        self, events: Events, complete_until: int, now_s: float, *, lost: bool = False
    ) -> list[SlipStep]:
        """Take the next packet and return the results of the windows that it closes.

        Args:
            events: Camera clock [us].
            complete_until: Camera clock [us]: no event before this time will follow.
            now_s: Host time [s].
            lost: Whether packets before this one are missing.
        """
        if lost:
            self.features.lost_before(int(events.t[0]) if len(events) else complete_until)
        windows = self.features.push(events, complete_until)
        steps = [self._step(window, now_s) for window in windows]
        if steps:
            self.tick(now_s)
        return steps

    def plan(self, now_s: float) -> PlannedTrajectory | None:
        """Return what is to be sent to the arm now, or None."""
        if self._planner is None or not self._may_move(now_s):
            return None
        try:
            return self._planner.plan(now_s, self.total_advance, self._normal)
        except SlipControlError as error:
            self.interlock.stop(str(error))
            return None

    def fault(self, now_s: float) -> str | None:
        """Return why the arm may not follow slip now, or None."""
        fault = self.watch.fault(now_s)
        if fault is None and self.enabled and self.following is not None:
            fault = self.following.fault(now_s)
        return fault

    def reason(self, now_s: float) -> str:
        """Return why it stopped, else why it cannot be enabled now; empty if it can or is."""
        if self.interlock.state is InterlockState.STOPPED:
            return self.interlock.reason
        if self.enabled:
            return ''
        return (self._reason_not_to_enable(now_s) or '') if self.has_arm else 'no arm'

    def tick(self, now_s: float) -> str | None:
        """Stop if there is a fault or the clock went back; return why, enabled or not."""
        fault = self.fault(now_s)
        if now_s < self._latest_s:
            fault = f'the clock of the host went back by {1e3 * (self._latest_s - now_s):.1f} ms'
        self._latest_s = now_s
        if fault is not None:
            self.interlock.stop(fault)
        return fault

    def braking(self, now_s: float) -> PlannedTrajectory | None:
        """Return the trajectory that ends a motion early, or None where nothing moves.

        To be asked for once after a stop or a disabling. Where it cannot be planned, the last
        trajectory brings the arm to rest. An arm that is not where the plan leads it is left alone:
        a trajectory from there would begin with a step.
        """
        if self._planner is None or (self.following is not None and self.following.lost):
            return None
        try:
            return self._planner.stop(now_s)
        except SlipControlError:
            return None

    def enable(
        self,
        now_s: float,
        *,
        commanded: NDArray[np.float64] | None = None,
        settling_s: float = 0.0,
    ) -> None:
        """Let slip move the arm, from where it is and from an advance of zero.

        Args:
            now_s: Host time [s].
            commanded: Joint positions (n,) [rad] that the arm's controller commands; None where it
                is led to the measured ones.
            settling_s: How long that takes [s]; slip is answered afterwards.

        Raises:
            SlipControlError: No arm, nothing learned, slip at present, an arm that still moves, a
                watchdog, a limit, or a stop that was not reset.
        """
        if self._planner is None or self._advance is None or self.following is None:
            raise SlipControlError(
                'slip control has no arm', remedy='start it with the parameter arm'
            )
        if self.enabled:
            return
        self.interlock.enable(self._reason_not_to_enable(now_s))
        measured = self.watch.joints
        assert measured is not None  # noqa: S101  (a fault before the first ones)
        joints = np.array(measured) if commanded is None else commanded
        source = self._normal_source
        try:
            self._normal = np.asarray(source(joints) if callable(source) else source, np.float64)
            self._planner.reset(joints, self._normal, self._parameters.max_total)
            self._advance.start()
            self.following.start(now_s + settling_s, np.array(measured), commanded)
        except BaseException:
            self.interlock.disable()
            raise
        self._settling = (now_s, now_s + settling_s)
        self.watch.on_enabling(now_s)

    def disable(self) -> None:
        """Let nothing move; the sum stays on record until the next enabling."""
        self.interlock.disable()

    def reset(self, now_s: float) -> None:
        """Leave a stop; the arm stays disabled.

        Raises:
            SlipControlError: Slip control is enabled, or the cause of the stop is still there.
        """
        if self.enabled:
            raise SlipControlError(
                'slip control is enabled and not stopped: nothing to reset',
                remedy='call ~/enable with data false to disable it',
            )
        fault = self.fault(now_s)
        if self.interlock.state is InterlockState.STOPPED and fault is not None:
            raise SlipControlError(f'slip control stays stopped: {fault}')
        self.interlock.reset()

    def tare(self) -> None:
        """Learn the background again, from the next windows.

        Raises:
            SlipControlError: Slip control is enabled.
        """
        if self.enabled:
            raise SlipControlError('slip control is enabled', remedy='disable it before taring')
        self.detectors.reset()
        self.grip.start()
        self._calm_us = -1

    def _reason_not_to_enable(self, now_s: float) -> str | None:
        if not self.detectors.learned:
            return (
                'the background is not learned yet: keep the contact still for '
                f'{self._parameters.learning_windows} windows, with events and frames arriving'
            )
        if self.detectors.slipping or not self._calm(self._end_us):
            return 'the object slips, or has just done so: wait until it is still, or tare'
        start, end = self._settling
        # A trajectory from the measured positions would cut a motion that has not ended.
        if start <= now_s < end or (self._planner is not None and self._planner.moving(now_s)):
            return 'the arm still comes to rest from the last motion: try again in a moment'
        fault = self.watch.fault(now_s)
        if fault is None and self.following is not None:
            measured_s = now_s - self.watch.age(JOINTS, now_s)
            fault = self.following.reason_not_to_enable(measured_s, now_s)
        return fault

    def _calm(self, time_us: int) -> bool:
        """Return whether there was no slip for a while before a time, camera clock [us]."""
        return not 0 <= self._calm_us - time_us <= LATEST_US

    def _may_move(self, now_s: float) -> bool:
        ready = self.following is not None and self.following.ready
        return ready and self.enabled and now_s >= self._settling[1] and self.tick(now_s) is None

    def _step(self, window: SlipWindow, now_s: float) -> SlipStep:
        self.watch.on_window(window, now_s)
        detectors, count = self.detectors, self.detectors.count
        motion = wanted = 0.0
        if self._advance is not None:
            self._advance.on_window(window.end_us, now_s)
            motion = self._advance.commanded_motion(now_s)
        before, self._end_us = detectors.slipping, window.end_us
        slipping = detectors.update(window, motion)
        if slipping:
            self._calm_us = window.end_us + CALM_US
            if not before and not self.probing:
                self.grip.on_slip(window.end_us)
        full = window.count >= self._parameters.saturation_count
        if self._advance is not None and not full and self._may_move(now_s):
            wanted = self._advance.update(window.count, detectors, self.watch.upper, now_s)
        return SlipStep(
            end_us=window.end_us,
            count=window.count,
            background=count.background.median,
            background_sigma=count.background.scale,
            threshold=count.threshold,
            count_slipping=count.slipping,
            flow=detectors.flow.flow,
            flow_threshold=detectors.flow.threshold,
            flow_slipping=detectors.flow.slipping,
            slipping=slipping,
            state=int(self.interlock.state),
            enabled=self.enabled,
            advance=wanted,
            total_advance=self.total_advance,
            reason=self.reason(now_s),
            slip_direction=math.atan2(-window.flow_y, window.flow_x) if slipping else 0.0,
            slip_rotation=-window.rotation,
            **self.grip.figures(),
        )
