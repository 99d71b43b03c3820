# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip trials: an object, a knock, the result, and summaries of many trials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from mixtac_fger.weights import DEFAULT_MODEL, find_model
from mixtac_lab.slip.loop import (
    SIDEWAYS,
    TRANSPORT_S,
    ArmReach,
    ClosedLoop,
    LoopRecord,
    arrest_of,
    best_arrest,
)
from mixtac_lab.slip.sensing import SensedForce, calibrate, sense_grasp
from mixtac_lab.store import Piece, code_version, files_version
from mixtac_sim.arm import READY, TRACKING_LAG_S
from mixtac_sim.grasp.grasp import Grasp
from mixtac_sim.grasp.objects import ObjectName, draw_setup
from mixtac_sim.world.effects import preset
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.parameters import WINDOW_S, SlipControlParameters

KNOCK_S = 1.45
"""Onset of the knock [s]: the background is learned and the arm is enabled by then."""
ENABLE_S = 1.1
LOOK_BACK_US = 20_000
MOVED_MM = 5e-3
"""An object that moved farther than this during the look-back slipped by itself [mm]. With little
margin, some objects do so before the knock."""
SLID_MM = 0.1
"""An object that moved farther before the controller was enabled had begun to slide [mm]."""
AFTER_KNOCK_S = 0.35
"""Time from the knock to the end of a trial [s]."""


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """Settings of a trial.

    Attributes:
        name: Kind of object.
        seed: Seed of the object, the day and the sensor.
        margin: Ratio of the grasp force to the smallest force that holds the object for the length
            of the trial, with the arm at rest and without a knock.
        knock_mm_s: Speed of the object after the knock [mm/s]; None to compute it from a random
            share of the momentum of the falling weight.
        stiffness_n_per_mm: Stiffness of the whole contact [N/mm]; None for that of gel, mesh and
            object.
        preset: Difficulty preset of the virtual sensor.
        lag_s: Time constant with which the arm follows its commands [s].
        settings: Settings of the slip controller.
        estimated: Whether the force is the sensor's own; else it is the true one with noise.
        wait_s: Time that the grip margin has to act before the knock, beyond `KNOCK_S` [s].
        off_axis_mm: Distance of the contact from the optical axis, in a random direction [mm]; None
            for the place of the day.
    """

    name: ObjectName = 'box'
    seed: int = 0
    margin: float = 1.05
    knock_mm_s: float | None = None
    stiffness_n_per_mm: float | None = None
    preset: str = 'paper_like'
    lag_s: float = TRACKING_LAG_S
    settings: SlipControlParameters = field(default_factory=SlipControlParameters)
    estimated: bool = True
    wait_s: float = 0.0
    off_axis_mm: float | None = None

    @property
    def onset_us(self) -> float:
        """Onset of the knock [us]."""
        return 1e6 * (KNOCK_S + self.wait_s)

    def force(self, grasp: Grasp) -> SensedForce | None:
        """Return the calibrated sensor of the grasp; None where the true force is given."""
        if not self.estimated:
            return None
        return sense_grasp(grasp, calibrate(self.seed, self.seed, self.preset))

    def grasp(self, *, camera: bool, knock_s: float | None = None) -> Grasp:
        """Return the grasp of this trial at its start."""
        knock_s = 1e-6 * self.onset_us if knock_s is None else knock_s
        rng = np.random.default_rng([self.seed, 7])
        setup = draw_setup(
            self.name,
            rng,
            margin=self.margin,
            knock_mm_s=self.knock_mm_s,
            knock_s=knock_s,
            stiffness_n_per_mm=self.stiffness_n_per_mm,
        )
        place = None
        if self.off_axis_mm is not None:
            angle = np.random.default_rng([self.seed, 8]).uniform(0.0, 2.0 * np.pi)
            place = self.off_axis_mm * float(np.cos(angle)), self.off_axis_mm * float(np.sin(angle))
        return Grasp(
            setup,
            self.seed,
            self.seed,
            preset(self.preset),
            camera=camera,
            rest_s=1e-6 * self.onset_us + AFTER_KNOCK_S,
            contact_mm=place,
        )

    def reach(self, *, ideal: bool) -> ArmReach:
        """Return the limits of the arm along the normal; an ideal arm has no lag."""
        planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3(), share=1.0)
        planner.reset(READY, np.array(SIDEWAYS), self.settings.max_total)
        motion = planner.motion_limits
        lag_s = 0.0 if ideal else self.lag_s
        return ArmReach(motion.acceleration, motion.jerk, lag_s, self.settings.max_force)


