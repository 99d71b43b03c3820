# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One trial of the closed loop: an object, a blow, and what came of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_bringup.slip_bench.closed_loop import ArmSetup, ClosedLoop, Transport
from mixtac_bringup.slip_bench.floor import ArmReach, arrest_of, best_arrest
from mixtac_sim.arm.fr3 import READY
from mixtac_sim.grasp.grasp import Grasp
from mixtac_sim.grasp.objects import ObjectName, draw_setup
from mixtac_sim.presets import preset
from mixtac_slip_control.arm.advance_planner import AdvancePlanner
from mixtac_slip_control.arm.joint_limits import JointLimits
from mixtac_slip_control.arm.serial_arm import SerialArm
from mixtac_slip_control.arm.stream_settings import StreamSettings
from mixtac_slip_control.parameter_settings import slip_settings
from mixtac_slip_control.slip_control_parameters import SlipControlParameters

if TYPE_CHECKING:
    from mixtac_bringup.slip_bench.closed_loop import LoopRecord
    from mixtac_slip_control.slip_settings import SlipSettings

KNOCK_S = 1.45
"""When the blow comes [s]: the background has been learned, the arm is enabled."""
ENABLE_S = 1.1
LOOK_BACK_US = 20_000
MOVED_MM = 5e-3
"""Moved by more in the look-back, an object has slipped by itself: held with little margin, some do
before the blow [mm]."""
SECONDS = 1.8


def shipped_settings() -> SlipSettings:
    """Return the settings that the slip control node ships with."""
    return slip_settings(SlipControlParameters())


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """What a trial fixes.

    Attributes:
        name: Kind of object.
        seed: Draws the object, the day and the sensor.
        margin: Grasp force over the smallest that holds.
        knock_mm_s: Speed after the blow [mm/s]; from a drawn share of the weight's momentum if
            None.
        stiffness_n_per_mm: Of the whole contact [N/mm]; that of gel, mesh and object if None.
        preset: How hard the sensor is.
        arm: The arm.
        transport: Delays between the parts.
        settings: Of the slip controller.
    """

    name: ObjectName = 'box'
    seed: int = 0
    margin: float = 1.05
    knock_mm_s: float | None = None
    stiffness_n_per_mm: float | None = None
    preset: str = 'paper_like'
    arm: ArmSetup = field(default_factory=ArmSetup)
    transport: Transport = field(default_factory=Transport)
    settings: SlipSettings = field(default_factory=shipped_settings)

    def grasp(self, *, camera: bool, knock_s: float = KNOCK_S) -> Grasp:
        """Return the grasp of this trial, from its beginning."""
        rng = np.random.default_rng([self.seed, 7])
        setup = draw_setup(
            self.name,
            rng,
            margin=self.margin,
            knock_mm_s=self.knock_mm_s,
            knock_s=knock_s,
            stiffness_n_per_mm=self.stiffness_n_per_mm,
        )
        return Grasp(setup, self.seed, self.seed, preset(self.preset), camera=camera)

    def reach(self, *, ideal: bool) -> ArmReach:
        """Return what the arm can do along the normal; ideal: without lag."""
        planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3(), StreamSettings(share=1.0))
        planner.reset(READY, np.array(self.arm.normal))
        motion = planner.motion_limits
        assert motion is not None  # noqa: S101  (known after a reset with a normal)
        lag = 0.0 if ideal else self.arm.tracking.lag_s
        force = self.settings.safety.max_force
        return ArmReach(motion.acceleration, motion.jerk, lag, force)

    def chain_s(self) -> float:
        """Return the least time from a detection to a commanded motion [s]."""
        stream = self.arm.stream or StreamSettings()
        return self.transport.events_s + max(stream.lead_s, self.transport.command_s)


@dataclass(frozen=True, slots=True)
class TrialResult:
    """What came of a trial; times from the begin of the blow [ms], NaN for never.

    Attributes:
        name: Kind of object.
        seed: Of the trial.
        mass_g: Mass of the object [g].
        knock_mm_s: Speed after the blow [mm/s].
        transmitted: Share of the falling weight's momentum.
        grasp_n: Grasp force [N].
        knock_share: Normal force when the blow begins over that grasp force; the controller has
            been enabled and has probed by then.
        stiffness_n_per_mm: Of the contact [N/mm].
        detection_ms: When the chosen detector said slip.
        count_ms: When the count law did.
        flow_ms: When the flow detector did.
        publish_ms: When the first trajectory after the detection was published.
        slip_mm: How far the object moved [mm].
        arrest_ms: When it stood still.
        held: Whether it was held.
        open_slip_mm: How far it moves without control [mm].
        open_held: Whether it is held without control.
        floor_mm: Slip with the best motion of an arm without lag, begun at the onset [mm].
        floor_ms: Its arrest.
        chain_mm: Slip with the best motion of this arm, begun one window after the onset and
            after the delays of the chain [mm].
        chain_ms: Its arrest.
        peak_n: Largest normal force [N].
        advance_mm: Advance at the end [mm].
        false_alarms: Slips seen before the blow where the object had not moved.
        limit_violations: Samples of the commanded motion that broke a limit.
        rejected: Trajectories that the arm's controller rejected.
        stopped: Why the interlock stopped; empty if it did not.
    """

    name: str
    seed: int
    mass_g: float
    knock_mm_s: float
    transmitted: float
    grasp_n: float
    knock_share: float
    stiffness_n_per_mm: float
    detection_ms: float
    count_ms: float
    flow_ms: float
    publish_ms: float
    slip_mm: float
    arrest_ms: float
    held: bool
    open_slip_mm: float
    open_held: bool
    floor_mm: float
    floor_ms: float
    chain_mm: float
    chain_ms: float
    peak_n: float
    advance_mm: float
    false_alarms: int
    limit_violations: int
    rejected: int
    stopped: str

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return asdict(self)


