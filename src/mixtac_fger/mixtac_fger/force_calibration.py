# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gain of a sensor from known loads: plateaus of a force series, a fit, and its checks.

No image shows how stiff a gel is, so the estimate e of an uncalibrated sensor is off by a factor.
Known loads F_i are put on one after the other. Each holds long enough for a plateau; the mean of
the estimate there, less the zero before and after it, is e_i. The model of the fit is

    F_i = g * e_i + r_i,    Var r_i = s_i^2 + g^2 (n_i^2 + z_i^2) + (m F_i)^2

with the stated uncertainty s_i of the load, the noise n_i of the mean, the uncertainty z_i of the
zero, and the part m by which the estimate differs from load to load: place, object, history. The
line goes through the origin, because the zero is known:

    g = sum(w_i F_i e_i) / sum(w_i e_i^2),    w_i = 1 / Var r_i,
    sd(g)^2 = max(1, chi^2 / (n - 1)) / sum(w_i e_i^2),    chi^2 = sum(w_i r_i^2).

Nothing here needs ROS: a live sensor and a recording give the same series.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mixtac_events.errors import MixtacError

F64 = NDArray[np.float64]
Reason = Literal[
    'contact',
    'rocking',
    'creep',
    'zero',
    'units',
    'loads',
    'few',
    'order',
    'changed',
    'pull',
    'slid',
    'ways',
]
REMEDIES: dict[Reason, str] = {
    'contact': 'put it on the middle of the gel, and nothing else',
    'rocking': 'let it rest, do not touch the table, and try again',
    'creep': 'use smaller loads, let the gel rest for a minute, and let the lamp warm up',
    'zero': 'fasten it, tare, start over, and leave it alone for 2 s after each load',
    'units': 'give grams: 50 for a weight of 50 g, which is 0.49 N',
    'loads': 'check the grams of each load and that nothing else touches the gel',
    'few': 'give two loads or more, such as 20,50,100',
    'order': 'name each load that was put on, in this order, or record again',
    'changed': 'look at gel, lamp and mount, then calibrate it again',
    'pull': 'pull at what presses, straight and level, while it presses',
    'slid': 'press harder or pull less: a fifth of the load that presses is enough',
    'ways': 'pull towards +x, to the right in the image, and +y, upwards in the image',
}
GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""


class ForceCalibrationError(MixtacError):
    """Loads or a force series by which a sensor cannot be calibrated.

    Args:
        message: What is wrong, with the value.
        reason: See below.
        remedy: What the user can do about it, where that is not the one of the reason.

    Attributes:
        reason: `contact` (no load arrived), `rocking` (not held still), `creep`, `zero` (the
            sensor moved), `units` (a gain that no gel explains), `loads` (they disagree), `few`
            (too few loads), `order` (more plateaus than loads), `changed` (a check failed), `pull`
            (none arrived), `slid` (what presses slid aside) or `ways` (other directions).
    """

    def __init__(self, message: str, reason: Reason, remedy: str = '') -> None:
        super().__init__(message, remedy=remedy or REMEDIES[reason])
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Load:
    """A known force.

    Attributes:
        force_n: Normal force [N].
        sd_n: Its standard uncertainty [N].
    """

    force_n: float
    sd_n: float

    @property
    def grams(self) -> float:
        """The mass of this weight [g]."""
        return 1e3 * self.force_n / GRAVITY


def load_of(grams: float, sd_grams: float) -> Load:
    """Return the load of a mass and its standard uncertainty, in grams."""
    return Load(1e-3 * GRAVITY * grams, 1e-3 * GRAVITY * sd_grams)


