# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip trials: an object, a knock, the result, and summaries and figures of many of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mixtac_events.arrays import Events
from mixtac_lab.slip.loop import ArmReach, ArmSetup, ClosedLoop, Transport, arrest_of, best_arrest
from mixtac_lab.store import digest
from mixtac_sim.arm.fr3 import READY
from mixtac_sim.grasp.grasp import Grasp
from mixtac_sim.grasp.objects import ObjectName, draw_setup
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.world.effects import preset
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner, StreamSettings
from mixtac_slip_control.parameters import SlipControlParameters

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from mixtac_lab.slip.loop import LoopRecord
    from mixtac_lab.store import Kept


KNOCK_S = 1.45
"""When the blow comes [s]: the background has been learned, the arm is enabled."""
ENABLE_S = 1.1
LOOK_BACK_US = 20_000
MOVED_MM = 5e-3
"""Moved by more in the look-back, an object has slipped by itself: held with little margin, some do
before the blow [mm]."""
SECONDS = 1.8


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
    settings: SlipControlParameters = field(default_factory=SlipControlParameters)

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
        planner.reset(READY, np.array(self.arm.normal), self.settings.max_total)
        motion = planner.motion_limits
        assert motion is not None  # noqa: S101  (known after a reset with a normal)
        lag = 0.0 if ideal else self.arm.tracking.lag_s
        force = self.settings.max_force
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


def quantiles(values: Iterable[float]) -> dict[str, float | None]:
    """Return median and 99th percentile of the numbers among some values; a NaN is a miss.

    A miss is later than everything, so that a percentile that falls on one is None.
    """
    array = np.array(list(values), np.float64)
    late = np.where(np.isfinite(array), array, np.inf)
    if not len(late):
        return {'p50': None, 'p99': None}
    found = np.quantile(late, [0.5, 0.99], method='higher')
    p50, p99 = (round(float(v), 3) if np.isfinite(v) else None for v in found)
    return {'p50': p50, 'p99': p99}


def summary(results: Sequence[TrialResult]) -> dict[str, Any]:
    """Return the figures of some trials for JSON."""
    count = len(results)
    return {
        'trials': count,
        'held_fraction': round(sum(r.held for r in results) / count, 4),
        'open_loop_held_fraction': round(sum(r.open_held for r in results) / count, 4),
        'slip_mm': {
            'mean': _mean(r.slip_mm for r in results),
            **_median(r.slip_mm for r in results),
        },
        'arrest_ms': _median(r.arrest_ms for r in results),
        'floor_slip_mm': _median(r.floor_mm for r in results),
        'floor_arrest_ms': _median(r.floor_ms for r in results),
        'chain_floor_slip_mm': _median(r.chain_mm for r in results),
        'chain_floor_arrest_ms': _median(r.chain_ms for r in results),
        'detection_ms': quantiles(r.detection_ms for r in results),
        'count_ms': quantiles(r.count_ms for r in results),
        'flow_ms': quantiles(r.flow_ms for r in results),
        'publish_ms': quantiles(r.publish_ms for r in results),
        'knock_mm_s': _median(r.knock_mm_s for r in results),
        'stiffness_n_per_mm': _median(r.stiffness_n_per_mm for r in results),
        'grasp_n': _median(r.grasp_n for r in results),
        'knock_share': _median(r.knock_share for r in results),
        'peak_n': _median(r.peak_n for r in results),
        'false_alarms': sum(r.false_alarms for r in results),
        'limit_violations': sum(r.limit_violations for r in results),
        'rejected': sum(r.rejected for r in results),
        'stopped': sum(bool(r.stopped) for r in results),
    }


def _mean(values: Iterable[float]) -> float:
    return round(float(np.mean(list(values))), 4)


def _median(values: Iterable[float]) -> dict[str, float | None]:
    """Return the median and the range in which 80 % lie."""
    array = np.array(list(values), np.float64)
    good = array[np.isfinite(array)]
    if not len(good):
        return {'median': None, 'p10': None, 'p90': None}
    low, middle, high = np.quantile(good, [0.1, 0.5, 0.9])
    return {
        'median': round(float(middle), 3),
        'p10': round(float(low), 3),
        'p90': round(float(high), 3),
    }


CURVE_MS: Final = np.arange(-10.0, 81.0)
"""Times of the curve from the begin of the blow [91] [ms]."""


def kept_trial(plan: TrialPlan, kept: Kept) -> tuple[TrialResult, NDArray[np.float64]]:
    """Return the result of a trial and the object's place at `CURVE_MS` [91] [mm].

    Args:
        plan: What it fixes.
        kept: Holds the trials that were run before.

    Raises:
        SlipControlError: The controller could not be enabled.
    """

    def measure() -> dict[str, Any]:
        result, record = run_trial(plan)
        return {'result': result.as_dict(), 'curve': place_curve(record).round(5).tolist()}

    entry = kept.get(f'trial {plan.name} {plan.seed} {digest(plan)}', measure)
    return TrialResult(**entry['result']), np.array(entry['curve'])


def place_curve(record: LoopRecord) -> NDArray[np.float64]:
    """Return the object's place at `CURVE_MS` from where the blow met it [91] [mm]."""
    t_ms = 1e-3 * record.t_us - 1e3 * KNOCK_S
    start = np.interp(0.0, t_ms, record.object_mm)
    return np.asarray(np.interp(CURVE_MS, t_ms, record.object_mm) - start)


SPAN_MS = (-10.0, 80.0)
KEY_MS = (-5.0, 0.0)
"""Begins of the first two key frames from the onset [ms]; the last is where the object stands."""
FRAME_MS = 5.0
"""Time over which a key frame collects events [ms]."""


