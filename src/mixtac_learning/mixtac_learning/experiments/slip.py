# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control in closed loop with cup, box and ball, simulated (paper, section IV-F).

Grasp, sensor, slip controller, trajectories and arm in lock-step, 1 ms at a time.

The loop is faster than real time and reproducible. The delays that the real chain adds between the
parts are constants. The force is the estimate of the simulated sensor, calibrated as a user would
calibrate it. A grasp begins with the object already held, so the no-contact reference and the gain
are measured before it: the reference in still frames of the same day without contact, and the gain
on another day, elsewhere on the gel, by a press with known forces.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac.figures import FORCE, PAPER, new_axes, save_figure
from mixtac_core.events.arrays import Events
from mixtac_core.recordings.messages import left_aligned
from mixtac_fger.estimator import Estimate, open_estimator
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_learning.experiments.harness import PRESET, Context, Outcome, Row, Value, experiment
from mixtac_learning.judge.estimators import stream
from mixtac_learning.trials.trial import SimulatedSource
from mixtac_sim.arm import READY, JointTrajectoryController, LaggingArm, Trajectory, violations
from mixtac_sim.grasp.grasp import Grasp, GraspBlock
from mixtac_sim.grasp.objects import draw_setup
from mixtac_sim.grids import STEP_US
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.world.effects import preset
from mixtac_sim.world.plans import TrialSpec
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.controller import SlipController, SlipStep
from mixtac_slip_control.parameters import SlipControlParameters

Floats = NDArray[np.float64]
ANOTHER_DAY = 1_000_000
"""Added to the seed of a trial for the day of the press."""
PRESS_S = 6.0
"""Length of the press [s]."""
TOUCHED_N = 0.05
"""True force from which on a window counts for a gain [N]."""
ENCODED_US = 8_000
"""Time from the end of the readout of a frame until the estimator has encoded it [us]."""


@cache
def _model() -> Model:
    return read_model(find_model(DEFAULT_MODEL))


@lru_cache(maxsize=16)
def press_gain(seed: int, preset: str) -> float:
    """Return the gain of a sensor, measured by a press with known forces on another day.

    Args:
        seed: Seed of the sensor, and of the trial that is to follow.
        preset: Difficulty preset of the sensor.
    """
    spec = TrialSpec(seed, seed + ANOTHER_DAY, 'press', PRESS_S, preset)
    press = stream(_model(), SimulatedSource(spec).load())
    known, force = (each[press.known > TOUCHED_N] for each in (press.known, press.force))
    both = float((known * force).sum())
    return both / float((force**2).sum()) if both > 0.0 else 1.0


class SensedForce:
    """Estimates the force in a grasp; its reference is from the time before the contact.

    Args:
        grasp: The grasp at its start.
        gain: Gain of the sensor.
    """

    def __init__(self, grasp: Grasp, gain: float) -> None:
        self.estimator = ForceEstimator(
            open_estimator(_model()), assume_free=True, force_scale=gain
        )
        self._frames: list[ApsFrame] = []
        reference = self.estimator.reference
        for frame in grasp.free_frames(0 if reference is None else reference.frames):
            self._push(frame)
        if reference is not None and reference.array is not None:
            # The contact of the grasp begins without having been seen: a stored reference.
            reference.use(reference.array)

    def advance(
        self, events: Events, frames: Iterable[ApsFrame], until_us: int
    ) -> Sequence[Estimate]:
        """Return the estimates of the windows that end by a time.

        Args:
            events: Since the last call, true time.
            frames: Whose exposure ended since the last call.
            until_us: No event before this time will follow [us].
        """
        self._frames += frames
        while self._frames and self._frames[0].frame_end_us + ENCODED_US <= until_us:
            self._push(self._frames.pop(0))
        return self.estimator.push_events(events, until_us)

    def _push(self, frame: ApsFrame) -> None:
        middle = (frame.exposure_start_us + frame.exposure_end_us) // 2
        self.estimator.push_frame(left_aligned(frame.intensity), middle)


CYCLE_S = 1e-3
"""Period of the loop [s]."""
STEPS = 8
"""Grid steps of the grasp per cycle."""
EPOCH_S = 100.0
"""Controller time at the start [s]; a stamp of zero has another meaning."""
SIDEWAYS = (0.0, 1.0, 0.0)
"""Contact normal in the base frame; the arm is fastest in this direction at the ready pose."""
GUIDE_DELAY_S = 4e-3
"""Time from the end of the readout of a frame to its guide [s]."""
EVENTS_DELAY_S = 0.7e-3
"""Time from the end of a window to the controller (USB, driver and DDS) [s]."""
COMMAND_DELAY_S = 0.8e-3
"""Time from the answer of the controller to the trajectory at the arm [s]."""
FORCE_AGE_S = 3e-3
"""Age of a force estimate at the controller [s]."""