def run_trial(plan: TrialPlan) -> tuple[dict[str, Any], LoopRecord]:
    """Run a trial, its open loop and its lower bounds.

    Args:
        plan: Settings of the trial.

    Returns:
        Result for JSON, and course of the trial. Times of the result are from the onset of the
        knock [ms], None for never.

        `name`: Kind of object.
        `seed`: Seed of the trial.
        `mass_g`: Mass of the object [g].
        `knock_mm_s`: Speed of the object after the knock [mm/s].
        `transmitted`: Share of the momentum of the falling weight that reaches the object.
        `grasp_n`: Grasp force [N].
        `knock_share`: Ratio of the normal force at the onset to the grasp force; the controller is
            enabled and has probed by then.
        `stiffness_n_per_mm`: Stiffness of the contact [N/mm].
        `detection_ms`: Time at which the selected detector reported slip.
        `count_ms`: Time at which the count law reported slip.
        `flow_ms`: Time at which the flow detector reported slip.
        `publish_ms`: Time at which the first trajectory after the detection was published.
        `slip_mm`: Displacement of the object [mm].
        `arrest_ms`: Time at which the object came to rest.
        `held`: Whether the object was held.
        `open_slip_mm`: Displacement without control [mm].
        `open_held`: Whether the object is held without control.
        `floor_mm`: Lower bound of the displacement: the best motion of an arm without lag, started
            at the onset [mm].
        `floor_ms`: Time of rest with that motion.
        `chain_mm`: Lower bound for this arm: its best motion, started one window and the delays of
            the chain after the onset [mm].
        `chain_ms`: Time of rest with that motion.
        `peak_n`: Largest normal force [N].
        `advance_mm`: Advance at the end [mm].
        `slid_before`: Whether the object slid more than 0.1 mm before the controller was enabled.
        `false_alarms`: Slips reported before the knock while the object did not move.
        `limit_violations`: Samples of the commanded motion that violate a limit.
        `rejected`: Trajectories rejected by the controller of the arm.
        `stopped`: Reason of an interlock stop; empty without one.

    Raises:
        SlipControlError: The controller could not be enabled.
    """
    grasp = plan.grasp(camera=True)
    loop = ClosedLoop(grasp, plan.settings, plan.lag_s, plan.seed, plan.force(grasp))
    onset_us = plan.onset_us
    record = loop.run(1e-6 * onset_us + AFTER_KNOCK_S, ENABLE_S)
    arrest = arrest_of(record.t_us, record.object_mm, record.speed_mm_s, onset_us)
    # The rest before the knock does not matter below: an earlier knock saves time.
    soon = 0.05
    floor = best_arrest(plan.grasp(camera=False, knock_s=soon), plan.reach(ideal=True), 0.0)
    # The least time from a detection to a commanded motion.
    chain_s = TRANSPORT_S['events_s'] + max(plan.settings.lead, TRANSPORT_S['command_s'])
    delay_s = WINDOW_S + chain_s
    chain = best_arrest(plan.grasp(camera=False, knock_s=soon), plan.reach(ideal=False), delay_s)
    still = ArmReach(1.0, 1e3, 0.0, 0.0)
    free = best_arrest(plan.grasp(camera=False, knock_s=soon), still, 0.0)
    setup = grasp.setup
    result = {
        'name': plan.name,
        'seed': plan.seed,
        'mass_g': setup.mass_g,
        'knock_mm_s': setup.knock_mm_s,
        'transmitted': setup.transmitted,
        'grasp_n': grasp.grasp_n,
        'knock_share': _force_at(record, onset_us) / grasp.grasp_n,
        'stiffness_n_per_mm': grasp.stiffness_n_per_mm,
        'detection_ms': _first_ms(record, onset_us, [s.slipping for s in record.steps]),
        'count_ms': _first_ms(record, onset_us, [s.count_slipping for s in record.steps]),
        'flow_ms': _first_ms(record, onset_us, [s.flow_slipping for s in record.steps]),
        'publish_ms': _published_ms(record, onset_us),
        'slip_mm': arrest.slip_mm,
        'arrest_ms': arrest.arrest_ms,
        'held': arrest.held,
        'open_slip_mm': free.slip_mm,
        'open_held': free.held,
        'floor_mm': floor.slip_mm,
        'floor_ms': floor.arrest_ms,
        'chain_mm': chain.slip_mm,
        'chain_ms': chain.arrest_ms,
        'peak_n': float(record.normal_n.max()),
        'advance_mm': float(record.advance_mm[-1]),
        'slid_before': bool(np.interp(1e6 * ENABLE_S, record.t_us, record.object_mm) > SLID_MM),
        'false_alarms': _alarms_before(record, onset_us),
        'limit_violations': record.violations,
        'rejected': record.rejected,
        'stopped': record.stopped,
    }
    never = dict.fromkeys(key for key, value in result.items() if value != value)  # noqa: PLR0124
    return result | never, record


