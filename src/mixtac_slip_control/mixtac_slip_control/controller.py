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
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_slip_control.bounds import Advancer, ContactStiffness, StiffnessProbe
from mixtac_slip_control.detectors import SlipJudge
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipFeatures, SlipWindow
from mixtac_slip_control.law import AdvanceLaw
from mixtac_slip_control.parameters import SlipSettings
from mixtac_slip_control.safety import (
    EVENTS,
    FORCE,
    HEARTBEAT,
    JOINTS,
    Interlock,
    InterlockState,
    SafetyWatch,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from mixtac_events.arrays import Events
    from mixtac_slip_control.arm.planner import Planner
    from mixtac_slip_control.arm.trajectory import PlannedTrajectory
    from mixtac_slip_control.features import FlowGuide

    Normal = Sequence[float] | Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class SlipStep:
    """What one window led to; the fields are those of `mixtac_msgs/SlipState`.

    Attributes:
        end_us: End of the window, camera clock [us].
        count: Events in the window.
        background: Middle of the counts at rest.
        background_sigma: Scale of the tail of the counts at rest.
        threshold: Count above which the paper's law says slip.
        count_slipping: What the paper's law says.
        flow: Translation of the skin [px per contrast threshold].
        flow_threshold: Translation above which the flow detector says slip.
        flow_slipping: What the flow detector says.
        slipping: What counts, by the choice of detector.
        state: Number of the `InterlockState`.
        enabled: Whether the arm may follow slip.
        advance: Asked for by this window, along the contact normal [m].
        total_advance: Since enabling [m].
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
        settings: Settings of all parts.
        planner: Plans the arm's motion; None only reports.
        normal: Contact normal (3,) in the arm's base frame, along which the arm advances, or a
            function that tells it of the joint positions at enabling.
        check_state: Tells what is wrong with joint positions [rad], None if nothing is.

    Attributes:
        interlock: Whether the arm may follow.
        watch: Ages and limits.
        judge: The detectors.
        stiffness: What is known of the contact's stiffness.
    """

    def __init__(
        self,
        settings: SlipSettings | None = None,
        planner: Planner | None = None,
        normal: Normal = (0.0, 0.0, 1.0),
        check_state: Callable[[Sequence[float]], str | None] | None = None,
    ) -> None:
        self._settings = settings or SlipSettings()
        self.interlock = Interlock()
        self.watch = SafetyWatch(self._settings.safety)
        if check_state is not None:
            self.watch.check_state = check_state
        self.judge = SlipJudge(self._settings.judge)
        self.features = SlipFeatures(self._settings.window_us, self._settings.guide)
        self._law = AdvanceLaw(self._settings.advance)
        self.stiffness = ContactStiffness(self._settings.stiffness)
        self._probe = StiffnessProbe(self._settings.probe)
        self._planner = planner
        self._advancer: Advancer | None = None
        if planner is not None:
            lag_s = self._settings.arm_lag_s
            self._advancer = Advancer(planner, self._law, self.stiffness, self._probe, lag_s)
        self._normal_source = normal
        self._normal = np.zeros(3)
        self._settled_s = 0.0

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
        return self._advancer.total if self._advancer else 0.0

    @property
    def advance_limit(self) -> float:
        """Largest advance at present [m]."""
        return self._advancer.limit if self._advancer else 0.0

    @property
    def probing(self) -> bool:
        """Whether the stiffness of the contact is being learned by a small press."""
        return self.enabled and self._probe.active

    def configure(self, settings: SlipSettings) -> None:
        """Take over new settings, except the window and where the contact is."""
        self._settings = settings
        self.judge.configure(settings.judge)
        self._law.settings = settings.advance
        self.watch.settings = settings.safety
        self.stiffness.settings = settings.stiffness
        self._probe.settings = settings.probe
        if self._advancer is not None:
            self._advancer.arm_lag_s = settings.arm_lag_s

    def guide(self, guide: FlowGuide) -> None:
        """Tell motion by this frame from now on."""
        self.features.guide(guide)

    def on_force(self, force_n: float, stamp_us: int, now_s: float) -> None:
        """Take a normal force [N]; its stamp on the camera clock [us]."""
        new = self.watch.on_force(force_n, stamp_us, now_s)
        if new and self._advancer is not None:
            self._advancer.on_force(force_n, stamp_us, now_s)
        self.tick(now_s)

    def on_joint_state(self, positions: Sequence[float], now_s: float) -> None:
        """Take the joint positions [rad] of the arm, in the planner's order."""
        self.watch.on_joint_state(positions, now_s)
        self.tick(now_s)

    def on_heartbeat(self, now_s: float) -> None:
        """Take a sign of life of whoever supervises."""
        self.watch.on_heartbeat(now_s)

    def on_events(
        self, events: Events, complete_until: int, now_s: float, *, lost: bool = False
    ) -> list[SlipStep]:
        """Take the next packet and return what the windows that it closes led to.

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
        """Stop if anything speaks against going on; return what does, enabled or not."""
        fault = self.watch.fault(now_s)
        if fault is not None:
            self.interlock.stop(fault)
        return fault

    def braking(self, now_s: float) -> PlannedTrajectory | None:
        """Return the trajectory that ends a motion early, or None where nothing moves.

        To be asked for once after a stop or a disabling.
        """
        return None if self._planner is None else self._planner.stop(now_s)

    def enable(self, now_s: float) -> None:
        """Let slip move the arm, from where it is and from an advance of zero.

        Raises:
            SlipControlError: No arm, nothing learned, slip at present, a watchdog, a limit, or a
                stop that was not reset.
        """
        if self._planner is None or self._advancer is None:
            raise SlipControlError('slip control has no arm: start it with one to move it')
        if self.enabled:
            return
        self.interlock.enable(self._against(now_s))
        try:
            self._start(self._planner, self._advancer)
            self._settled_s = now_s + self._settings.settling_s
        except SlipControlError:
            self.interlock.disable()
            raise

    def disable(self) -> None:
        """Let nothing move; the sum stays on record until the next enabling."""
        self.interlock.disable()

    def reset(self, now_s: float) -> None:
        """Leave a stop; the arm stays disabled.

        Raises:
            SlipControlError: The cause is still there.
        """
        fault = self.watch.fault(now_s)
        if fault is not None:
            raise SlipControlError(f'slip control stays stopped: {fault}')
        self.interlock.reset()

    def tare(self) -> None:
        """Learn the background anew, from the next windows.

        Raises:
            SlipControlError: Slip control is enabled.
        """
        if self.enabled:
            raise SlipControlError('slip control is enabled: disable it before taring')
        self.judge.reset()

    def _against(self, now_s: float) -> str | None:
        if not self.judge.learned:
            windows = self._settings.judge.count.background.learning_windows
            return (
                f'the background is not learned yet: keep the contact still for {windows} windows, '
                'with events and frames arriving'
            )
        if self.judge.slipping:
            return 'the object slips: wait until it is still, or tare'
        return self.watch.fault(now_s)

    def _start(self, planner: Planner, advancer: Advancer) -> None:
        watch = self.watch
        assert watch.joints is not None  # noqa: S101  (a fault before the first ones)
        joints = np.array(watch.joints)
        source = self._normal_source
        self._normal = np.asarray(source(joints) if callable(source) else source, np.float64)
        planner.reset(joints, self._normal)
        advancer.start(watch.settings.max_force)

    def _may_move(self, now_s: float) -> bool:
        return self.enabled and now_s >= self._settled_s and self.tick(now_s) is None

    def _step(self, window: SlipWindow, now_s: float) -> SlipStep:
        self.watch.on_window(window.count, complete=window.complete, now_s=now_s)
        judge, count, advancer = self.judge, self.judge.count, self._advancer
        moved = advance = 0.0
        if advancer is not None:
            advancer.on_window(window.end_us, now_s)
            moved = advancer.moved(now_s, 1e-6 * self._settings.window_us)
        slipping = judge.update(window, moved)
        if advancer is not None and self._may_move(now_s):
            advance = advancer.update(window.count, judge, self.watch, now_s)
        return SlipStep(
            end_us=window.end_us,
            count=window.count,
            background=count.background.median,
            background_sigma=count.background.scale,
            threshold=count.threshold,
            count_slipping=count.slipping,
            flow=judge.flow.flow,
            flow_threshold=judge.flow.threshold,
            flow_slipping=judge.flow.slipping,
            slipping=slipping,
            state=int(self.interlock.state),
            enabled=self.enabled,
            advance=advance,
            total_advance=self.total_advance,
        )


OK, WARN, ERROR = range(3)
"""Levels of `diagnostic_msgs/DiagnosticStatus`."""
AGES: Final = (EVENTS, FORCE, JOINTS, HEARTBEAT)


@dataclass(slots=True)
class FeedCounts:
    """What came in and went out.

    Attributes:
        packets: Event packets.
        lost: Packets missing by their sequence numbers.
        refused: Messages that could not be read.
        problem: The latest reason for one, empty if there was none.
        windows: Slip states published.
        trajectories: Trajectories published.
    """

    packets: int = 0
    lost: int = 0
    refused: int = 0
    problem: str = ''
    windows: int = 0
    trajectories: int = 0


def node_status(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str, dict[str, object]]:
    """Return level, one line for people, and figures by name.

    Args:
        controller: The controller.
        counts: Of the node.
        latest: The latest window, None before the first.
        now_s: Host time [s].
    """
    values: dict[str, object] = {
        'state': controller.interlock.state.name.lower(),
        'packets': counts.packets,
        'lost packets': counts.lost,
        'unreadable messages': counts.refused,
        'windows': counts.windows,
        'skipped windows': controller.features.slicer.skipped_windows,
        'late events': controller.features.slicer.late_events,
        'clock restarts': controller.features.slicer.restarts,
        'trajectories': counts.trajectories,
        'advance limit [m]': controller.advance_limit,
        **{f'{name} age [s]': _age_of(controller, name, now_s) for name in AGES},
    }
    if latest is not None:
        values |= {
            'count threshold [events]': latest.threshold,
            'flow threshold [px]': latest.flow_threshold,
            'total advance [m]': latest.total_advance,
        }
    return *_level(controller, counts, latest, now_s), values


def _age_of(controller: SlipController, name: str, now_s: float) -> object:
    age = controller.watch.age(name, now_s)
    return age if math.isfinite(age) else 'never'


def _level(
    controller: SlipController, counts: FeedCounts, latest: SlipStep | None, now_s: float
) -> tuple[int, str]:
    if controller.interlock.state is InterlockState.STOPPED:
        return ERROR, f'stopped: {controller.interlock.reason}'
    if latest is None:
        problem = counts.problem or 'check that the driver runs'
        return WARN, f'no events yet: {problem}'
    if not controller.judge.learned:
        return WARN, 'learning the background: keep the contact still'
    if controller.enabled:
        return OK, 'enabled'
    fault = controller.watch.fault(now_s) if controller.has_arm else 'no arm'
    return OK, f'watching; cannot be enabled: {fault}' if fault else 'watching; ready'
