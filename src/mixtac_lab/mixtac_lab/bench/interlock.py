# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random enablings, slips and faults: whether slip control keeps the arm's limits, and stops.

The whole controller drives an emulated trajectory controller in lock-step, without ROS: learning,
enabling while something still moves, slips, disabling, and in half of the runs a fault. Within the
contract no command may break a limit of the arm and nothing may stop without a cause; a fault must
end in a latched stop. Commands are judged by differences of the positions from cycle to cycle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Annotated, Final

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import progress_bar
from mixtac_cli.options import JsonFile
from mixtac_events.arrays import Events
from mixtac_node.files import write_json
from mixtac_sim.arm.controller import JointTrajectoryController, Trajectory
from mixtac_sim.arm.fr3 import violations
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits, StateChecks
from mixtac_slip_control.arm.planner import AdvancePlanner, StreamSettings
from mixtac_slip_control.arm.trajectory import PlannedTrajectory, settling_trajectory
from mixtac_slip_control.controller import SlipController
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import InterlockState

Floats = NDArray[np.float64]

CYCLE_S: Final = 1e-3
CYCLES_FOR_CONTROLLER: Final = 2
RUNS_PER_ARM: Final = 25
"""Runs of one posture, one after the other, without a pause."""
REST: Final = 30
"""Events of a window without slip."""
FAULTS: Final = ('frozen', 'displaced', 'client', 'late', 'lost', 'heartbeat', 'clock')
"""The arm is held where it is; it is moved by hand; another client moves it; trajectories come
later than the lead; joint states or heartbeats end; the clock of the host goes back."""
ARM_FAULTS: Final = ('frozen', 'displaced', 'client', 'late')
"""Faults that slip control sees by where the arm or its command is."""
AWAY_CYCLES: Final = 60
"""Cycles away from the plan after which joint states must have told of it."""
NOTICE_CYCLES: Final = 600
"""Cycles of slip after a fault within which it must have stopped slip control: the largest age."""
LATE_RAD: Final = 1e-4
"""Deviation of the command from the plan from which a late trajectory is a fault [rad]."""


@dataclass(slots=True)
class InterlockTally:
    """Result of the runs.

    Attributes:
        runs: Number of runs.
        enabled: Enablings.
        refused: Refused ones, while something moved or was missing.
        trajectories: Trajectories sent.
        rejected: Those that the arm's controller rejected within the contract.
        violations: Runs within the contract in which a command broke a limit.
        false_stops: Runs within the contract that were stopped although nothing was wrong.
        aged: Runs within the contract that were stopped because joint states were lost for longer
            than their largest age.
        faults: Runs with a fault that slip control could see, by kind.
        silent: Those of them that did not end in a latched stop, by kind.
        unseen: Runs with a fault that did not leave the plan by more than what is watched, by kind.
        sent_after: Trajectories sent for an arm elsewhere after it was found.
        broken: Runs with a fault in which a command broke a limit, by kind.
    """

    runs: int = 0
    enabled: int = 0
    refused: int = 0
    trajectories: int = 0
    rejected: int = 0
    violations: int = 0
    false_stops: int = 0
    aged: int = 0
    faults: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FAULTS, 0))
    silent: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FAULTS, 0))
    unseen: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FAULTS, 0))
    sent_after: int = 0
    broken: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FAULTS, 0))


def interlock(
    runs: Annotated[int, typer.Option(min=1, help='Number of random runs.')] = 2_000,
    seed: Annotated[int, typer.Option(min=0, help='Random seed.')] = 1,
    json: JsonFile = None,
) -> None:
    """Enable slip control at random, with slips and faults; count broken limits, silent faults."""
    console = Console(markup=False)
    with progress_bar('runs', runs, console) as advance:
        tally = asdict(run_enablings(runs, seed, advance))
    console.print_json(data=tally)
    write_json(json, {'seed': seed} | tally)
    failed = tally['violations'] + tally['false_stops'] + tally['rejected'] + tally['sent_after']
    if failed + sum(tally['silent'].values()):
        raise typer.Exit(1)


