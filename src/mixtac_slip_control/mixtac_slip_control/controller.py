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
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_slip_control.arm.following import ARM_LAG_S, FollowingWatch
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.detectors import LEARNING_WINDOWS, Detectors
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipFeatures, SlipWindow
from mixtac_slip_control.law import AdvanceLaw
from mixtac_slip_control.parameters import WINDOW_S, SlipControlParameters
from mixtac_slip_control.safety import (
    JOINTS,
    SATURATION_COUNT,
    Interlock,
    InterlockState,
    SafetyWatch,
)

Normal = Sequence[float] | Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class SlipStep:
    """Result of one window; the fields are those of `mixtac_msgs/SlipState`.

    Attributes:
        end_us: End of the window, camera clock [us].
        count: Events in the window.
        background: Median of the counts at rest.
        background_sigma: Scale of the tail of the counts at rest.
        threshold: Count above which the count detector of the paper detects slip.
        count_slipping: Decision of the count detector.
        flow: Translation of the skin [px per contrast threshold]; 0 where the events do not agree.
        flow_threshold: Translation above which the flow detector detects slip.
        flow_slipping: Decision of the flow detector.
        slipping: Decision of the detector that the law uses.
        state: Number of the `InterlockState`.
        enabled: Whether the arm may follow slip.
        advance: Change of the wanted advance by this window, along the contact normal [m].
        total_advance: Wanted advance since enabling [m].
        reason: Why slip control stopped, else why it cannot be enabled now; else empty.
        slip_direction: Direction of the motion of the skin during slip, from x to y of the contact
            frame [rad]; 0 otherwise.
        wanted_force: Normal force that the law `step` presses for or keeps [N]; 0 while disabled.
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
    wanted_force: float


CALM_US: Final = 200_000
"""Time after a slip in which the sensor's force is not learned from [us]: five frames."""
LATEST_US: Final = 1_000_000
"""A slip that lies farther ahead than this belongs to a clock that has started anew [us]."""
FORCE_DELAY_S: Final = 4e-3
"""By which a force may be older than its stamp says [s], on the clock of the joint states."""
SLIP_FORCE_DELAY_S: Final = 0.04
"""The same during a slip [s]: while the object slides, events show little of a press, and the force
follows with the next frame."""
NEVER: Final = -(10**9)
"""Time of no slip, camera clock [us]."""


