# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Grasp, sensor, slip controller, trajectories and arm in lock-step, 1 ms at a time.

The loop is faster than real time and reproducible. `TRANSPORT_S` holds the delays that the real
chain adds between the parts. `best_arrest` returns the
lower bound that no controller can beat: the same grasp and knock with the best motion of the arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixtac_events.arrays import Events
from mixtac_fger.estimator import Estimate
from mixtac_lab.slip.sensing import SensedForce
from mixtac_sim.arm import (
    READY,
    TRACKING_LAG_S,
    JointTrajectoryController,
    LaggingArm,
    Trajectory,
    violations,
)
from mixtac_sim.grasp.grasp import Grasp, GraspBlock
from mixtac_sim.grids import STEP_US
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.controller import SlipController, SlipStep
from mixtac_slip_control.parameters import SlipControlParameters

Floats = NDArray[np.float64]
GRID_S = 1e-6 * STEP_US
AFTER_S = 0.3
"""Time for the object to come to rest [s]."""


@dataclass(frozen=True, slots=True)
class ArmReach:
    """Limits of the arm along the contact normal.

    Attributes:
        acceleration: Largest acceleration [m/s2].
        jerk: Largest jerk [m/s3].
        lag_s: Time constant of its tracking [s].
        max_force_n: Force at which the advance must end [N].
    """

    acceleration: float
    jerk: float
    lag_s: float
    max_force_n: float


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


HELD_MM = 5.0
"""An object that slips farther is lost [mm]: the contact of the fingertip is 12 mm wide."""
STILL_S = 0.02
"""Time without motion that counts as rest [s]."""