class ClosedLoop:
    """One run of the loop.

    Args:
        grasp: The grasp, with a camera.
        settings: Settings of the slip controller.
        force: The sensor's force.

    Attributes:
        grasp: The grasp.
        answered_us: True time of the answer to each window [us].
        steps: Answer of the controller to each window.
        rejected: Number of trajectories that the arm's controller rejected.
        stopped: Reason of an interlock stop; empty without one.
    """

    def __init__(self, grasp: Grasp, settings: SlipControlParameters, force: SensedForce) -> None:
        self.grasp, self._force = grasp, force
        self._estimates: list[Estimate] = []
        self._arm = JointTrajectoryController()
        self._arm.reset(READY, EPOCH_S)
        planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3(), settings.lead)
        self._controller = SlipController(settings, planner, SIDEWAYS)
        self._tip = LaggingArm(READY, np.array(SIDEWAYS))
        self._under_way: list[tuple[float, PlannedTrajectory]] = []
        self._frames: list[ApsFrame] = []
        self._cycle, self.rejected, self.stopped = 0, 0, ''
        self._blocks: list[GraspBlock] = []
        self._ways: list[Floats] = []
        self._commands: list[Floats] = []
        self.answered_us: list[float] = []
        self.steps: list[SlipStep] = []

    def run(self, until_s: float) -> None:
        """Run to a time [s] from the start."""
        while self._cycle < round(until_s / CYCLE_S):
            self._step()

    def enable(self, settings: SlipControlParameters) -> None:
        """Enable the controller with other settings; it must have learned its background.

        Raises:
            SlipControlError: The controller cannot be enabled.
        """
        self._controller.configure(settings)
        self._controller.enable(self._now_s)

    @property
    def course(self) -> dict[str, NDArray[Any]]:
        """Arrays over true time, on a grid of 125 us, [n].

        `t_us`: time since the start [us]; `object_mm`, `speed_mm_s`: position [mm] and speed [mm/s]
        of the object, downwards; `normal_n`: normal force [N]; `advance_mm`: position of the
        fingertip [mm].
        """
        names = ('t_us', 'object_mm', 'speed_mm_s', 'normal_n')
        parts = {n: np.concatenate([getattr(b, n) for b in self._blocks]) for n in names}
        return parts | {'advance_mm': np.concatenate(self._ways)}

    @property
    def violations(self) -> int:
        """Number of samples of the commanded motion that violate a limit."""
        return violations(np.stack(self._commands), CYCLE_S)

    @property
    def _now_s(self) -> float:
        """Return the time at which data of the last cycle reach the controller [s]."""
        return EPOCH_S + self._cycle * CYCLE_S + EVENTS_DELAY_S

    def _step(self) -> None:
        """Advance by one cycle."""
        now_s = EPOCH_S + self._cycle * CYCLE_S
        while self._under_way and self._under_way[0][0] <= now_s:
            arrival_s, t = self._under_way.pop(0)
            trajectory = Trajectory(t.stamp_s, t.times_s, t.q, t.dq, t.ddq)
            self.rejected += self._arm.accept(trajectory, arrival_s) is not None
        command = self._arm.sample(now_s)[0]
        way = self._tip.follow(command, STEPS)
        block = self.grasp.advance(way)
        self._cycle += 1
        self._blocks.append(block)
        self._ways.append(way)
        self._commands.append(command)
        controller, now_s, until_us = self._controller, self._now_s, int(block.t_us[-1])
        controller.on_heartbeat(now_s)
        controller.on_joint_state(self._tip.q.tolist(), now_s)
        self._estimates += self._force.advance(block.events, block.frames, until_us)
        while self._estimates and self._estimates[0].end_us <= until_us - 1e6 * FORCE_AGE_S:
            found = self._estimates.pop(0)
            controller.on_quality('' if found.valid else found.reason.text, now_s)
            controller.on_force(found.force, found.end_us, now_s)
        self._frames += block.frames
        seen_us = 1e6 * (self._cycle * CYCLE_S - GUIDE_DELAY_S)
        while self._frames and self._frames[0].frame_end_us <= seen_us:
            frame = self._frames.pop(0)
            middle = (frame.exposure_start_us + frame.exposure_end_us) // 2
            controller.on_frame(frame.intensity, middle, now_s)
        steps = controller.on_events(block.events, until_us, now_s)
        self.answered_us += [1e6 * (now_s - EPOCH_S)] * len(steps)
        self.steps += steps
        planned = controller.plan(now_s)
        if planned is None and controller.interlock.reason and not self.stopped:
            self.stopped = controller.interlock.reason
            planned = controller.braking(now_s)
        if planned is not None:
            self._under_way.append((now_s + COMMAND_DELAY_S, planned))


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