LOAD_G_PER_S: Final = 10.0
"""Mass that is added to a loaded object [g/s]."""
LOAD_TIMES: Final = 2.0
"""Times its mass to which it is loaded."""


def run_loaded(plan: TrialPlan) -> dict[str, Any]:
    """Load an object slowly from the onset on, instead of a knock, and return the result for JSON.

    Returns:
        `held`: whether it moved no farther than 5 mm and is at rest with the whole load; `slip_mm`:
        how far; `slips`: times that slip was reported; `grasp_n` and `end_n`: normal force at the
        start and at the end; `peak_n`: the largest; `stopped`: reason of an interlock stop.

    Raises:
        SlipControlError: The controller could not be enabled.
    """
    grasp = replace(plan, knock_mm_s=0.0).grasp(camera=True)
    start_g, onset_us = grasp.setup.mass_g, plan.onset_us
    load_s = (LOAD_TIMES - 1.0) * start_g / LOAD_G_PER_S

    def mass_g(time_s: float) -> float:
        return start_g + LOAD_G_PER_S * min(max(time_s - 1e-6 * onset_us, 0.0), load_s)

    loop = ClosedLoop(grasp, plan.settings, plan.lag_s, plan.seed, plan.force(grasp), mass_g)
    record = loop.run(1e-6 * onset_us + load_s + AFTER_KNOCK_S, ENABLE_S)
    arrest = arrest_of(record.t_us, record.object_mm, record.speed_mm_s, onset_us)
    slipping = np.array([s.slipping for s in record.steps]).astype(np.int8)
    return {
        'held': arrest.held,
        'slip_mm': arrest.slip_mm,
        'slips': int(np.count_nonzero(np.diff(slipping) > 0)),
        'grasp_n': grasp.grasp_n,
        'end_n': float(record.normal_n[-1]),
        'peak_n': float(record.normal_n.max()),
        'stopped': record.stopped,
    }


def _first_ms(record: LoopRecord, onset_us: float, slipping: list[bool]) -> float:
    """Return the time of the first slip that a detector reported after the onset [ms]."""
    return _after_ms(record.answered_us[np.array(slipping)], onset_us)


def _published_ms(record: LoopRecord, onset_us: float) -> float:
    """Return the time of the first trajectory that can answer the detection [ms]."""
    detected_ms = _first_ms(record, onset_us, [s.slipping for s in record.steps])
    # Without a detection the comparison with NaN selects nothing.
    answers = record.published_us >= onset_us + 1e3 * detected_ms - 1.0
    return _after_ms(record.published_us[answers], onset_us)


def _force_at(record: LoopRecord, time_us: float) -> float:
    return float(record.normal_n[np.searchsorted(record.t_us, time_us)])


def _after_ms(times_us: np.ndarray[Any, np.dtype[np.float64]], onset_us: float) -> float:
    """Return the first time after the onset [ms from it], NaN if there is none."""
    after = times_us[times_us > onset_us]
    return 1e-3 * float(after[0] - onset_us) if len(after) else float('nan')


