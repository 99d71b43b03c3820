# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Detection, law, interlock and planner of the arm as one object without ROS.

The node and the simulations drive the same object: inputs arrive by the `on_` methods, `plan`
returns what is to be sent to the arm, `tick` checks the watchdogs when nothing arrives. All `now_s`
are on one host clock, the one that trajectories are stamped with; event and force times are on the
camera clock.

Every trajectory ends at rest, so an arm that receives nothing more stops by itself; `braking` stops
it sooner. `node_status` summarises the controller for diagnostics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_events.sequence import SequenceCounter
from mixtac_node.diagnostics import ERROR, OK, WARN
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.detectors import Detectors
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipFeatures, SlipWindow
from mixtac_slip_control.law import Advance
from mixtac_slip_control.parameters import ADJUSTABLE_WHILE_ENABLED, SlipControlParameters
from mixtac_slip_control.safety import (
    EVENTS,
    FORCE,
    HEARTBEAT,
    JOINTS,
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
        threshold: Count above which the paper's law detects slip.
        count_slipping: Decision of the paper's law.
        flow: Translation of the skin [px per contrast threshold].
        flow_threshold: Translation above which the flow detector detects slip.
        flow_slipping: Decision of the flow detector.
        slipping: Decision of the chosen detector.
        state: Number of the `InterlockState`.
        enabled: Whether the arm may follow slip.
        advance: Wanted because of this window, along the contact normal [m].
        total_advance: Wanted since enabling [m].
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
        detectors: Both slip detectors.
        features: Cuts the event stream into windows.
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
        self._planner = planner
        self._advance = None if planner is None else Advance(parameters, planner)
        self._normal_source = normal
        self._normal = np.zeros(3)
        self._settling = (0.0, 0.0)

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
        if self._advance is not None:
            self._advance.configure(parameters)

    def on_force(self, force_n: float, stamp_us: int, now_s: float) -> None:
        """Take a normal force [N]; its stamp on the camera clock [us]."""
        new = self.watch.on_force(force_n, stamp_us, now_s)
        if new and self._advance is not None:
            self._advance.on_force(force_n, stamp_us, now_s)
        self.tick(now_s)

    def on_quality(self, untrusted: str, now_s: float) -> None:
        """Take why the latest force cannot be trusted; empty if it can."""
        self.watch.on_quality(untrusted)
        self.tick(now_s)

    def on_joint_state(self, positions: Sequence[float], now_s: float) -> None:
        """Take the joint positions [rad] of the arm, in the planner's order."""
        self.watch.on_joint_state(positions, now_s)
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

    def tick(self, now_s: float) -> str | None:
        """Stop if there is a fault; return it, enabled or not."""
        fault = self.watch.fault(now_s)
        if fault is not None:
            self.interlock.stop(fault)
        return fault

    def braking(self, now_s: float) -> PlannedTrajectory | None:
        """Return the trajectory that ends a motion early, or None where nothing moves.

        To be asked for once after a stop or a disabling. Where it cannot be planned, the last
        trajectory brings the arm to rest.
        """
        if self._planner is None:
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
        if self._planner is None or self._advance is None:
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
        except SlipControlError:
            self.interlock.disable()
            raise
        self._settling = (now_s, now_s + settling_s)

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
        fault = self.watch.fault(now_s)
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

    def _reason_not_to_enable(self, now_s: float) -> str | None:
        if not self.detectors.learned:
            return (
                'the background is not learned yet: keep the contact still for '
                f'{self._parameters.learning_windows} windows, with events and frames arriving'
            )
        if self.detectors.slipping:
            return 'the object slips: wait until it is still, or tare'
        start, end = self._settling
        # A trajectory from the measured positions would cut a motion that has not ended.
        if start <= now_s < end or (self._planner is not None and self._planner.moving(now_s)):
            return 'the arm still comes to rest from the last motion: try again in a moment'
        return self.watch.fault(now_s)

    def _may_move(self, now_s: float) -> bool:
        return self.enabled and now_s >= self._settling[1] and self.tick(now_s) is None

    def _step(self, window: SlipWindow, now_s: float) -> SlipStep:
        self.watch.on_window(window.count, complete=window.complete, now_s=now_s)
        detectors, count = self.detectors, self.detectors.count
        motion = wanted = 0.0
        if self._advance is not None:
            self._advance.on_window(window.end_us, now_s)
            motion = self._advance.commanded_motion(now_s)
        slipping = detectors.update(window, motion)
        if self._advance is not None and self._may_move(now_s):
            wanted = self._advance.update(window.count, detectors, self.watch.force, now_s)
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
        )


AGES: Final = (EVENTS, FORCE, JOINTS, HEARTBEAT)


@dataclass(slots=True)
class FeedCounts:
    """Messages of the node, in and out.

    Attributes:
        packets: Event packets received and missing, by their sequence numbers.
        refused: Messages that could not be read.
        problem: Why the latest of them could not, empty if there was none.
        windows: Slip states published.
        trajectories: Trajectories sent to the arm.
    """

    packets: SequenceCounter = field(default_factory=SequenceCounter)
    refused: int = 0
    problem: str = ''
    windows: int = 0
    trajectories: int = 0


def node_status(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str, dict[str, object]]:
    """Return level, a one-line summary, and figures by name.

    Args:
        controller: The controller.
        counts: Messages of the node.
        latest: Result of the latest window, None before the first.
        now_s: Host time [s].
    """
    slicer = controller.features.slicer
    values: dict[str, object] = {
        'state': controller.interlock.state.name.lower(),
        'packets': counts.packets.received,
        'lost packets': counts.packets.lost,
        'unreadable messages': counts.refused,
        'windows': counts.windows,
        'skipped windows': slicer.skipped_windows,
        'late events': slicer.late_events,
        'clock restarts': slicer.restarts,
        'trajectories': counts.trajectories,
        'advance limit [m]': controller.advance_limit,
    }
    for name in AGES:
        age = controller.watch.age(name, now_s)
        values[f'{name} age [s]'] = age if math.isfinite(age) else 'never'
    if latest is not None:
        values |= {
            'count threshold [events]': latest.threshold,
            'flow threshold [px]': latest.flow_threshold,
            'total advance [m]': latest.total_advance,
        }
    return *_summary(controller, counts, latest, now_s), values


def _summary(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str]:
    if controller.interlock.state is InterlockState.STOPPED:
        return ERROR, f'stopped: {controller.interlock.reason}'
    if latest is None:
        problem = counts.problem or 'check that the driver runs'
        return WARN, f'no events yet: {problem}'
    if not controller.detectors.learned:
        return WARN, 'learning the background: keep the contact still'
    if controller.enabled:
        return OK, 'enabled'
    fault = controller.watch.fault(now_s) if controller.has_arm else 'no arm'
    return OK, f'watching; cannot be enabled: {fault}' if fault else 'watching; ready'