def arrest_of(
    t_us: NDArray[np.int64], object_mm: Floats, speed_mm_s: Floats, onset_us: float
) -> dict[str, Any]:
    """Return how an object comes to rest after a knock.

    Args:
        t_us: Times [n] [us].
        object_mm: Position of the object [n] [mm].
        speed_mm_s: Speed of the object [n] [mm/s].
        onset_us: Onset of the knock [us].

    Returns:
        `slip_mm`: Displacement from the knock on [mm].
        `arrest_ms`: Time from the knock to rest [ms], None for never.
        `held`: Whether it came to rest, no more than 5 mm lower.
    """
    first = int(np.searchsorted(t_us, onset_us))
    slip = float(object_mm[-1] - object_mm[max(first - 1, 0)])
    moving = np.flatnonzero(speed_mm_s != 0.0)
    last = int(moving[-1]) if len(moving) else first
    stopped = bool(t_us[-1] - t_us[last] >= 1e6 * STILL_S)
    return {
        'slip_mm': slip,
        'arrest_ms': 1e-3 * float(t_us[last] - onset_us) if stopped else None,
        'held': stopped and slip <= HELD_MM,
    }


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
        preset: Difficulty preset of the virtual sensor.
        settings: Settings of the slip controller.
        knock_s: Onset of the knock [s].
        grasp_n: Grasp force for which the object is weighed, to about 5 % [N]; None for the mass
            that is drawn.
        pulse_s: Duration of the impact [s]; None: as long as a falling weight takes.
    """

    name: str = 'box'
    seed: int = 0
    margin: float = 1.05
    knock_mm_s: float | None = None
    preset: str = 'paper_like'
    settings: SlipControlParameters = field(default_factory=SlipControlParameters)
    knock_s: float = KNOCK_S
    grasp_n: float | None = None
    pulse_s: float | None = None

    def grasp(self, knock_s: float, *, camera: bool) -> Grasp:
        """Return the grasp of this trial at its start, with another onset of the knock [s]."""
        setup = draw_setup(
            self.name,
            np.random.default_rng([self.seed, 7]),
            margin=self.margin,
            knock_mm_s=self.knock_mm_s,
            knock_s=knock_s,
        )
        if self.pulse_s is not None:
            setup = replace(setup, pulse_s=self.pulse_s)
        day, rest_s = (self.seed, self.seed, preset(self.preset)), self.knock_s + AFTER_KNOCK_S
        if self.grasp_n is not None:
            # The smallest force that holds grows with the mass.
            drawn = Grasp(setup, *day, camera=False, rest_s=rest_s)
            setup = replace(setup, mass_g=setup.mass_g * self.grasp_n / drawn.grasp_n)
        return Grasp(setup, *day, camera=camera, rest_s=rest_s)

    def uncontrolled(self) -> dict[str, Any]:
        """Return how the object comes to rest while the arm does not move; see `arrest_of`."""
        grasp = self.grasp(EARLY_KNOCK_S, camera=False)
        block = grasp.advance(np.zeros(round((EARLY_KNOCK_S + REST_S) / GRID_S)))
        return arrest_of(block.t_us, block.object_mm, block.speed_mm_s, 1e6 * EARLY_KNOCK_S)


def start_trial(plan: TrialPlan) -> ClosedLoop:
    """Return a trial at the time of enabling; its controller has learned the background."""
    grasp = plan.grasp(plan.knock_s, camera=True)
    loop = ClosedLoop(grasp, plan.settings, SensedForce(grasp, press_gain(plan.seed, plan.preset)))
    loop.run(ENABLE_S)
    return loop


def finish_trial(plan: TrialPlan, loop: ClosedLoop) -> dict[str, Any]:
    """Enable slip control and run a trial to its end.

    Args:
        plan: Settings of the trial; those of the controller may differ from those at the start.
        loop: The trial at the time of enabling.

    Returns:
        Result for JSON. Times are from the onset of the knock [ms], None for never.

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
        `peak_n`: Largest normal force [N].
        `advance_mm`: Advance at the end [mm].
        `false_alarms`: Slips reported before the knock while the object did not move.
        `limit_violations`: Samples of the commanded motion that violate a limit.
        `rejected`: Trajectories rejected by the controller of the arm.
        `stopped`: Reason of an interlock stop; empty without one.

    Raises:
        SlipControlError: The controller could not be enabled.
    """
    grasp, onset_us = loop.grasp, 1e6 * plan.knock_s
    loop.enable(plan.settings)
    loop.run(plan.knock_s + AFTER_KNOCK_S)
    course = loop.course
    t_us, object_mm, normal_n = (course[name] for name in ('t_us', 'object_mm', 'normal_n'))
    answered_us, slipping = np.array(loop.answered_us), np.array([s.slipping for s in loop.steps])
    after = answered_us[slipping & (answered_us > onset_us)]
    ends_us = np.array([step.end_us for step in loop.steps])
    # Slips reported before the knock, and how far the object moved until then.
    alarms = np.diff(slipping.astype(np.int8), prepend=0) > 0
    ends_us = ends_us[alarms & (answered_us < onset_us)]
    then, now = (np.searchsorted(t_us, t) for t in (ends_us - LOOK_BACK_US, ends_us))
    return {
        'name': plan.name,
        'seed': plan.seed,
        'mass_g': grasp.setup.mass_g,
        'knock_mm_s': grasp.setup.knock_mm_s,
        'grasp_n': grasp.grasp_n,
        'knock_share': float(normal_n[np.searchsorted(t_us, onset_us)]) / grasp.grasp_n,
        'stiffness_n_per_mm': grasp.stiffness_n_per_mm,
        'detection_ms': 1e-3 * float(after[0] - onset_us) if len(after) else None,
        **arrest_of(t_us, object_mm, course['speed_mm_s'], onset_us),
        'peak_n': float(normal_n.max()),
        'advance_mm': float(course['advance_mm'][-1]),
        'false_alarms': int(np.count_nonzero(object_mm[now] - object_mm[then] <= MOVED_MM)),
        'limit_violations': loop.violations,
        'rejected': loop.rejected,
        'stopped': loop.stopped,
    }


def _trial(plan: TrialPlan) -> dict[str, Any]:
    """Return the result of a trial.

    `open_held`: Whether the object is held without control. `course_mm`: Displacement at
    `COURSE_MS` [mm].
    """
    loop = start_trial(plan)
    result, course = finish_trial(plan, loop), loop.course
    t_ms = 1e-3 * (course['t_us'] - 1e6 * KNOCK_S)
    way_mm = np.interp([0.0, *COURSE_MS], t_ms, course['object_mm'])
    result['course_mm'] = (way_mm[1:] - way_mm[0]).round(4).tolist()
    return result | {'open_held': plan.uncontrolled()['held']}


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
Results = dict[str, list[dict[str, Any]]]


@experiment
def slip(context: Context) -> Outcome:
    """Slip control of objects that are struck, in closed loop.

    In the paper, cup (20 trials), box (15) and ball (20) are pressed against a wall at the critical
    force and struck by a falling weight. A laser tracker measures the displacement.

    Here everything is simulated: object, gel, friction, arm with the limits and the lag of an FR3,
    delays of USB and network. The flow detector is used, not the count law of the paper.

    The share of the falling weight that reaches the object is random, because the paper does not
    state it; no arm could hold the object against the whole weight.

    The paper's means are over all trials of an object; 13 ms and 0.32 mm are of one box trial, with
    which the median over the boxes is compared.
    """
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
        figures={'Displacement of the boxes; diamond: the paper': path},
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
    figure, (ax,) = new_axes()
    for trial in results.get('box', []):
        ax.plot(COURSE_MS, trial['course_mm'], color=FORCE, lw=0.8)
    ax.plot(PAPER_MS, PAPER_BOX_MM, 'D', color=PAPER, label='paper, one trial')
    ax.set(xlabel='time from the knock [ms]', ylabel='displacement [mm]', title='box, simulated')
    ax.legend(frameon=False, fontsize=8)
    return save_figure(figure, path)