def _alarms_before(record: LoopRecord, onset_us: float) -> int:
    """Return the number of slips reported before the knock while the object did not move."""
    early = record.answered_us < onset_us
    slipping = np.array([s.slipping for s in record.steps])[early]
    onsets = np.flatnonzero(np.diff(slipping.astype(np.int8), prepend=0) > 0)
    return sum(not _moved(record, record.steps[k].end_us) for k in onsets)


def _moved(record: LoopRecord, time_us: float) -> bool:
    """Return whether the object slipped shortly before a time [us]."""
    then, now = np.searchsorted(record.t_us, [time_us - LOOK_BACK_US, time_us])
    return bool(record.object_mm[now] - record.object_mm[then] > MOVED_MM)


def latency_quantiles(values: Iterable[float | None]) -> dict[str, float | None]:
    """Return median and 99th percentile of latencies; NaN or None is a miss.

    A miss counts as later than everything: a percentile that falls on a miss is None.
    """
    array = np.array(list(values), np.float64)
    late = np.where(np.isfinite(array), array, np.inf)
    if not len(late):
        return {'p50': None, 'p99': None}
    found = np.quantile(late, [0.5, 0.99], method='higher')
    p50, p99 = (round(float(v), 3) if np.isfinite(v) else None for v in found)
    return {'p50': p50, 'p99': p99}


def summary(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return statistics of trials for JSON."""
    count = len(results)
    values = {name: [each[name] for each in results] for name in results[0]}
    latencies = ('detection_ms', 'count_ms', 'flow_ms', 'publish_ms')
    medians = ('arrest_ms', 'knock_mm_s', 'stiffness_n_per_mm', 'grasp_n', 'knock_share', 'peak_n')
    totals = ('false_alarms', 'limit_violations', 'rejected', 'slid_before')
    mean = round(float(np.mean(values['slip_mm'])), 4)
    return {
        'trials': count,
        'held_fraction': round(sum(values['held']) / count, 4),
        'open_loop_held_fraction': round(sum(values['open_held']) / count, 4),
        'slip_mm': {'mean': mean, **_median(values['slip_mm'])},
        'floor_slip_mm': _median(values['floor_mm']),
        'floor_arrest_ms': _median(values['floor_ms']),
        'chain_floor_slip_mm': _median(values['chain_mm']),
        'chain_floor_arrest_ms': _median(values['chain_ms']),
        **{key: latency_quantiles(values[key]) for key in latencies},
        **{key: _median(values[key]) for key in medians},
        **{key: sum(values[key]) for key in totals},
        'stopped': sum(map(bool, values['stopped'])),
    }


def _median(values: Sequence[float | None]) -> dict[str, float | None]:
    """Return the median, the 10th and the 90th percentile; None without finite values."""
    array = np.array(values, np.float64)
    good, names = array[np.isfinite(array)], ('median', 'p10', 'p90')
    if not len(good):
        return dict.fromkeys(names)
    found = np.quantile(good, [0.5, 0.1, 0.9]).round(3).tolist()
    return dict(zip(names, found, strict=True))


COURSE_MS: Final = np.arange(-10.0, 80.0, 0.5)
"""Times of the stored displacement from the onset of the knock [180] [ms]."""


def trial_piece(plan: TrialPlan) -> Piece:
    """Return a trial as a piece of work; its result has `course_mm`, too."""
    packages = ('mixtac_events', 'mixtac_fger', 'mixtac_recordings', 'mixtac_sim')
    code = code_version(*packages, 'mixtac_slip_control', 'mixtac_lab.slip')
    version = f'{code} {files_version([find_model(DEFAULT_MODEL)])}'
    return Piece(f'grasp_{plan.name}_s{plan.seed}', _trial, (plan,), version)


def _trial(_base: Path, plan: TrialPlan) -> dict[str, Any]:
    """Return the result and the course of the displacement at `COURSE_MS` [mm]."""
    result, record = run_trial(plan)
    t_ms = 1e-3 * (record.t_us - plan.onset_us)
    start = np.interp(0.0, t_ms, record.object_mm)
    course = np.interp(COURSE_MS, t_ms, record.object_mm) - start
    return result | {'course_mm': course.round(4).tolist()}


def _loaded(_base: Path, plan: TrialPlan) -> dict[str, Any]:
    return run_loaded(plan)
