# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control in closed loop with cup, box and ball, simulated (paper, section IV-F)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_learning.experiments.harness import (
    PRESET,
    Context,
    Outcome,
    Row,
    Value,
    experiment,
    texts,
)
from mixtac_learning.experiments.slip_loop import (
    ClosedLoop,
    Floats,
    LoopRecord,
    SensedForce,
    calibrate,
)
from mixtac_learning.experiments.training import MODELS
from mixtac_learning.judge.report import PAPER, new_axes, save_figure
from mixtac_learning.train.config import OURS
from mixtac_sim.grasp.grasp import Grasp
from mixtac_sim.grasp.objects import draw_setup
from mixtac_sim.grids import STEP_US
from mixtac_sim.world.effects import preset
from mixtac_slip_control.parameters import SlipControlParameters

GRID_S = 1e-6 * STEP_US
"""Step of the simulated grasp [s]."""
KNOCK_S = 1.45
"""Onset of the knock [s]: the background is learned and the arm is enabled by then."""
EARLY_KNOCK_S = 0.05
"""Onset of the knock without a controller [s]."""
ENABLE_S = 1.1
"""Time at which the controller is enabled [s]."""
AFTER_KNOCK_S = 0.35
"""Time from the knock to the end of a trial [s]."""
REST_S = 0.3
"""Time for the object to come to rest without a controller [s]."""
HELD_MM = 5.0
"""An object that slips farther is lost [mm]: the contact of the fingertip is 12 mm wide."""
STILL_S = 0.02
"""Time without motion that counts as rest [s]."""
LOOK_BACK_US = 20_000
"""Time before a reported slip in which the object may have moved [us]."""
MOVED_MM = 5e-3
"""An object that moved farther than this during the look-back slipped by itself [mm]. With little
margin, some objects do so before the knock."""
COURSE_MS = np.arange(-10.0, 80.0, 0.5)
"""Times of the stored displacement from the onset of the knock [180] [ms]."""


@dataclass(frozen=True, slots=True)
class Arrest:
    """How an object comes to rest.

    Attributes:
        slip_mm: Displacement from the knock on [mm].
        arrest_ms: Time from the knock to rest [ms]; NaN for never.
    """

    slip_mm: float
    arrest_ms: float

    @property
    def held(self) -> bool:
        """Whether it came to rest, no more than 5 mm lower."""
        return bool(np.isfinite(self.arrest_ms)) and self.slip_mm <= HELD_MM