def arrest_of(
    t_us: NDArray[np.int64],
    object_mm: Floats,
    speed_mm_s: Floats,
    onset_us: float,
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


def best_arrest(grasp: Grasp, reach: ArmReach, delay_s: float) -> Arrest:
    """Return the arrest by the fastest motion to the force limit, started after a delay.

    Args:
        grasp: A new grasp without a camera.
        reach: Limits of the arm.
        delay_s: Time from the onset of the knock to the start of the commanded motion [s].
    """
    knock = round(grasp.setup.knock_s / GRID_S)
    count = knock + round(AFTER_S / GRID_S)
    distance = (reach.max_force_n - grasp.grasp_n) / grasp.stiffness_n_per_mm
    way = np.zeros(count)
    begin = knock + round(delay_s / GRID_S)
    way[begin:] = fastest_way(max(distance, 0.0), reach, count - begin)
    block = grasp.advance(way)
    return arrest_of(block.t_us, block.object_mm, block.speed_mm_s, 1e6 * grasp.setup.knock_s)


def fastest_way(distance_mm: float, reach: ArmReach, count: int) -> Floats:
    """Return the fastest rest-to-rest motion within acceleration and jerk, lagged [count] [mm].

    Full acceleration, then full braking, each with jerk-limited ramps: the convolution of a
    bang-bang motion with a window of the length of a ramp. Sampled every 125 us.
    """
    t = (np.arange(count) + 1) * GRID_S
    half_s = np.sqrt(1e-3 * distance_mm / reach.acceleration)
    rising = 0.5e3 * reach.acceleration * t**2
    falling = distance_mm - 0.5e3 * reach.acceleration * np.maximum(2.0 * half_s - t, 0.0) ** 2
    way = np.where(t < half_s, rising, falling)
    width = max(round(reach.acceleration / reach.jerk / GRID_S), 1)
    smooth = np.convolve(np.append(np.zeros(width - 1), way), np.full(width, 1.0 / width), 'valid')
    if reach.lag_s <= 0.0:
        return np.asarray(smooth)
    keep, place = np.exp(-GRID_S / reach.lag_s), 0.0
    for k, wanted in enumerate(smooth):
        place = wanted + keep * (place - wanted)
        smooth[k] = place
    return np.asarray(smooth)


CYCLE_S = 1e-3
STEPS = 8
"""Grid steps of the grasp per cycle."""
EPOCH_S = 100.0
"""Controller time at the start [s]; a stamp of zero has another meaning."""
SIDEWAYS = (0.0, 1.0, 0.0)
"""Contact normal in the base frame; the arm is fastest in this direction at the ready pose."""
FORCE_EVERY = 2
"""Cycles per estimate of the force: 500 Hz."""
FORCE_NOISE_N = 0.03
"""Standard deviation of an estimate of the force [N]."""
FRAME_DELAY_S = 4e-3
"""Time from the end of the readout of a frame to its guide [s]."""


TRANSPORT_S = {'events_s': 0.7e-3, 'command_s': 0.8e-3, 'force_s': 3e-3}
"""Delays between the parts [s]: from the end of a window to the controller (USB, driver and DDS),
from the answer of the controller to the trajectory at the arm, and the age of a force estimate."""


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
        published_us: Times at which trajectories were published [p].
        rejected: Trajectories that the arm's controller rejected.
        violations: Samples of the commanded motion that violate a limit.
        stopped: Reason of an interlock stop; empty without one.
        events: Events of each cycle [c].
    """

    t_us: NDArray[np.int64]
    object_mm: Floats
    speed_mm_s: Floats
    normal_n: Floats
    advance_mm: Floats
    answered_us: Floats
    steps: list[SlipStep]
    published_us: Floats
    rejected: int
    violations: int
    stopped: str
    events: list[Events]


class ClosedLoop:
    """One run of the loop.

    Args:
        grasp: The grasp, with a camera.
        settings: Settings of the slip controller.
        lag_s: Time constant with which the arm follows its commands [s].
        seed: Seed of the noise of the true force, where that is what the controller gets.
        force: The sensor's own force; None for the true one with `FORCE_NOISE_N`.
        mass_g: Mass of the object [g] at a time [s]; None for that of the grasp.
    """

    def __init__(
        self,
        grasp: Grasp,
        settings: SlipControlParameters,
        lag_s: float = TRACKING_LAG_S,
        seed: int = 0,
        force: SensedForce | None = None,
        mass_g: Callable[[float], float] | None = None,
    ) -> None:
        self._grasp, self._force, self._mass_g = grasp, force, mass_g
        self._estimates: list[Estimate] = []
        self._arm = JointTrajectoryController(1.0 / CYCLE_S)
        self._arm.reset(READY, EPOCH_S)
        planner = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3(), settings.lead)
        self._controller = SlipController(settings, planner, SIDEWAYS)
        self._tip = LaggingArm(READY, np.array(SIDEWAYS), lag_s, CYCLE_S)
        self._rng = np.random.default_rng(seed)
        self._under_way: list[tuple[float, PlannedTrajectory]] = []
        self._frames: list[ApsFrame] = []
        self._cycle, self._rejected, self._stopped = 0, 0, ''
        self._blocks: list[GraspBlock] = []
        self._ways: list[Floats] = []
        self._commands: list[Floats] = []
        self._answered: list[float] = []
        self._steps: list[SlipStep] = []
        self._published: list[float] = []

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
        return self._record()

    @property
    def _now_s(self) -> float:
        """Return the time at which data of the last cycle reach the controller [s]."""
        return EPOCH_S + self._cycle * CYCLE_S + TRANSPORT_S['events_s']

    def _step(self) -> None:
        """Advance by one cycle."""
        now_s = EPOCH_S + self._cycle * CYCLE_S
        due = [item for item in self._under_way if item[0] <= now_s]
        self._under_way = self._under_way[len(due) :]
        for arrival_s, t in due:
            trajectory = Trajectory(t.stamp_s, t.times_s, t.q, t.dq, t.ddq)
            self._rejected += self._arm.accept(trajectory, arrival_s) is not None
        command = self._arm.sample(now_s)[0]
        way = self._tip.follow(command, STEPS)
        if self._mass_g is not None:
            self._grasp.weigh(self._mass_g(self._cycle * CYCLE_S))
        block = self._grasp.advance(way)
        self._cycle += 1
        self._blocks.append(block)
        self._ways.append(way)
        self._commands.append(command)
        self._send_inputs(block)
        self._send_events(block)

    def _send_inputs(self, block: GraspBlock) -> None:
        """Pass the slower inputs to the controller."""
        controller = self._controller
        now_s, now_us = self._now_s, 1e6 * self._cycle * CYCLE_S
        controller.on_heartbeat(now_s)
        controller.on_joint_state(self._tip.q.tolist(), now_s)
        if self._force is not None:
            self._send_estimates(self._force, block)
        elif self._cycle % FORCE_EVERY == 0:
            past = max(len(self._blocks) - 1 - round(TRANSPORT_S['force_s'] / CYCLE_S), 0)
            force = float(self._blocks[past].normal_n[-1]) + self._rng.normal(0.0, FORCE_NOISE_N)
            controller.on_force(force, int(self._blocks[past].t_us[-1]), now_s)
        self._frames += block.frames
        while self._frames and self._frames[0].frame_end_us + 1e6 * FRAME_DELAY_S <= now_us:
            frame = self._frames.pop(0)
            middle = (frame.exposure_start_us + frame.exposure_end_us) // 2
            controller.on_frame(frame.intensity, middle, now_s)

    def _send_estimates(self, force: SensedForce, block: GraspBlock) -> None:
        """Pass what the sensor tells, as late as it is told."""
        now_s, until_us = self._now_s, int(block.t_us[-1])
        self._estimates += force.advance(block.events, block.frames, until_us)
        told_us = until_us - 1e6 * TRANSPORT_S['force_s']
        while self._estimates and self._estimates[0].end_us <= told_us:
            found = self._estimates.pop(0)
            self._controller.on_quality('' if found.valid else found.reason.text, now_s)
            self._controller.on_force(found.force, found.end_us, now_s)

    def _send_events(self, block: GraspBlock) -> None:
        """Pass the events to the controller and send its trajectories."""
        controller, now_s = self._controller, self._now_s
        steps = controller.on_events(block.events, int(block.t_us[-1]), now_s)
        now_us = 1e6 * (now_s - EPOCH_S)
        self._answered += [now_us] * len(steps)
        self._steps += steps
        planned = controller.plan(now_s)
        if planned is None and controller.interlock.reason and not self._stopped:
            self._stopped = controller.interlock.reason
            planned = controller.braking(now_s)
        if planned is not None:
            self._under_way.append((now_s + TRANSPORT_S['command_s'], planned))
            self._published.append(now_us)

    def _record(self) -> LoopRecord:
        blocks = self._blocks
        return LoopRecord(
            t_us=np.concatenate([b.t_us for b in blocks]),
            object_mm=np.concatenate([b.object_mm for b in blocks]),
            speed_mm_s=np.concatenate([b.speed_mm_s for b in blocks]),
            normal_n=np.concatenate([b.normal_n for b in blocks]),
            advance_mm=np.concatenate(self._ways),
            answered_us=np.array(self._answered),
            steps=self._steps,
            published_us=np.array(self._published),
            rejected=self._rejected,
            violations=violations(np.stack(self._commands), CYCLE_S),
            stopped=self._stopped,
            events=[b.events for b in blocks],
        )