BIN_S = 0.04
"""The series is averaged over these steps [s]; frames correct the estimate as often."""
REACH_S = 0.4
"""Means over this time are compared, so far before and after a moment [s]."""
STEADY_N = 0.02
"""Change between them up to which the force is steady [N] (estimate)."""
STEADY_PART = 0.08
"""The same, as a part of the force (estimate)."""
SHORTEST_S = 0.8
"""Shortest steady stretch [s]."""
LONGEST_S = 4.0
"""More of a stretch is not used [s]: a gel creeps."""
CONTACT_N = 0.04
"""Estimates further than this from zero are contact [N] (estimate)."""


class Stretch(NamedTuple):
    """A steady stretch of a force series.

    Attributes:
        start_s: Its start [s].
        end_s: Its end [s].
        mean_n: Mean force [N].
        sd_n: Standard deviation of the means over `BIN_S` about a line [N].
        error_n: Standard error of the mean [N].
        creep_n_per_s: Slope of that line [N/s].
    """

    start_s: float
    end_s: float
    mean_n: float
    sd_n: float
    error_n: float
    creep_n_per_s: float


def steady_stretches(t_s: F64, force_n: F64) -> list[Stretch]:
    """Return the stretches in which a force is steady, in the order of time.

    Steady is where the means over `REACH_S` before and after a moment are equal, but for a slow
    creep. The ends of a change are thus left out by themselves. Before its start and after its end
    the series is taken to go on as it is there. A gap in it ends a stretch.

    Args:
        t_s: Times, increasing [s].
        force_n: Forces at these times [N].
    """
    return [stretch for (stretch,) in steady_together(t_s, force_n)]