def arrest_of(
    t_us: NDArray[np.int64], object_mm: Floats, speed_mm_s: Floats, onset_us: float
) -> Arrest:
    """Return how an object comes to rest after a knock.

    Args:
        t_us: Times [n] [us].
        object_mm: Position of the object [n] [mm].
        speed_mm_s: Speed of the object [n] [mm/s].
        onset_us: Onset of the knock [us].
    """
    first = int(np.searchsorted(t_us, onset_us))
    slip = float(object_mm[-1] - object_mm[max(first - 1, 0)])
    moving = np.flatnonzero(speed_mm_s != 0.0)
    last = int(moving[-1]) if len(moving) else first
    stopped = t_us[-1] - t_us[last] >= 1e6 * STILL_S
    return Arrest(slip, 1e-3 * float(t_us[last] - onset_us) if stopped else float('nan'))


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
        settings: Settings of the slip controller.
    """

    name: str = 'box'
    seed: int = 0
    margin: float = 1.05
    knock_mm_s: float | None = None
    stiffness_n_per_mm: float | None = None
    preset: str = 'paper_like'
    settings: SlipControlParameters = field(default_factory=SlipControlParameters)

    def grasp(self, *, camera: bool, knock_s: float = KNOCK_S) -> Grasp:
        """Return the grasp of this trial at its start."""
        setup = draw_setup(
            self.name,
            np.random.default_rng([self.seed, 7]),
            margin=self.margin,
            knock_mm_s=self.knock_mm_s,
            knock_s=knock_s,
            stiffness_n_per_mm=self.stiffness_n_per_mm,
        )
        rest_s = KNOCK_S + AFTER_KNOCK_S
        chosen = preset(self.preset)
        return Grasp(setup, self.seed, self.seed, chosen, camera=camera, rest_s=rest_s)

    def uncontrolled(self) -> Arrest:
        """Return the arrest while the arm does not move."""
        grasp = self.grasp(camera=False, knock_s=EARLY_KNOCK_S)
        block = grasp.advance(np.zeros(round((EARLY_KNOCK_S + REST_S) / GRID_S)))
        return arrest_of(block.t_us, block.object_mm, block.speed_mm_s, 1e6 * EARLY_KNOCK_S)


def run_trial(plan: TrialPlan) -> tuple[dict[str, Any], LoopRecord]:
    """Run a trial, and the same without control.

    Args:
        plan: Settings of the trial.

    Returns:
        Result for JSON, and course of the trial. Times of the result are from the onset of the
        knock [ms], None for never.

        `name`, `seed`: Kind of object and seed of the trial.
        `mass_g`: Mass of the object [g].
        `knock_mm_s`: Speed of the object after the knock [mm/s].
        `grasp_n`: Grasp force [N].
        `knock_share`: Ratio of the normal force at the onset to the grasp force; the controller is
            enabled and has probed by then.
        `stiffness_n_per_mm`: Stiffness of the contact [N/mm].
        `detection_ms`: Time at which the selected detector reported slip.
        `slip_mm`, `arrest_ms`, `held`: Displacement of the object [mm], time at which it came to
            rest, whether it was held.
        `open_slip_mm`, `open_held`: The same without control.
        `peak_n`: Largest normal force [N].
        `advance_mm`: Advance at the end [mm].
        `false_alarms`: Slips reported before the knock while the object did not move.
        `limit_violations`: Samples of the commanded motion that violate a limit.
        `rejected`: Trajectories rejected by the controller of the arm.
        `stopped`: Reason of an interlock stop; empty without one.

    Raises:
        SlipControlError: The controller could not be enabled.
    """
    grasp = plan.grasp(camera=True)
    force = SensedForce(grasp, calibrate(plan.seed, plan.seed, plan.preset))
    record = ClosedLoop(grasp, plan.settings, force).run(KNOCK_S + AFTER_KNOCK_S, ENABLE_S)
    onset_us = 1e6 * KNOCK_S
    arrest = arrest_of(record.t_us, record.object_mm, record.speed_mm_s, onset_us)
    free = plan.uncontrolled()
    slipping = np.array([step.slipping for step in record.steps])
    after = record.answered_us[slipping & (record.answered_us > onset_us)]
    at_onset = record.normal_n[np.searchsorted(record.t_us, onset_us)]
    result = {
        'name': plan.name,
        'seed': plan.seed,
        'mass_g': grasp.setup.mass_g,
        'knock_mm_s': grasp.setup.knock_mm_s,
        'grasp_n': grasp.grasp_n,
        'knock_share': float(at_onset) / grasp.grasp_n,
        'stiffness_n_per_mm': grasp.stiffness_n_per_mm,
        'detection_ms': 1e-3 * float(after[0] - onset_us) if len(after) else None,
        'slip_mm': arrest.slip_mm,
        'arrest_ms': arrest.arrest_ms if np.isfinite(arrest.arrest_ms) else None,
        'held': arrest.held,
        'open_slip_mm': free.slip_mm,
        'open_held': free.held,
        'peak_n': float(record.normal_n.max()),
        'advance_mm': float(record.advance_mm[-1]),
        'false_alarms': _alarms_before(record, onset_us),
        'limit_violations': record.violations,
        'rejected': record.rejected,
        'stopped': record.stopped,
    }
    return result, record


def _alarms_before(record: LoopRecord, onset_us: float) -> int:
    """Return the number of slips reported before the knock while the object did not move."""
    early = record.answered_us < onset_us
    slipping = np.array([s.slipping for s in record.steps])[early]
    alarms = 0
    for k in np.flatnonzero(np.diff(slipping.astype(np.int8), prepend=0) > 0):
        end_us = record.steps[k].end_us
        then, now = np.searchsorted(record.t_us, [end_us - LOOK_BACK_US, end_us])
        alarms += bool(record.object_mm[now] - record.object_mm[then] <= MOVED_MM)
    return alarms


def _trial(plan: TrialPlan) -> dict[str, Any]:
    """Return the result, and the course of the displacement at `COURSE_MS` [mm]."""
    result, record = run_trial(plan)
    t_ms = 1e-3 * (record.t_us - 1e6 * KNOCK_S)
    start = np.interp(0.0, t_ms, record.object_mm)
    course = np.interp(COURSE_MS, t_ms, record.object_mm) - start
    return result | {'course_mm': course.round(4).tolist()}


PAPER_MM = {'cup': 0.90, 'box': 0.71, 'ball': 10.03}
"""Mean displacement in the paper [mm]."""
PAPER_MS = 13.0
"""Duration of the paper's one box trial [ms]."""
PAPER_BOX_MM = 0.32
"""Displacement of that trial [mm]."""
FIRST_SEED = 86_000
"""Seed of the first trial."""
MARGIN = 1.05
"""Ratio of the grasp force to the smallest force that holds the object."""
_PLACE = 'section IV-F, Fig. 8'
_COLOUR = MODELS[OURS].colour
Results = dict[str, list[dict[str, Any]]]


