# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random slips, states and delays: whether the planned stream keeps the limits of the arm.

The caller provides the trajectory controller, so that it can be an emulation written
independently of the planner. Its commands are judged as an arm sees them: by differences of the
positions from cycle to cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import MAX_ADVANCE, AdvancePlanner
from mixtac_slip_control.errors import ArmError, UnreachableError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from mixtac_slip_control.arm.planner import StreamSettings
    from mixtac_slip_control.arm.trajectory import PlannedTrajectory

    Floats = NDArray[np.float64]


CYCLE_S = 1e-3
SLACK = 1e-6
"""Share by which rounding may exceed a limit."""
CYCLES_FOR_CONTROLLER = 2
"""Of the lead, that the controller takes itself; the rest may go into transport."""


class Controller(Protocol):
    """A trajectory controller with a cycle of 1 ms, such as mixtac_sim's emulation."""

    def reset(self, q: Floats, now_s: float) -> None:
        """Hold joint positions (n,) [rad]; the first cycle is at this time [s]."""

    def accept(self, trajectory: PlannedTrajectory, now_s: float) -> str | None:
        """Receive a trajectory at a time [s]; return why it is rejected, or None."""

    def sample(self, t_s: float) -> tuple[Floats, Floats, Floats]:
        """Return what is commanded (n,) [rad], [rad/s], [rad/s2] in the cycle of a time [s]."""


@dataclass(slots=True)
class TrialTally:
    """What trials led to; the worst values are shares of the limit, 1 at the limit.

    Attributes:
        trials: Sequences played.
        trajectories: Trajectories sent.
        rejected: Of these, refused by the controller.
        refused: Plans that the planner did not make.
        position: Commands outside a joint's range.
        velocity: Worst velocity.
        acceleration: Worst acceleration.
        jerk: Worst jerk.
        moving: Sequences that did not end at rest at the target.
        violations: Sequences that broke any limit, were rejected or did not end at rest.
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


def run_trials(
    count: int,
    seed: int,
    controllers: tuple[Callable[[], Controller], ...],
    per_state: int = 20,
    settings: StreamSettings | None = None,
) -> TrialTally:
    """Play random sequences on the FR3 and judge every command.

    Args:
        count: Number of sequences.
        seed: Of everything random.
        controllers: Makers of controllers, taken in turn.
        per_state: Sequences from each joint state and normal drawn.
        settings: Of the planner.
    """
    rng = np.random.default_rng(seed)
    arm, limits = SerialArm.fr3(), JointLimits.fr3()
    planner = AdvancePlanner(arm, limits, settings)
    tally = TrialTally()
    while tally.trials < count:
        q = rng.uniform(limits.lower, limits.upper)
        normal = rng.normal(size=3)
        try:
            planner.reset(q, normal)
        except UnreachableError:
            continue
        for _ in range(min(per_state, count - tally.trials)):
            planner.restart()
            controller = controllers[tally.trials % len(controllers)]()
            trial = _Trial(planner, controller, normal, rng)
            trial.play(int(rng.integers(10, 80)))
            _judge(trial, limits, tally)
    tally.refused = planner.refused
    return tally


class _Trial:
    """One sequence: windows of counts ask for advances; trajectories arrive late.

    Args:
        planner: Planner, just reset.
        controller: Controller to drive.
        normal: Direction of the advance (3,).
        rng: Source of counts, delays and phases.
    """

    def __init__(
        self,
        planner: AdvancePlanner,
        controller: Controller,
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
        """Let controller cycles and arrivals happen in their order up to a time [s]."""
        while self._cycle_s <= until_s:
            self._deliver(self._cycle_s)
            self.commands.append(np.stack(self._controller.sample(self._cycle_s)))
            self._cycle_s = self._cycle_s + CYCLE_S
        self._deliver(until_s)
        self._now_s = until_s

    def _deliver(self, until_s: float) -> None:
        while self._on_the_way and self._on_the_way[0][0] <= until_s:
            arrival, trajectory = self._on_the_way.pop(0)
            self.rejected += self._controller.accept(trajectory, arrival) is not None


def _judge(trial: _Trial, limits: JointLimits, tally: TrialTally) -> None:
    states = np.array(trial.commands)
    q = np.concatenate([np.repeat(trial.q[None], 3, axis=0), states[:, 0]])
    steps = [np.diff(q, n, axis=0) / CYCLE_S**n for n in (1, 2, 3)]
    bounds = [limits.velocity_bounds(position) for position in states[:, 0]]
    lowest, highest = (np.array([b[k] for b in bounds]) for k in (0, 1))
    speed = np.maximum(np.maximum(states[:, 1], 0) / highest, np.minimum(states[:, 1], 0) / lowest)
    velocity = max(float(speed.max()), float((np.abs(steps[0]) / limits.velocity).max()))
    accelerations = np.concatenate([np.abs(steps[1]), np.abs(states[:, 2])])
    acceleration = float((accelerations / limits.acceleration).max())
    jerk = float((np.abs(steps[2]) / limits.jerk).max())
    outside = int(((states[:, 0] < limits.lower) | (states[:, 0] > limits.upper)).any(1).sum())
    moving = bool(np.abs(states[-1, 1:]).max() > 1e-9) or not _arrived(trial, states[-1, 0])
    tally.trials += 1
    tally.trajectories += trial.sent
    tally.rejected += trial.rejected
    tally.position += outside
    tally.velocity = max(tally.velocity, velocity)
    tally.acceleration = max(tally.acceleration, acceleration)
    tally.jerk = max(tally.jerk, jerk)
    tally.moving += moving
    # Written so that NaN is a violation.
    within = max(velocity, acceleration, jerk) <= 1.0 + SLACK
    tally.violations += not within or outside > 0 or moving or trial.rejected > 0


def _arrived(trial: _Trial, q: Floats) -> bool:
    path = trial.planner.path
    if path is None:
        raise ArmError('the planner of this trial has no path: reset it with a normal')
    return bool(np.abs(path.derivatives(trial.planner.target)[0] - q).max() < 1e-9)