def draw_trial(path: Path, result: TrialResult, record: LoopRecord) -> None:
    """Draw displacement, force, counts and three key frames of a trial.

    Args:
        path: Where the figure goes.
        result: What came of the trial.
        record: What happened in it.
    """
    figure = Figure(figsize=(9.0, 7.0), layout='constrained')
    grid = figure.add_gridspec(3, 3)
    t_ms = 1e-3 * record.t_us - 1e3 * KNOCK_S
    seen = (t_ms >= SPAN_MS[0]) & (t_ms <= SPAN_MS[1])
    start = record.object_mm[np.searchsorted(t_ms, 0.0)]
    place = figure.add_subplot(grid[0, :2])
    place.plot(t_ms[seen], record.object_mm[seen] - start)
    place.set(ylabel='object [mm], downwards', title=f'{result.name}, simulated')
    _counts(figure.add_subplot(grid[1, :2]), record)
    force = figure.add_subplot(grid[0, 2])
    force.plot(t_ms[seen], record.normal_n[seen])
    force.set(ylabel='normal force [N]')
    advance = figure.add_subplot(grid[1, 2])
    advance.plot(t_ms[seen], record.advance_mm[seen])
    advance.set(xlabel='after the blow [ms]', ylabel='fingertip [mm]')
    last = result.arrest_ms if np.isfinite(result.arrest_ms) else SPAN_MS[1]
    for k, at in enumerate((*KEY_MS, last)):
        _key_frame(figure.add_subplot(grid[2, k]), record, at)
    _save(figure, path)


def draw_objects(
    path: Path, curves: Mapping[str, Sequence[NDArray[np.float64]]], paper_mm: Mapping[str, float]
) -> None:
    """Draw the way of every object after the blow, one panel per kind.

    Args:
        path: Where the figure goes.
        curves: Place at `CURVE_MS` of each trial [91] [mm], by kind.
        paper_mm: Mean displacement in the paper [mm], by kind.
    """
    figure = Figure(figsize=(4.0 * len(curves), 3.4), layout='constrained')
    axes = figure.subplots(1, len(curves), squeeze=False)[0]
    for ax, (name, ways) in zip(axes, curves.items(), strict=True):
        for way in ways:
            ax.plot(CURVE_MS, way, color='tab:blue', alpha=0.3, linewidth=0.8)
        ax.plot(CURVE_MS, np.mean(ways, axis=0), color='tab:blue', label='mean')
        ax.axhline(paper_mm[name], color='tab:gray', linestyle=':', label="the paper's mean")
        ax.set(xlabel='after the blow [ms]', title=f'{name}, {len(ways)} trials, simulated')
        ax.legend()
    axes[0].set_ylabel('displacement [mm]')
    _save(figure, path)


def draw_curves(path: Path, curves: Mapping[str, Any]) -> None:
    """Draw latency against false alarms of both detectors, one panel per speed.

    Args:
        path: Where the figure goes.
        curves: Of `mixtac_lab.slip.detectors.curves`.
    """
    figure = Figure(figsize=(4.0 * len(curves), 3.6), layout='constrained')
    axes = figure.subplots(1, len(curves), squeeze=False)[0]
    for ax, (speed, both) in zip(axes, curves.items(), strict=True):
        for name, curve in both.items():
            late = [np.nan if v is None else v for v in curve['latency_ms']]
            (line,) = ax.plot(np.array(curve['false_alarms_per_min']) + 0.01, late, label=name)
            shipped = curve['shipped']
            if shipped['latency_p50_ms'] is not None:
                at = shipped['false_alarms_per_min'] + 0.01, shipped['latency_p50_ms']
                ax.plot(*at, 'o', color=line.get_color(), label=f'{name}, shipped')
        ax.set(xscale='log', xlabel='false alarms per minute + 0.01', ylabel='median latency [ms]')
        ax.set_title(f'{speed.replace("_mm_s", " mm/s")}, simulated')
        ax.legend()
    _save(figure, path)


def _counts(ax: Axes, record: LoopRecord) -> None:
    t_ms = 1e-3 * np.array([step.end_us for step in record.steps]) - 1e3 * KNOCK_S
    seen = (t_ms >= SPAN_MS[0]) & (t_ms <= SPAN_MS[1])
    ax.step(t_ms[seen], np.array([s.count for s in record.steps])[seen], label='events per ms')
    threshold = np.array([s.threshold for s in record.steps])
    ax.step(t_ms[seen], threshold[seen], label='threshold of the count law')
    ax.set(xlabel='after the blow [ms]')
    ax.legend()


def _key_frame(ax: Axes, record: LoopRecord, at_ms: float) -> None:
    """Show the events of a few milliseconds."""
    first = 1e6 * KNOCK_S + 1e3 * at_ms
    events = Events.concatenate(record.events)
    chosen = events[
        int(np.searchsorted(events.t, first)) : int(
            np.searchsorted(events.t, first + 1e3 * FRAME_MS)
        )
    ]
    ax.imshow(_picture(chosen), cmap='gray', vmin=-1, vmax=1)
    ax.set(xticks=[], yticks=[], title=f'{at_ms:.0f} to {at_ms + FRAME_MS:.0f} ms')


def _picture(events: Events) -> NDArray[np.float64]:
    """Return ON less OFF events per pixel [260, 346]."""
    picture = np.zeros((HEIGHT, WIDTH))
    np.add.at(picture, (events.y, events.x), np.where(events.polarity, 1.0, -1.0))
    return picture


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=120)