def run_enablings(
    count: int, seed: int, advance: Callable[[], object] = lambda: None
) -> InterlockTally:
    """Play random runs on the FR3.

    Args:
        count: Number of runs.
        seed: Random seed.
        advance: Called after each run.
    """
    rng = np.random.default_rng(seed)
    joints, kinematics = JointLimits.fr3(), SerialArm.fr3()
    checks = StateChecks(kinematics, joints)
    tally = InterlockTally()
    while tally.runs < count:
        q = rng.uniform(joints.lower, joints.upper)
        if checks.check(q) is not None:
            continue
        arm = _Arm(q, rng, tally)
        for _ in range(min(RUNS_PER_ARM, count - tally.runs)):
            if not arm.run():
                break
            advance()
    return tally


class _Arm:
    """One arm with its controller and slip control, over many runs.

    Args:
        q: Joint positions at the start [7] [rad].
        rng: Draws everything.
        tally: Counts.
    """

    def __init__(self, q: Floats, rng: np.random.Generator, tally: InterlockTally) -> None:
        self._rng, self._tally = rng, tally
        self._reports = bool(rng.random() < 0.5)
        short = self._reports and rng.random() < 0.5
        self._settings = SlipControlParameters(
            detector='count',
            learning_time=0.1,
            settle_time=0.005,
            settling_time=float(rng.uniform(0.05, 0.1)),
            lead=3e-3 if short else 6e-3,
            gain=float(rng.uniform(0.2, 5.0)),
            max_step=float(10.0 ** rng.uniform(-5.0, -3.0)),
            max_total=float(rng.choice([1e-3, 2e-3, 5e-3])),
            back_off=float(10.0 ** rng.uniform(-5.0, -2.0)),
            hold_time=0.2,
            max_force=50.0,
            stiffest_contact=2e3,
            probe_advance=float(rng.choice([0.0, 5e-5])),
        )
        self._release = 'humble' if rng.random() < 0.5 else 'jazzy'
        self._controller_phase_s = float(rng.random()) * CYCLE_S
        self._keep = float(np.exp(-CYCLE_S / rng.uniform(5e-4, 1e-2)))
        self._sag = rng.normal(0.0, 1e-3, 7).clip(-2e-3, 2e-3)
        self._normal = rng.normal(size=3)
        room = self._settings.lead - CYCLES_FOR_CONTROLLER * CYCLE_S
        self._transport_s = room * float(rng.random() ** 0.5)
        self._state_every = int(rng.choice([1, 2, 4, 10]))
        self._dropped = float(rng.choice([0.0, 0.2, 0.6 if self._state_every < 10 else 0.2]))
        self._start = q
        self._restart()

    def run(self) -> bool:
        """Play one run: enable, slips, perhaps a fault, disable; return whether it was possible."""
        rng, tally = self._rng, self._tally
        if not self._enable():
            return False
        fault = str(rng.choice(FAULTS)) if rng.random() < 0.5 else ''
        first = len(self._commands)
        self._play(int(rng.integers(5, 120)), slip=0.1)
        if fault and self._controller.enabled:
            self._begin(fault)
            self._play(NOTICE_CYCLES, slip=0.3, until_stopped=True)
            self._judge_fault(fault, first)
            self._restart()
            return True
        self._end_run(first)
        tally.runs += 1
        return True

    def _judge_fault(self, fault: str, first: int) -> None:
        tally = self._tally
        stopped = self._controller.interlock.state is InterlockState.STOPPED
        tally.runs += 1
        seen = stopped or fault not in ARM_FAULTS or self._deviates
        tally.faults[fault] += seen
        tally.unseen[fault] += not seen
        tally.silent[fault] += seen and not stopped
        self._play(30)
        tally.broken[fault] += self._broken(first) > 0

    def _end_run(self, first: int) -> None:
        """Disable somewhere in the motion, and look at what happened."""
        rng, tally, controller = self._rng, self._tally, self._controller
        reason = controller.interlock.reason
        if controller.interlock.state is InterlockState.STOPPED:
            aged = 'joint states' in reason
            tally.aged += aged
            tally.false_stops += not aged
        if rng.random() < 0.7:
            controller.disable()
        self._play(int(rng.integers(1, 40)))
        tally.violations += self._broken(first) > 0

    def _enable(self) -> bool:
        """Enable as soon as it is allowed, asking all the time."""
        controller, p = self._controller, self._settings
        for _ in range(1500):
            if controller.enabled:
                return True
            if controller.interlock.state is InterlockState.STOPPED:
                try:
                    controller.reset(self._now_s)
                except SlipControlError:
                    self._tally.refused += 1
            following = controller.following
            commanded = following.commanded(self._now_s) if following is not None else None
            settling_s = 0.0 if commanded is not None else p.settling_time
            try:
                controller.enable(self._now_s, commanded=commanded, settling_s=settling_s)
            except SlipControlError:
                self._tally.refused += 1
            else:
                self._tally.enabled += 1
                self._moving = True
                if commanded is None and controller.watch.joints is not None:
                    joints = np.array(controller.watch.joints)
                    self._post(settling_trajectory(KINEMATICS, joints, self._now_s, settling_s))
                return True
            self._play(int(self._rng.integers(1, 8)))
        return False  # a posture from which the largest advance cannot be reached

    def _restart(self) -> None:
        """Stand still at the start with new software, as after a person has looked at it."""
        p = self._settings
        stream = StreamSettings(lead_s=p.lead)
        self._planner = AdvancePlanner(KINEMATICS, LIMITS, stream)
        self._controller = SlipController(p, self._planner, self._normal.tolist())
        self._trajectory_controller = JointTrajectoryController(
            1.0 / CYCLE_S, release='humble' if self._release == 'humble' else 'jazzy'
        )
        self._cycle = 0
        self._trajectory_controller.reset(self._start, START_S + self._controller_phase_s)
        self._tip = self._start.copy()
        self._commands: list[Floats] = []
        self._under_way: list[tuple[float, PlannedTrajectory]] = []
        self._states: list[tuple[float, float, Floats]] = []
        self._fault, self._offset, self._moving, self._back_s = '', np.zeros(7), False, 0.0
        self._found_elsewhere = self._deviates = False
        self._away = 0
        self._play(110)

    @property
    def _now_s(self) -> float:
        return START_S + self._cycle * CYCLE_S + 4e-4 - self._back_s

    def _begin(self, fault: str) -> None:
        """Let a fault begin now."""
        rng = self._rng
        self._fault = fault
        if fault == 'displaced':
            self._offset = rng.choice([-1.0, 1.0], 7) * 10.0 ** rng.uniform(-2.0, -0.5, 7)
        elif fault == 'clock':
            self._back_s = float(10.0 ** rng.uniform(-2.5, 0.0))
        elif fault == 'client':
            target = self._commands[-1] + rng.uniform(0.01, 0.05) * rng.choice([-1.0, 1.0], 7)
            rest = np.zeros((1, 7))
            t = Trajectory(self._true_s, np.array([1.0]), target[None], rest, rest)
            self._trajectory_controller.accept(t, self._true_s)

    @property
    def _true_s(self) -> float:
        return START_S + self._cycle * CYCLE_S + 4e-4

    def _look(self, command: Floats, stamp_s: float) -> None:
        """Note whether arm or command have left the plan, which slip control could see."""
        path, p = self._planner.path, self._settings
        if path is None or not self._controller.enabled:
            return
        low, high = (self._planner.advance_at(stamp_s + late_s) for late_s in (-0.03, 0.002))
        ends = min(low, high), max(low, high)
        places = [path.derivatives(each)[0] for each in ends]
        slope = path.derivatives(ends[0])[1]
        bend = np.abs(places[1] - places[0])
        if self._reports:
            away = np.minimum(*(np.abs(command - each) for each in places))
            self._deviates |= bool((away - bend).max() > LATE_RAD)
        off = self._tip + self._offset - places[0]
        along = float(slope @ off) / float(slope @ slope)
        beyond = max(-along, along - (ends[1] - ends[0]), 0.0) > 1.2 * p.max_following_error
        across = float(np.abs(off - slope * along).max()) > 1.2 * p.max_displacement
        self._away = self._away + 1 if beyond or across else 0
        self._deviates |= self._away > AWAY_CYCLES

    def _play(self, cycles: int, slip: float = 0.0, *, until_stopped: bool = False) -> None:
        """Play cycles, with slips at a rate per window that last for some."""
        rng, left = self._rng, 0
        for _ in range(cycles):
            if until_stopped and self._controller.interlock.state is InterlockState.STOPPED:
                return
            if left == 0 and rng.random() < slip * 0.2:
                left = int(rng.integers(2, 40))
            left = max(left - 1, 0)
            self._step(int(rng.integers(200, 4000)) if left else int(rng.poisson(REST)))

    def _step(self, count: int) -> None:
        """Go on by a cycle of the arm's controller and a window of slip control."""
        true_s = self._true_s
        while self._under_way and self._under_way[0][0] <= true_s:
            arrival_s, t = self._under_way.pop(0)
            trajectory = Trajectory(t.stamp_s, t.times_s, t.q, t.dq, t.ddq)
            rejected = self._trajectory_controller.accept(trajectory, arrival_s) is not None
            self._tally.rejected += rejected and not self._fault
        command = self._trajectory_controller.sample(true_s)[0]
        self._commands.append(command)
        if self._fault != 'frozen':
            self._tip = command + self._keep * (self._tip - command)
        if self._fault in ARM_FAULTS:
            self._look(command, true_s)
        self._report(command, true_s)
        self._cycle += 1
        self._answer(count)

    def _report(self, command: Floats, true_s: float) -> None:
        """Tell slip control where the arm is and what its controller commands."""
        rng, controller, now_s = self._rng, self._controller, self._now_s
        if self._cycle % self._state_every == 0 and rng.random() >= self._dropped:
            late_s = float(rng.random() ** 4) * 0.014
            q = self._tip + self._sag + self._offset + rng.normal(0.0, 1e-5, 7)
            self._states.append((true_s + late_s, true_s - self._back_s, q))
        due = [each for each in self._states if each[0] <= true_s]
        self._states = [each for each in self._states if each[0] > true_s]
        if self._fault != 'lost':
            for _, stamp_s, q in due:
                controller.on_joint_state(q.tolist(), now_s, stamp_s)
        if self._reports:
            stamp_s = START_S + self._controller_phase_s + CYCLE_S * self._controller_cycle
            controller.on_commanded(command.tolist(), stamp_s - self._back_s, now_s)

    @property
    def _controller_cycle(self) -> int:
        """Return the number of the latest cycle of the arm's controller."""
        return int((self._true_s - START_S - self._controller_phase_s) / CYCLE_S + 1e-9)

    def _answer(self, count: int) -> None:
        """Let slip control answer a window, as its node does."""
        controller, now_s = self._controller, self._now_s
        if self._fault != 'heartbeat':
            controller.on_heartbeat(now_s)
        end_us = 1000 * self._cycle
        if self._cycle % 2 == 0:
            force = 1.0 + 500.0 * self._planner.advance_at(now_s - 0.005)
            controller.on_force(force, end_us - 3000, now_s)
        t = end_us - 1000 + np.arange(count, dtype=np.int64) * 1000 // max(count, 1)
        place = np.zeros(count, np.uint16)
        controller.on_events(Events(t, place, place, np.ones(count, np.bool_)), end_us, now_s)
        self._post(controller.plan(now_s))
        if self._moving and not controller.enabled:
            self._moving = False
            following = controller.following
            self._found_elsewhere = following is not None and bool(following.lost)
            braking = controller.braking(now_s)
            self._tally.sent_after += self._found_elsewhere and braking is not None
            self._post(braking)

    def _post(self, trajectory: PlannedTrajectory | None) -> None:
        if trajectory is None:
            return
        self._tally.trajectories += 1
        delay_s = self._transport_s * float(self._rng.random())
        if self._fault == 'late':
            delay_s = self._settings.lead + float(self._rng.uniform(2e-3, 12e-3))
        arrival_s = self._true_s + delay_s
        if self._under_way:
            arrival_s = max(arrival_s, self._under_way[-1][0])
        self._under_way.append((arrival_s, trajectory))

    def _broken(self, first: int) -> int:
        """Return how many commands since one broke a limit."""
        return violations(np.stack(self._commands[max(first - 3, 0) :]), CYCLE_S)


START_S: Final = 100.0
KINEMATICS: Final = SerialArm.fr3()
LIMITS: Final = JointLimits.fr3()