def run_trial(plan: TrialPlan) -> tuple[TrialResult, LoopRecord]:
    """Run a trial with its open loop and its floors.

    Args:
        plan: What it fixes.

    Raises:
        SlipControlError: The controller could not be enabled.
    """
    grasp = plan.grasp(camera=True)
    record = ClosedLoop(grasp, plan.settings, plan.arm, plan.transport, plan.seed).run(
        SECONDS, ENABLE_S
    )
    onset_us = 1e6 * KNOCK_S
    arrest = arrest_of(record.t_us, record.object_mm, record.speed_mm_s, onset_us)
    # The mechanics of rest do not matter for what follows: a blow that comes sooner saves time.
    soon = 0.05
    floor = best_arrest(plan.grasp(camera=False, knock_s=soon), plan.reach(ideal=True), 0.0)
    delay_s = 1e-6 * plan.settings.window_us + plan.chain_s()
    chain = best_arrest(plan.grasp(camera=False, knock_s=soon), plan.reach(ideal=False), delay_s)
    still = ArmReach(1.0, 1e3, 0.0, 0.0)
    free = best_arrest(plan.grasp(camera=False, knock_s=soon), still, 0.0)
    setup = grasp.setup
    return (
        TrialResult(
            name=plan.name,
            seed=plan.seed,
            mass_g=setup.mass_g,
            knock_mm_s=setup.knock_mm_s,
            transmitted=setup.transmitted,
            grasp_n=grasp.grasp_n,
            knock_share=_force_at(record, onset_us) / grasp.grasp_n,
            stiffness_n_per_mm=grasp.stiffness_n_per_mm,
            detection_ms=_first_ms(record, [s.slipping for s in record.steps]),
            count_ms=_first_ms(record, [s.count_slipping for s in record.steps]),
            flow_ms=_first_ms(record, [s.flow_slipping for s in record.steps]),
            publish_ms=_published_ms(record),
            slip_mm=arrest.slip_mm,
            arrest_ms=arrest.arrest_ms,
            held=arrest.held,
            open_slip_mm=free.slip_mm,
            open_held=free.held,
            floor_mm=floor.slip_mm,
            floor_ms=floor.arrest_ms,
            chain_mm=chain.slip_mm,
            chain_ms=chain.arrest_ms,
            peak_n=float(record.normal_n.max()),
            advance_mm=float(record.advance_mm[-1]),
            false_alarms=_alarms_before(record),
            limit_violations=record.violations,
            rejected=record.rejected,
            stopped=record.stopped,
        ),
        record,
    )


def _first_ms(record: LoopRecord, said: list[bool]) -> float:
    """Return when a detector first said slip after the onset [ms]."""
    return _after_ms(record.answered_us[np.array(said)])


def _published_ms(record: LoopRecord) -> float:
    """Return when the first trajectory was published that may answer the detection [ms]."""
    detected_ms = _first_ms(record, [s.slipping for s in record.steps])
    # Written so that no detection, which is not a number, leaves nothing.
    answers = record.published_us >= 1e6 * KNOCK_S + 1e3 * detected_ms - 1.0
    return _after_ms(record.published_us[answers])


def _force_at(record: LoopRecord, time_us: float) -> float:
    return float(record.normal_n[np.searchsorted(record.t_us, time_us)])


def _after_ms(times_us: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    """Return the first time after the onset [ms from it], NaN if there is none."""
    after = times_us[times_us > 1e6 * KNOCK_S]
    return 1e-3 * float(after[0] - 1e6 * KNOCK_S) if len(after) else float('nan')


def _alarms_before(record: LoopRecord) -> int:
    """Return how many slips the chosen detector saw before the blow where nothing slipped."""
    early = record.answered_us < 1e6 * KNOCK_S
    said = np.array([s.slipping for s in record.steps])[early]
    onsets = np.flatnonzero(np.diff(said.astype(np.int8), prepend=0) > 0)
    return sum(not _moved(record, record.steps[k].end_us) for k in onsets)


def _moved(record: LoopRecord, time_us: float) -> bool:
    """Return whether the object slipped shortly before a time [us]."""
    then, now = np.searchsorted(record.t_us, [time_us - LOOK_BACK_US, time_us])
    return bool(record.object_mm[now] - record.object_mm[then] > MOVED_MM)
