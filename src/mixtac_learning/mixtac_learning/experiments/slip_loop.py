# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Grasp, sensor, slip controller, trajectories and arm in lock-step, 1 ms at a time.

The loop is faster than real time and reproducible. The delays that the real chain adds between the
parts are constants. The force is the estimate of the simulated sensor, calibrated as a user would
calibrate it. A grasp begins with the object already held, so the no-contact reference and the gains
are measured before it: the reference in still frames of the same day without contact, and the gains
on other days, elsewhere on the gel, by a press with known forces and a mass on a thread, as in
`calibrate-force --sideways-loads`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.recordings.messages import left_aligned
from mixtac_fger.estimator import Estimate, open_estimator
from mixtac_fger.fger_net import CALIBRATED_DEVIATION, with_gain
from mixtac_fger.force_calibration import (
    PULL,
    ForceCalibration,
    ForceCalibrationError,
    find_plateaus,
    fit_gain,
    last_contact,
    load_of,
    sideways_gain,
)
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_learning.judge.estimators import TrialEstimate, stream
from mixtac_learning.trials.trial import SimulatedSource
from mixtac_sim.arm import (
    READY,
    JointTrajectoryController,
    LaggingArm,
    Trajectory,
    violations,
)
from mixtac_sim.grasp.grasp import Grasp, GraspBlock
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.world.plans import TrialSpec
from mixtac_sim.world.profiles import PULL_WAYS, PULLED_G
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.controller import SlipController, SlipStep
from mixtac_slip_control.parameters import SlipControlParameters

Floats = NDArray[np.float64]
ANOTHER_DAY = 1_000_000
"""Added to the seed of a trial for the days of press and pull."""
PRESS_S = 6.0
"""Length of the press [s]."""
PULLS_S = 24.0
"""Length of the trial with the mass on a thread [s]."""
LOAD_SD_G = 1.0
"""Standard uncertainty of the mass [g]."""
TOUCHED_N = 0.05
"""True force from which on a window counts for a gain [N]."""
ENCODED_US = 8_000
"""Time from the end of the readout of a frame until the estimator has encoded it [us]."""