@experiment
def slip(context: Context) -> Outcome:
    """Slip control of objects that are struck, in closed loop."""
    grasped = context.sizes.grasps
    plans = [
        TrialPlan(name, FIRST_SEED + 1000 * at + k, margin=MARGIN, preset=PRESET)
        for at, (name, count) in enumerate(grasped.items())
        for k in range(count)
    ]
    found = context.run('slip', _trial, [(plan,) for plan in plans])
    results: Results = {name: [] for name in grasped}
    for plan, result in zip(plans, found, strict=True):
        results[plan.name].append(result)
    path = _draw(context.figure('slip'), results)
    trials = ', '.join(f'{count} x {name}' for name, count in grasped.items())
    return Outcome(
        data=f'virtual sensor, preset {PRESET}, and simulated grasp; {trials}; every trial draws'
        f' object, sensor and knock (seeds from {FIRST_SEED}); grasp force {MARGIN:g} times the'
        ' smallest force that holds',
        rows=_rows(results),
        figures={'Displacement of the boxes, and of all objects; diamonds: the paper': path},
        **texts('slip'),
    )


def _rows(results: Results) -> list[Row]:
    rows = []
    for name, trials in results.items():
        text = f'{len(trials)} trials; spread over trials'
        slip_mm, held, open_held, detection_ms = (
            Value.of(_values(trials, key), 'trials')
            for key in ('slip_mm', 'held', 'open_held', 'detection_ms')
        )
        rows += [
            Row(f'{name}: mean displacement', slip_mm, PAPER_MM[name], _PLACE, 'mm', text),
            Row(f'{name}: share held', held, 1.0, _PLACE, '', text),
            Row(f'{name}: share held without control', open_held, 0.0, _PLACE, '', text),
            Row(f'{name}: onset to detection', detection_ms, None, '', 'ms', text),
        ]
        if name == 'box':
            one = f'{text}; paper: one trial'
            middle, time = (_median(trials, key) for key in ('slip_mm', 'arrest_ms'))
            rows += [
                Row('box: median displacement', middle, PAPER_BOX_MM, _PLACE, 'mm', one),
                Row('box: median time from the knock to rest', time, PAPER_MS, _PLACE, 'ms', one),
            ]
    return rows


def _values(trials: Sequence[Mapping[str, Any]], key: str) -> NDArray[np.float64]:
    """Return a result of each trial; one that does not exist is NaN."""
    return np.array([trial[key] for trial in trials], np.float64)


def _median(trials: Sequence[Mapping[str, Any]], key: str) -> Value:
    values = _values(trials, key)
    found = Value.of(values, 'trials')
    return replace(found, mean=float(np.nanmedian(values))) if found.count else found


def _draw(path: Path, results: Results) -> Path:
    figure, (left, right) = new_axes(columns=2, width=9.0, height=3.8)
    for k, trial in enumerate(results.get('box', [])):
        left.plot(COURSE_MS, trial['course_mm'], color=_COLOUR, lw=1.8 if k == 0 else 0.5)
    left.plot(PAPER_MS, PAPER_BOX_MM, 'D', color=PAPER, label='paper, one trial')
    left.set(xlabel='time from the knock [ms]', ylabel='displacement [mm]')
    left.set_title('box, simulated', fontsize=10)
    left.legend(frameon=False, fontsize=8)
    random = np.random.default_rng(0)
    for k, (name, trials) in enumerate(results.items()):
        values = [trial['slip_mm'] for trial in trials]
        places = k + random.uniform(-0.15, 0.15, len(values))
        right.plot(places, values, 'o', color=_COLOUR, ms=4, alpha=0.6)
        right.hlines(np.mean(values), k - 0.25, k + 0.25, _COLOUR, lw=2)
        right.plot(k + 0.32, PAPER_MM[name], 'D', color=PAPER)
    right.set_xticks(range(len(results)), list(results))
    right.set(ylabel='displacement [mm]', yscale='log', xlim=(-0.6, len(results) - 0.4))
    for which in (right.yaxis.set_major_formatter, right.yaxis.set_minor_formatter):
        which('{x:.2g}')
    right.tick_params(axis='y', which='both', labelsize=8)
    right.set_title('all objects, means as lines, simulated', fontsize=10)
    return save_figure(figure, path)
