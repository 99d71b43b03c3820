# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random slips, states and delays: whether the planned stream keeps the limits of the arm.

The trajectories go to emulations of ros2_control's trajectory controller at 1 kHz, one for each way
in which it interpolates, written independently of the planner. Their commands are judged as an arm
does: by differences of the positions from cycle to cycle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import progress_bar
from mixtac_cli.options import JsonFile
from mixtac_node.files import write_json
from mixtac_sim.arm.controller import JointTrajectoryController, Release, Trajectory
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import MAX_ADVANCE, AdvancePlanner, StreamSettings
from mixtac_slip_control.arm.trajectory import PlannedTrajectory
from mixtac_slip_control.errors import ArmError, UnreachableError

Floats = NDArray[np.float64]


CYCLE_S = 1e-3
SLACK = 1e-6
"""Share of a limit that rounding may exceed."""
CYCLES_FOR_CONTROLLER = 2
"""Cycles of the lead that the controller needs; the rest is for transport."""
PER_STATE = 20
"""Sequences from each random joint state and normal."""
RELEASES: tuple[Release, ...] = ('jazzy', 'humble')


@dataclass(slots=True)
class TrialTally:
    """Result of trials; the worst values are shares of the limit, 1 at the limit.

    Attributes:
        trials: Number of sequences played.
        trajectories: Number of trajectories sent.
        rejected: Number of trajectories rejected by the controller.
        refused: Number of plans that the planner refused.
        position: Number of commands outside the range of a joint.
        velocity: Worst velocity.
        acceleration: Worst acceleration.
        jerk: Worst jerk.
        moving: Number of sequences that did not end at rest at the target.
        violations: Number of sequences that violated a limit, were rejected or did not end at rest.
    """

    trials: int = 0
    trajectories: int = 0
    rejected: int = 0
    refused: int = 0
    position: int = 0
    velocity: float = 0.0
    acceleration: float = 0.0
    jerk: float = 0.0
    moving: int = 0
    violations: int = 0


def limits(
    trials: Annotated[int, typer.Option(min=1, help='Number of random sequences.')] = 10_000,
    seed: Annotated[int, typer.Option(min=0, help='Random seed.')] = 1,
    json: JsonFile = None,
) -> None:
    """Send random slips through planner and arm controller; count violated joint limits."""
    console = Console(markup=False)
    with progress_bar('sequences', trials, console) as advance:
        tally = asdict(run_trials(trials, seed, advance=advance))
    console.print_json(data=tally)
    write_json(json, {'seed': seed} | tally)
    if tally['violations']:
        raise typer.Exit(1)


def run_trials(
    count: int,
    seed: int,
    releases: tuple[Release, ...] = RELEASES,
    settings: StreamSettings | None = None,
    advance: Callable[[], object] = lambda: None,
) -> TrialTally:
    """Play random sequences on the FR3 and check every command.

    Args:
        count: Number of sequences.
        seed: Random seed.
        releases: Releases of ros2_control to emulate, in turn.
        settings: Settings of the planner.
        advance: Called after each sequence.
    """
    rng = np.random.default_rng(seed)
    joints = JointLimits.fr3()
    planner = AdvancePlanner(SerialArm.fr3(), joints, settings)
    tally = TrialTally()
    while tally.trials < count:
        q = rng.uniform(joints.lower, joints.upper)
        normal = rng.normal(size=3)
        try:
            planner.reset(q, normal)
        except UnreachableError:
            continue
        for _ in range(min(PER_STATE, count - tally.trials)):
            planner.restart()
            release = releases[tally.trials % len(releases)]
            controller = JointTrajectoryController(1.0 / CYCLE_S, release=release)
            trial = _Trial(planner, controller, normal, rng)
            trial.play(int(rng.integers(10, 80)))
            _judge(trial, joints, tally)
            advance()
    tally.refused = planner.refused
    return tally