@cache
def _model() -> Model:
    return with_gain(read_model(find_model(DEFAULT_MODEL)), 1.0, CALIBRATED_DEVIATION)


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of a sensor.

    Attributes:
        normal: Of the normal force, which counts for all axes.
        sideways: Further gain of the sideways force, expected by the known pulls at other places.
    """

    normal: float = 1.0
    sideways: float = 1.0


@lru_cache(maxsize=16)
def calibrate(device_seed: int, seed: int, preset: str) -> Gains:
    """Return the gains that a press and pulls with known forces give.

    Args:
        device_seed: Seed of the sensor.
        seed: Seed of the trial that is to follow: press and pulls are of other days.
        preset: Difficulty preset of the sensor.
    """

    def measured(profile: str, days: int, seconds: float, normal: float) -> TrialEstimate:
        spec = TrialSpec(device_seed, seed + days * ANOTHER_DAY, profile, seconds, preset)
        return stream(_model(), SimulatedSource(spec).load(), force_scale=normal)

    press = measured('press', 1, PRESS_S, 1.0)
    known, force = (each[press.known > TOUCHED_N] for each in (press.known, press.force))
    both = float((known * force).sum())
    normal = both / float((force**2).sum()) if both > 0.0 else 1.0
    pulls = measured('pulls', 2, PULLS_S, normal)
    if pulls.across is None:
        return Gains(normal)
    t_s = 1e-6 * (pulls.t_us - pulls.t_us[0])
    try:
        fit = fit_sideways(t_s, pulls.force, pulls.across[:, :2])
    except ForceCalibrationError:
        return Gains(normal)
    return Gains(normal, sideways_gain(fit, 1.0)[0])


def fit_sideways(t_s: Floats, force: Floats, across: Floats) -> ForceCalibration:
    """Return the gain of the sideways force by a trial of the profile `pulls`.

    Args:
        t_s: Time of each estimate [s], [T].
        force: Normal force [N], [T].
        across: Sideways force x and y [N], [T, 2].

    Raises:
        ForceCalibrationError: The sensor cannot be calibrated so.
    """
    _, contact = last_contact(t_s, force)
    loads = [load_of(PULLED_G, LOAD_SD_G)] * len(PULL_WAYS)
    aside = across[contact] @ np.array([1.0, 1.0j])
    return fit_gain(loads, find_plateaus(t_s[contact], aside, len(loads), PULL), PULL)


class SensedForce:
    """Estimates force and shear in a grasp; its reference is from the time before the contact.

    Args:
        grasp: The grasp at its start.
        gains: Of the sensor.
    """

    def __init__(self, grasp: Grasp, gains: Gains) -> None:
        self.estimator = ForceEstimator(
            open_estimator(_model()),
            assume_free=True,
            force_scale=gains.normal,
            sideways_scale=gains.sideways,
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


@dataclass(frozen=True, slots=True, eq=False)
class LoopRecord:
    """A whole run; times are true time [us] since the start.

    Attributes:
        t_us: Times on a grid of 125 us [n].
        object_mm: Position of the object, downwards [n] [mm].
        speed_mm_s: Speed of the object [n] [mm/s].
        normal_n: Normal force [n] [N].
        advance_mm: Position of the fingertip [n] [mm].
        answered_us: Time of the answer to each window [m].
        steps: Answer of the controller to each window [m].
        rejected: Trajectories that the arm's controller rejected.
        violations: Samples of the commanded motion that violate a limit.
        stopped: Reason of an interlock stop; empty without one.
    """

    t_us: NDArray[np.int64]
    object_mm: Floats
    speed_mm_s: Floats
    normal_n: Floats
    advance_mm: Floats
    answered_us: Floats
    steps: list[SlipStep]
    rejected: int
    violations: int
    stopped: str


class ClosedLoop:
    """One run of the loop.

    Args:
        grasp: The grasp, with a camera.
        settings: Settings of the slip controller.
        force: The sensor's force.
    """

    def __init__(self, grasp: Grasp, settings: SlipControlParameters, force: SensedForce) -> None:
        self._grasp, self._force = grasp, force
        self._estimates: list[Estimate] = []
        self._arm = JointTrajectoryController()
        self._arm.reset(READY, EPOCH_S)
        planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3(), settings.lead)
        self._controller = SlipController(settings, planner, SIDEWAYS)
        self._tip = LaggingArm(READY, np.array(SIDEWAYS))
        self._under_way: list[tuple[float, PlannedTrajectory]] = []
        self._frames: list[ApsFrame] = []
        self._cycle, self._rejected, self._stopped = 0, 0, ''
        self._blocks: list[GraspBlock] = []
        self._ways: list[Floats] = []
        self._commands: list[Floats] = []
        self._answered: list[float] = []
        self._steps: list[SlipStep] = []

    def run(self, seconds: float, enable_s: float) -> LoopRecord:
        """Run to a time and return the record.

        Args:
            seconds: Length [s].
            enable_s: Time at which the controller is enabled [s]; it must have learned its
                background by then.

        Raises:
            SlipControlError: The controller cannot be enabled.
        """
        enabled = False
        while self._cycle * CYCLE_S < seconds - 1e-9:
            self._step()
            if not enabled and self._cycle * CYCLE_S >= enable_s - 1e-9:
                self._controller.enable(self._now_s)
                enabled = True
        blocks = self._blocks
        return LoopRecord(
            t_us=np.concatenate([b.t_us for b in blocks]),
            object_mm=np.concatenate([b.object_mm for b in blocks]),
            speed_mm_s=np.concatenate([b.speed_mm_s for b in blocks]),
            normal_n=np.concatenate([b.normal_n for b in blocks]),
            advance_mm=np.concatenate(self._ways),
            answered_us=np.array(self._answered),
            steps=self._steps,
            rejected=self._rejected,
            violations=violations(np.stack(self._commands), CYCLE_S),
            stopped=self._stopped,
        )

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
            self._rejected += self._arm.accept(trajectory, arrival_s) is not None
        command = self._arm.sample(now_s)[0]
        way = self._tip.follow(command, STEPS)
        block = self._grasp.advance(way)
        self._cycle += 1
        self._blocks.append(block)
        self._ways.append(way)
        self._commands.append(command)
        self._send_inputs(block)
        self._send_events(block)

    def _send_inputs(self, block: GraspBlock) -> None:
        """Pass the slower inputs to the controller."""
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

    def _send_events(self, block: GraspBlock) -> None:
        """Pass the events to the controller and send its trajectories."""
        controller, now_s = self._controller, self._now_s
        steps = controller.on_events(block.events, int(block.t_us[-1]), now_s)
        self._answered += [1e6 * (now_s - EPOCH_S)] * len(steps)
        self._steps += steps
        planned = controller.plan(now_s)
        if planned is None and controller.interlock.reason and not self._stopped:
            self._stopped = controller.interlock.reason
            planned = controller.braking(now_s)
        if planned is not None:
            self._under_way.append((now_s + COMMAND_DELAY_S, planned))