def steady_together(t_s: F64, *series: F64) -> list[tuple[Stretch, ...]]:
    """Return the stretches in which several series are steady at once, one of each; as above."""
    reach = round(REACH_S / BIN_S)
    binned_series = [binned(t_s, each) for each in series]
    times = binned_series[0][0]
    if len(times) < reach:
        return []
    steady = np.ones(len(times), np.bool_)
    for _, means in binned_series:
        ends = [np.full(reach, part.mean()) for part in (means[: reach // 2], means[-reach // 2 :])]
        # A gap makes NaN of all that it touches, which is never steady.
        moving = sliding_window_view(np.concatenate([ends[0], means, ends[1]]), reach).mean(axis=1)
        before, after = moving[: -reach - 1], moving[reach + 1 :]
        level = np.maximum(np.abs(before), np.abs(after))
        steady &= np.abs(after - before) <= np.maximum(STEADY_N, STEADY_PART * level)
    return [
        tuple(stretch_of(times[a:b], means[a:b]) for _, means in binned_series)
        for a, b in _long_runs(steady)
    ]


def _long_runs(where: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return start and end of the runs of steps that are long enough for a steady stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], where.astype(np.int8), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a >= SHORTEST_S / BIN_S]


LONGEST_GAP_S = 3600.0
"""Longest time without an estimate; more, or a step back, is a clock that jumped."""


def binned(t_s: F64, force_n: F64) -> tuple[F64, F64]:
    """Return the middles of steps of `BIN_S` and the mean force in each, NaN where there is none.

    A series with long gaps should be cut before: the steps between are all there.

    Raises:
        ForceCalibrationError: Time goes back, or jumps.
    """
    if not len(t_s):
        return np.zeros(0), np.zeros(0)
    steps = np.diff(t_s)
    if steps.min(initial=0.0) < 0.0 or steps.max(initial=0.0) > LONGEST_GAP_S:
        jump = float(steps[np.abs(steps).argmax()])
        raise ForceCalibrationError(
            f'the clock of the camera jumped by {jump:+.1f} s',
            'zero',
            'look at the log for a reconnection of the camera, and begin again',
        )
    index = ((t_s - t_s[0]) / BIN_S).astype(np.int64)
    count = np.bincount(index)
    with np.errstate(invalid='ignore'):
        means = np.bincount(index, force_n) / np.where(count > 0, count, np.nan)
    # The last step may have just begun.
    return (t_s[0] + BIN_S * (np.arange(len(means)) + 0.5))[:-1], means[:-1]


def stretch_of(times: F64, means: F64) -> Stretch:
    """Describe a run of steps of which each is there, as of `binned`; ten of them or more."""
    kept = slice(0, round(LONGEST_S / BIN_S))
    times, means = times[kept], means[kept]
    slope, _ = np.polyfit(times - times.mean(), means, 1)
    rest = means - means.mean() - slope * (times - times.mean())
    # Steps err together for as long as the estimate remembers: blocks of REACH_S do less so.
    block = round(REACH_S / BIN_S)
    blocks = rest[: len(rest) // block * block].reshape(-1, block).mean(axis=1)
    error = max(blocks.std(), rest.std() / np.sqrt(block)) / np.sqrt(len(blocks))
    fields = (times[0], times[-1], means.mean(), rest.std(ddof=2), error, slope)
    return Stretch(*map(float, fields))


@dataclass(frozen=True, slots=True)
class Plateau:
    """The estimate under one load.

    Attributes:
        start_s: Start of the stretch that was used [s].
        end_s: Its end [s].
        estimate_n: Mean estimate above zero [N].
        sd_n: Standard deviation about a line [N]: hand, noise.
        error_n: Standard uncertainty of the estimate, that of the zero included [N].
        creep_n_per_s: Slope [N/s].
        zero_shift_n: Zero after the load less zero before it [N]; NaN where one is not known.
        unloading: It was reached from a larger load.
    """

    start_s: float
    end_s: float
    estimate_n: float
    sd_n: float
    error_n: float
    creep_n_per_s: float
    zero_shift_n: float = float('nan')
    unloading: bool = False


ROCKING_N, ROCKING_PART = 0.03, 0.06
"""Larger deviations about the line of a plateau are a load that moves [N], [part] (estimate)."""
CREEP_N_PER_S, CREEP_PART_PER_S = 0.01, 0.05
"""Larger slopes of a plateau are no rest [N/s], [1/s] (estimate)."""
ZERO_N, ZERO_PART = 0.03, 0.10
"""Larger differences of the zero before and after are a sensor that moved [N], [part]."""


def plateau_of(
    load: Stretch, before: Stretch, after: Stretch | None, *, unloading: bool = False
) -> Plateau:
    """Return the plateau of a load, measured from the zero before and after it.

    Args:
        load: Steady stretch with the load on.
        before: Steady stretch without a load, before.
        after: The same, after; None where the load is still on.
        unloading: It was reached from a larger load.

    Raises:
        ForceCalibrationError: No contact is seen, the load moves or creeps, or the zero is not
            back.
    """
    zeros = [before] if after is None else [before, after]
    zero = float(np.mean([each.mean_n for each in zeros]))
    # Between two zeros it may have walked in any way.
    walked = 0.0 if after is None else after.mean_n - before.mean_n
    errors = [load.error_n, *(each.error_n / len(zeros) for each in zeros), walked / np.sqrt(12.0)]
    force = load.mean_n - zero
    where = f'the plateau at {load.start_s:.1f} to {load.end_s:.1f} s'
    if force < CONTACT_N:
        raise no_contact(f'the estimate changes by {force:.3f} N only under the load')
    if load.sd_n > max(ROCKING_N, ROCKING_PART * force):
        raise ForceCalibrationError(
            f'{where} has a standard deviation of {load.sd_n:.3f} N at {force:.3f} N: the load is'
            ' still rocking',
            'rocking',
        )
    if abs(load.creep_n_per_s) > max(CREEP_N_PER_S, CREEP_PART_PER_S * force):
        raise ForceCalibrationError(
            f'{where} changes by {load.creep_n_per_s:+.3f} N/s at {force:.3f} N: creep dominates',
            'creep',
        )
    if abs(walked) > max(ZERO_N, ZERO_PART * force):
        raise zero_lost(before.mean_n, zeros[-1].mean_n)
    return Plateau(
        load.start_s,
        load.end_s,
        force,
        load.sd_n,
        float(np.hypot.reduce(errors)),
        load.creep_n_per_s,
        float('nan') if after is None else walked,
        unloading,
    )


def no_contact(found: str) -> ForceCalibrationError:
    """Return the refusal of a load that never arrived; `found` is what was seen."""
    return ForceCalibrationError(f'{found}: no load arrived, or it lies off the gel', 'contact')


def zero_lost(before_n: float, after_n: float) -> ForceCalibrationError:
    """Return the refusal of a sensor that reads another zero after a load than before [N]."""
    return ForceCalibrationError(
        f'the sensor reads {after_n:.3f} N after a load and read {before_n:.3f} N before it: it'
        ' was moved, something still touches it, or it had no time to recover',
        'zero',
    )


def find_plateaus(t_s: F64, force_n: F64, loads: Sequence[Load]) -> list[Plateau]:
    """Find the plateaus of loads in a recording of the whole procedure.

    It begins and ends without a load. A smaller load may follow a larger one without a release.

    Args:
        t_s: Times, increasing [s].
        force_n: Estimates before the calibration [N].
        loads: The loads in their order; empty where they are not known.

    Raises:
        ForceCalibrationError: A plateau cannot be used, or their number is not that of the loads.
    """
    stretches = steady_stretches(t_s, force_n)
    if not stretches:
        raise unsteady(t_s, force_n)
    zero = stretches[0].mean_n
    touched = [abs(each.mean_n - zero) > CONTACT_N for each in stretches]
    plateaus: list[Plateau] = []
    for index in _chosen(stretches, touched):
        free = [i for i, contact in enumerate(touched) if not contact]
        before = stretches[max(i for i in free if i < index)]
        after = next((stretches[i] for i in free if i > index), None)
        if after is None:
            last = stretches[index]
            raise ForceCalibrationError(
                f'the estimate does not come to rest near zero after the load at {last.start_s:.1f}'
                f' to {last.end_s:.1f} s; at the end it is'
                f' {float(binned(t_s, force_n)[1][-5:].mean()):.3f} N',
                'zero',
            )
        unloading = touched[index - 1] and stretches[index - 1].mean_n > stretches[index].mean_n
        plateaus.append(plateau_of(stretches[index], before, after, unloading=unloading))
    if not plateaus or 0 < len(plateaus) < len(loads):
        raise unsteady(t_s, force_n, stretches)
    if loads and len(plateaus) > len(loads):
        raise ForceCalibrationError(f'{len(plateaus)} plateaus for {len(loads)} loads', 'order')
    return plateaus


SAME_PART = 0.15
"""Stretches of one contact that differ by less are one load that was touched (estimate)."""


def _chosen(stretches: Sequence[Stretch], touched: Sequence[bool]) -> list[int]:
    """Return which stretches are plateaus: of those of one load, the longest."""
    chosen: list[int] = []
    for index, stretch in enumerate(stretches):
        if not touched[index]:
            continue
        same = (
            chosen
            and chosen[-1] == index - 1
            and abs(stretches[index - 1].mean_n - stretch.mean_n) < SAME_PART * abs(stretch.mean_n)
        )
        if not same:
            chosen.append(index)
        elif _length(stretch) > _length(stretches[chosen[-1]]):
            chosen[-1] = index
    return chosen


def _length(stretch: Stretch) -> float:
    return stretch.end_s - stretch.start_s


def unsteady(t_s: F64, force_n: F64, known: Sequence[Stretch] = ()) -> ForceCalibrationError:
    """Return why a load made no plateau: it crept, it rocked, or there was none.

    Args:
        t_s: Times [s].
        force_n: Estimates [N].
        known: Where the force is steady; the first is without a load.
    """
    times, means = binned(t_s, force_n)
    reach_s = 2.0 * REACH_S
    loose = np.abs(means - (known[0].mean_n if known else 0.0)) > CONTACT_N
    for each in known:
        loose &= (times < each.start_s - reach_s) | (times > each.end_s + reach_s)
    runs = _long_runs(loose)
    if not runs:
        return no_contact('no further contact is seen' if known else 'no contact is seen')
    start, stop = max(runs, key=lambda run: run[1] - run[0])
    part, at_s = means[start:stop], times[start:stop]
    # The flanks of a load are no part of what it does.
    flank = len(part) // 6
    part, at_s = part[flank : len(part) - flank], at_s[flank : len(at_s) - flank]
    slope, offset = np.polyfit(at_s, part, 1)
    swing = float((part - offset - slope * at_s).std())
    drift = float(abs(slope) * np.ptp(at_s))
    where = f'the force is never steady from {times[start]:.1f} to {times[stop - 1]:.1f} s'
    if drift > 4.0 * swing:
        text = f'{where}; it changes by {slope:+.3f} N/s: creep dominates'
        return ForceCalibrationError(text, 'creep')
    return ForceCalibrationError(
        f'{where}; it swings by {swing:.3f} N: the load is still rocking',
        'rocking',
        f'keep each load still for {2 * reach_s + SHORTEST_S:.0f} s or more',
    )


MODEL_PART = 0.03
"""Standard deviation of the estimate from load to load, as a part of it (simulated: 0.02)."""
OUTLIER = 3.0
"""Residuals beyond so many standard deviations are loads that disagree."""
DOUBT = 2.0
"""Residuals beyond so many are worth a second look."""
GAINS = (0.2, 5.0)
"""Limits of a gain that a gel can explain (estimate)."""
FEWEST, ANOTHER = 2, 1.1
"""Loads that a calibration needs, one to fit and another one to check; and the largest of them over
the smallest, at least."""


class Point(NamedTuple):
    """A load of a fit.

    Attributes:
        load: What is known.
        plateau: Its estimate.
        residual_n: Known force less calibrated estimate [N].
        allowed_n: Largest residual that noise, load and place explain [N].
    """

    load: Load
    plateau: Plateau
    residual_n: float
    allowed_n: float

    @property
    def doubtful(self) -> bool:
        """Whether it is off by more than two standard deviations: perhaps other grams."""
        return abs(self.residual_n) > DOUBT / OUTLIER * self.allowed_n


@dataclass(frozen=True, slots=True)
class ForceCalibration:
    """A fitted gain.

    Attributes:
        points: The loads in their order.
        gain: Known force over estimate.
        gain_sd: Its standard uncertainty.
        hysteresis_n: Largest difference between unloading and loading of one load, calibrated
            [N]; None where no load was reached from both sides.
    """

    points: tuple[Point, ...]
    gain: float
    gain_sd: float
    hysteresis_n: float | None

    @property
    def mae_before_n(self) -> float:
        """Mean absolute error of the estimates as they were [N]."""
        return float(np.mean([abs(p.load.force_n - p.plateau.estimate_n) for p in self.points]))

    @property
    def mae_after_n(self) -> float:
        """Mean absolute residual [N]."""
        return float(np.mean([abs(point.residual_n) for point in self.points]))


def check_loads(loads: Sequence[Load]) -> None:
    """Refuse loads that tell no gain, whatever the sensor says under them.

    Raises:
        ForceCalibrationError: There are too few, or all are alike.
    """
    sizes = [load.force_n for load in loads]
    if len(sizes) < FEWEST or max(sizes) < ANOTHER * min(sizes):
        values = ', '.join(f'{size:.3f}' for size in sizes)
        raise ForceCalibrationError(
            f'loads of {values} N: one fits the gain, and one that is larger by'
            f' {ANOTHER - 1.0:.0%} or more checks it',
            'few',
        )


def fit_gain(loads: Sequence[Load], plateaus: Sequence[Plateau]) -> ForceCalibration:
    """Fit the gain to known loads; see the module for the model.

    Args:
        loads: Known loads.
        plateaus: Plateau of each.

    Raises:
        ForceCalibrationError: There are too few loads, or the gain is impossible, or the loads
            disagree.
    """
    check_loads(loads)
    force, seen, gain, variance = _regression(loads, plateaus)
    if not GAINS[0] < gain < GAINS[1]:
        raise ForceCalibrationError(
            f'the loads are {gain:.3g} times the estimates, and a gel explains'
            f' {GAINS[0]} to {GAINS[1]}: check the unit',
            'units',
        )
    residual = force - gain * seen
    weight = 1.0 / variance
    allowed = OUTLIER * np.sqrt(variance)
    if (np.abs(residual) > allowed).any():
        raise _disagreement(loads, plateaus, residual, allowed)
    chi2 = float((weight * residual**2).sum())
    sd = np.sqrt(max(1.0, chi2 / (len(force) - 1)) / (weight * seen**2).sum())
    points = tuple(map(Point, loads, plateaus, residual.tolist(), allowed.tolist()))
    return ForceCalibration(points, gain, float(sd), _hysteresis(loads, plateaus, gain))


def _regression(loads: Sequence[Load], plateaus: Sequence[Plateau]) -> tuple[F64, F64, float, F64]:
    """Return loads, estimates, gain and variances of the residuals."""
    force = np.array([load.force_n for load in loads])
    seen = np.array([each.estimate_n for each in plateaus])
    load_sd = np.array([load.sd_n for load in loads])
    noise = np.array([each.error_n for each in plateaus])
    gain = float((force * seen).sum() / (seen**2).sum())
    variance = np.ones(len(force))
    for _ in range(3):
        variance = load_sd**2 + (gain * noise) ** 2 + (MODEL_PART * gain * seen) ** 2
        gain = float((force * seen / variance).sum() / (seen**2 / variance).sum())
    return force, seen, gain, variance


def _disagreement(
    loads: Sequence[Load], plateaus: Sequence[Plateau], residual: F64, allowed: F64
) -> ForceCalibrationError:
    worst = int(np.argmax(np.abs(residual) / allowed))
    text = (
        f'the loads disagree: that of {loads[worst].force_n:.3f} N is off by'
        f' {residual[worst]:+.3f} N, and {allowed[worst]:.3f} N can be explained'
    )
    remedy = ''
    if residual[worst] > 0.0 and loads[worst].force_n == max(load.force_n for load in loads):
        remedy = 'check its grams, or leave it out: on a soft gel a model may not reach so far'
    for a, b in combinations(range(len(loads)), 2):
        swapped = list(loads)
        swapped[a], swapped[b] = swapped[b], swapped[a]
        force, seen, gain, variance = _regression(swapped, plateaus)
        if (
            loads[a] != loads[b]
            and (np.abs(force - gain * seen) < OUTLIER * np.sqrt(variance)).all()
        ):
            remedy = f'loads {a + 1} and {b + 1} seem to be swapped: put them on in their order'
            break
    return ForceCalibrationError(text, 'loads', remedy)


def _hysteresis(loads: Sequence[Load], plateaus: Sequence[Plateau], gain: float) -> float | None:
    differences = [
        gain * (down.estimate_n - up.estimate_n)
        for (load, up), (other, down) in combinations(zip(loads, plateaus, strict=True), 2)
        if load.force_n == other.force_n and up.unloading < down.unloading
    ]
    return max(differences, key=abs, default=None)


RELATIVE_LIMIT = 0.03
"""Relative uncertainty of the gain below which a further load tells nothing."""
LEAST_IMPROVEMENT = 0.1
"""Smallest part by which a further load has to reduce it."""


def next_load_tells(calibration: ForceCalibration, load: Load) -> bool:
    """Return whether a further load would tell anything about the gain.

    It would not where the relative uncertainty is below `RELATIVE_LIMIT`, or where the load would
    reduce it by less than a tenth: 1/sd'^2 = 1/sd^2 + e^2/Var r.

    Args:
        calibration: Fit of the loads so far.
        load: The next one.
    """
    gain, sd = calibration.gain, calibration.gain_sd
    if sd <= RELATIVE_LIMIT * gain:
        return False
    seen = load.force_n / gain
    noise = float(np.median([each.plateau.error_n for each in calibration.points]))
    variance = load.sd_n**2 + (gain * noise) ** 2 + (MODEL_PART * load.force_n) ** 2
    after = 1.0 / np.sqrt(1.0 / sd**2 + seen**2 / variance)
    return bool(after < (1.0 - LEAST_IMPROVEMENT) * sd)


CHECK_TOLERANCE = 0.1
"""Relative change that another place on the gel and another day make (simulated: 0.06)."""


class GainCheck(NamedTuple):
    """Whether a calibrated sensor still reads a known load.

    Attributes:
        ratio: Known force over estimate, 1 for a sensor that did not change.
        ratio_sd: Its standard uncertainty.
        allowed: Largest difference from 1 that passes.
        passed: Whether it does.
    """

    ratio: float
    ratio_sd: float
    allowed: float
    passed: bool


def check_gain(load: Load, plateau: Plateau, relative_sd: float) -> GainCheck:
    """Check a calibrated sensor with one known load.

    It passes within `CHECK_TOLERANCE` and twice the uncertainty of load, plateau and calibration.

    Args:
        load: The load.
        plateau: Its plateau, estimated by the calibrated model.
        relative_sd: Relative uncertainty of the calibration's gain.
    """
    _, _, ratio, variance = _regression([load], [plateau])
    sd = float(np.sqrt(variance[0])) / plateau.estimate_n
    allowed = CHECK_TOLERANCE + 2.0 * float(np.hypot(sd, relative_sd))
    return GainCheck(ratio, sd, allowed, abs(ratio - 1.0) <= allowed)


def reference_loads(
    t_s: F64, reference_n: F64, plateaus: Sequence[Plateau | Stretch], zeros: Sequence[Stretch]
) -> list[Load]:
    """Return what a reference sensor measured during plateaus.

    Args:
        t_s: Times on the clock of the plateaus [s]; to a tenth of a second is enough.
        reference_n: Forces of the reference sensor along one axis [N].
        plateaus: Plateaus of the estimate.
        zeros: Stretches without a load, between which the zero of the reference sensor drifts.

    Raises:
        ForceCalibrationError: The reference is silent during a plateau, or without a load.
    """

    def level(span: Plateau | Stretch) -> tuple[float, float]:
        inside = reference_n[(t_s >= span.start_s) & (t_s <= span.end_s)]
        if len(inside) < FEWEST_SAMPLES:
            raise ForceCalibrationError(
                f'the reference sensor sent {len(inside)} samples from {span.start_s:.1f} to'
                f' {span.end_s:.1f} s',
                'contact',
                'check its driver, or give --loads',
            )
        # Quantiles: a slow host may shift the span onto the flank of a load.
        low, middle, high = np.quantile(inside, (0.16, 0.5, 0.84))
        return float(middle), float(high - low) / (2.0 * np.sqrt(len(inside)))

    rests = [level(each) for each in zeros]
    middles = [0.5 * (each.start_s + each.end_s) for each in zeros]
    loads = []
    for plateau in plateaus:
        force, sd = level(plateau)
        when = 0.5 * (plateau.start_s + plateau.end_s)
        zero, zero_sd = (np.interp(when, middles, values) for values in zip(*rests, strict=True))
        loads.append(Load(force - float(zero), float(np.hypot(sd, zero_sd))))
    return loads


FEWEST_SAMPLES = 10
"""Samples of a reference sensor that a plateau needs."""