class SlipController:
    """Detects slip and, when enabled, advances the arm against it.

    Args:
        parameters: Settings of all parts.
        planner: Plans the motion of the arm; with None, slip is only reported.
        normal: Contact normal (3,) in the arm's base frame, along which the arm advances, or a
            function that returns it for the joint positions at enabling.
        check_state: Returns the fault of joint positions [rad], or None.

    Attributes:
        interlock: Whether the arm may respond to slip.
        watch: Ages and limits.
        unsafe: Why the arm's controller is not safe to stream to; empty if nothing is wrong.
        following: Check that the arm follows the plan; None without an arm.
        detectors: Both slip detectors.
        features: Cuts the event stream into windows.
        law: Owner of the wanted advance.
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
        self.watch = SafetyWatch(self._current, check_state)
        self.detectors = Detectors(self._current)
        self.features = SlipFeatures(parameters)
        self.law = AdvanceLaw(self._current)
        self._calm_us = self._end_us = NEVER
        self._planner = planner
        self.following = None if planner is None else FollowingWatch(parameters, planner)
        self.unsafe = ''
        self._window: tuple[int, float] | None = None
        self._normal_source = normal
        self._settling = (0.0, 0.0)
        self._latest_s = -math.inf

    @property
    def enabled(self) -> bool:
        """Whether the arm responds to slip."""
        return self.interlock.enabled

    def configure(self, parameters: SlipControlParameters) -> None:
        """Change the parameters.

        Raises:
            SlipControlError: Slip control is enabled.
        """
        if self.enabled:
            raise SlipControlError(
                'parameters are fixed while slip control is enabled', remedy='disable it first'
            )
        self._parameters = parameters

    def on_force(self, force_n: float, stamp_us: int, now_s: float) -> None:
        """Use a measured force.

        Args:
            force_n: Normal force [N].
            stamp_us: Its time, camera clock [us].
            now_s: Host time [s].
        """
        new = self.watch.on_force(force_n, stamp_us, now_s)
        if new and self.following is not None and self.watch.trusts_force(now_s):
            end_us, arrived_s = self._window or (stamp_us, now_s)
            age = now_s - arrived_s + 1e-6 * (end_us - stamp_us)
            calm = self._calm(stamp_us)
            delay_s = FORCE_DELAY_S if calm else SLIP_FORCE_DELAY_S
            place, spread = self.following.advance_at(now_s - age, delay_s)
            self.law.on_force(force_n, place, spread, calm=calm, enabled=self.enabled)
        self.tick(now_s)

    def on_quality(self, untrusted: str, now_s: float) -> None:
        """Record why the latest force cannot be trusted; empty if it can be."""
        self.watch.on_quality(untrusted)
        self.tick(now_s)

    def on_frame(
        self, image: NDArray[np.uint8] | NDArray[np.uint16], stamp_us: int, now_s: float
    ) -> None:
        """Use a frame for measuring motion from now on.

        Args:
            image: Intensity [height, width], any number of bits.
            stamp_us: Centre of its exposure, camera clock [us].
            now_s: Host time [s].

        Raises:
            SlipControlError: The frame is too small, or of another size than the events.
        """
        self.features.frame(image, stamp_us)
        self.watch.on_frame(stamp_us, self.features.contrast, now_s)

    def on_joint_state(
        self, positions: Sequence[float], now_s: float, stamp_s: float | None = None
    ) -> None:
        """Check the measured joint positions [rad] of the arm, in the planner's order.

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
        """Check the joint positions [rad] that the arm's controller commands at a time [s]."""
        q = np.asarray(positions, np.float64)
        if self.following is not None and np.isfinite(q).all():
            self.following.needs_commands = True
            self.following.on_commanded(q, stamp_s)
            self.tick(now_s)

    def on_heartbeat(self, now_s: float) -> None:
        """Record a heartbeat of the supervisor."""
        self.watch.on_heartbeat(now_s)

    def on_events(
        self, events: Events, complete_until: int, now_s: float, *, lost: bool = False
    ) -> list[SlipStep]:
        """Process the next packet and return the results of the windows that it closes.

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
            return self._planner.plan(now_s, self.law.total)
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
        """Return why slip control stopped, else why it cannot be enabled now; else empty."""
        if self.interlock.state is InterlockState.STOPPED:
            return self.interlock.reason
        if self.enabled:
            return ''
        return 'no arm' if self._planner is None else self._reason_not_to_enable(now_s) or ''

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
        """Return the trajectory that ends a motion early, or None if nothing moves.

        Call this once after a stop or after disabling. If no such trajectory can be planned, the
        last one brings the arm to rest. An arm that does not follow the plan receives no
        trajectory, because it would begin with a step.
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
        """Enable the response of the arm to slip, from its present position and an advance of zero.

        Args:
            now_s: Host time [s].
            commanded: Joint positions (n,) [rad] that the arm's controller commands; None if the
                arm is to settle at the measured positions.
            settling_s: Time for settling [s]; the arm responds to slip only afterwards.

        Raises:
            SlipControlError: There is no arm, the thresholds are not learned yet, the object slips,
                the arm still moves, a watchdog or a limit has a fault, or a stop was not reset.
        """
        if self._planner is None or self.following is None:
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
            normal = np.asarray(source(joints) if callable(source) else source, np.float64)
            at_rest = self._planner.advance_at(now_s)
            self._planner.reset(joints, normal, self._parameters.max_total)
            self.law.start(at_rest)
            self.following.start(now_s + settling_s, np.array(measured), commanded)
        except BaseException:
            self.interlock.disable()
            raise
        self._settling = (now_s, now_s + settling_s)

    def disable(self) -> None:
        """Disable the response to slip; the wanted advance is kept until the next enabling."""
        self.interlock.disable()

    def reset(self, now_s: float) -> None:
        """Clear a stop; slip control stays disabled.

        Raises:
            SlipControlError: Slip control is enabled, or the cause of the stop is still present.
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
        self._calm_us = NEVER

    def _reason_not_to_enable(self, now_s: float) -> str | None:
        if not self.detectors.count.learned:
            return (
                'the background is not learned yet: keep the contact still for '
                f'{LEARNING_WINDOWS} windows, with events and frames arriving'
            )
        if self.detectors.slipping or not self._calm(self._end_us):
            return 'the object slips, or has just done so: wait until it is still, or tare'
        if self.unsafe:
            return self.unsafe
        start, end = self._settling
        # A trajectory from the measured positions would cut a motion that has not ended.
        if start <= now_s < end or (self._planner is not None and self._planner.moving(now_s)):
            return 'the arm still comes to rest from the last motion: try again in a moment'
        fault = self.watch.fault(now_s)
        if fault is None and self.following is not None:
            measured_s = now_s - self.watch.age(JOINTS, now_s)
            fault = self.following.reason_not_to_enable(measured_s, now_s)
        return fault

    def _current(self) -> SlipControlParameters:
        return self._parameters

    def _calm(self, time_us: int) -> bool:
        """Return whether there was no slip for a while before a time, camera clock [us]."""
        return not 0 <= self._calm_us - time_us <= LATEST_US

    def _may_move(self, now_s: float) -> bool:
        ready = self.following is not None and self.following.ready
        return ready and self.enabled and now_s >= self._settling[1] and self.tick(now_s) is None

    def _commanded_motion(self, now_s: float) -> float:
        """Return how far the arm was commanded to move in the window that ends now [m]."""
        if self._planner is None:
            return 0.0
        end_s = now_s - ARM_LAG_S
        return self._planner.advance_at(end_s) - self._planner.advance_at(end_s - WINDOW_S)

    def _step(self, window: SlipWindow, now_s: float) -> SlipStep:
        self.watch.on_window(window, now_s)
        detectors, count, law = self.detectors, self.detectors.count, self.law
        self._window, self._end_us = (window.end_us, now_s), window.end_us
        slipping = detectors.update(window, self._commanded_motion(now_s))
        if slipping:
            self._calm_us = window.end_us + CALM_US
        wanted, full = 0.0, window.count >= SATURATION_COUNT
        if self._planner is not None and not full and self._may_move(now_s):
            reached, force = self._planner.advance_at(now_s), self.watch.force or 0.0
            wanted = law.update(window.count, count.limit, reached, force, slipping=slipping)
        return SlipStep(
            end_us=window.end_us,
            count=window.count,
            background=count.median,
            background_sigma=count.scale,
            threshold=count.limit,
            count_slipping=count.slipping,
            flow=detectors.flow.flow,
            flow_threshold=detectors.flow.threshold,
            flow_slipping=detectors.flow.slipping,
            slipping=slipping,
            state=int(self.interlock.state),
            enabled=self.enabled,
            advance=wanted,
            total_advance=law.total,
            reason=self.reason(now_s),
            slip_direction=math.atan2(-window.flow_y, window.flow_x) if slipping else 0.0,
            wanted_force=law.step.goal if self.enabled else 0.0,
        )