class _Trial:
    """One sequence: windows of counts request advances; trajectories arrive late.

    Args:
        planner: Planner, just reset.
        controller: Controller of the arm.
        normal: Direction of the advance (3,).
        rng: Random counts, delays and phases.
    """

    def __init__(
        self,
        planner: AdvancePlanner,
        controller: JointTrajectoryController,
        normal: Floats,
        rng: np.random.Generator,
    ) -> None:
        self.planner = planner
        self.q = planner.start
        self.commands: list[Floats] = []
        self.rejected = self.sent = 0
        self._controller = controller
        self._normal = normal
        self._rng = rng
        self._start_s = 10.0
        self._now_s = self._start_s
        self._cycle_s = self._start_s + float(rng.random()) * CYCLE_S
        controller.reset(self.q, self._cycle_s)
        lead_s = planner.settings.lead_s - CYCLES_FOR_CONTROLLER * CYCLE_S
        self._worst_delay_s = lead_s * float(rng.random() ** 0.5)
        self._on_the_way: list[tuple[float, PlannedTrajectory]] = []

    def play(self, windows: int) -> None:
        """Play counting windows of 1 ms, then let the arm come to rest."""
        rng, limit = self._rng, MAX_ADVANCE
        gain = 10.0 ** rng.uniform(-9.0, -5.5)
        advance, ends_s, slipping = 0.0, self._now_s, False
        for _ in range(windows):
            slipping ^= rng.random() < (0.3 if slipping else 0.1)
            excess = rng.poisson(100.0 if slipping else 5.0) - 20
            advance += gain * max(excess, 0)
            if rng.random() < 0.03:
                advance = rng.random() * limit * 10.0 ** rng.uniform(-4.0, 0.0)
            advance = min(advance, limit)
            self._run(self._now_s + CYCLE_S * (0.5 + rng.random()))
            if rng.random() < 0.02:
                trajectory = self.planner.stop(self._now_s)
                advance = min(max(self.planner.target, 0.0), limit)
            else:
                trajectory = self.planner.plan(self._now_s, advance, self._normal)
            if trajectory is not None:
                self.sent += 1
                ends_s = max(ends_s, trajectory.end_s)
                self._post(trajectory)
        self._run(max(ends_s, self._now_s) + 0.02)

    def _post(self, trajectory: PlannedTrajectory) -> None:
        arrival = self._now_s + float(self._rng.random()) * self._worst_delay_s
        if self._on_the_way:
            arrival = max(arrival, self._on_the_way[-1][0])
        self._on_the_way.append((arrival, trajectory))

    def _run(self, until_s: float) -> None:
        """Run controller cycles and arrivals in their order up to a time [s]."""
        while self._cycle_s <= until_s:
            self._deliver(self._cycle_s)
            self.commands.append(np.stack(self._controller.sample(self._cycle_s)))
            self._cycle_s = self._cycle_s + CYCLE_S
        self._deliver(until_s)
        self._now_s = until_s

    def _deliver(self, until_s: float) -> None:
        while self._on_the_way and self._on_the_way[0][0] <= until_s:
            arrival, t = self._on_the_way.pop(0)
            trajectory = Trajectory(t.stamp_s, t.times_s, t.q, t.dq, t.ddq)
            self.rejected += self._controller.accept(trajectory, arrival) is not None


def _judge(trial: _Trial, joints: JointLimits, tally: TrialTally) -> None:
    states = np.array(trial.commands)
    q = np.concatenate([np.repeat(trial.q[None], 3, axis=0), states[:, 0]])
    steps = [np.diff(q, n, axis=0) / CYCLE_S**n for n in (1, 2, 3)]
    bounds = [joints.velocity_bounds(position) for position in states[:, 0]]
    lowest, highest = (np.array([b[k] for b in bounds]) for k in (0, 1))
    speed = np.maximum(np.maximum(states[:, 1], 0) / highest, np.minimum(states[:, 1], 0) / lowest)
    velocity = max(float(speed.max()), float((np.abs(steps[0]) / joints.velocity).max()))
    accelerations = np.concatenate([np.abs(steps[1]), np.abs(states[:, 2])])
    acceleration = float((accelerations / joints.acceleration).max())
    jerk = float((np.abs(steps[2]) / joints.jerk).max())
    outside = int(((states[:, 0] < joints.lower) | (states[:, 0] > joints.upper)).any(1).sum())
    moving = bool(np.abs(states[-1, 1:]).max() > 1e-9) or not _arrived(trial, states[-1, 0])
    tally.trials += 1
    tally.trajectories += trial.sent
    tally.rejected += trial.rejected
    tally.position += outside
    tally.velocity = max(tally.velocity, velocity)
    tally.acceleration = max(tally.acceleration, acceleration)
    tally.jerk = max(tally.jerk, jerk)
    tally.moving += moving
    # NaN counts as a violation.
    within = max(velocity, acceleration, jerk) <= 1.0 + SLACK
    tally.violations += not within or outside > 0 or moving or trial.rejected > 0


def _arrived(trial: _Trial, q: Floats) -> bool:
    path = trial.planner.path
    if path is None:
        raise ArmError('the planner of this trial has no path', remedy='reset it with a normal')
    return bool(np.abs(path.derivatives(trial.planner.target)[0] - q).max() < 1e-9)
