# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gain of a sensor from known loads: plateaus of a force series, and a line through the origin.

No image shows how stiff a gel is, so the estimate of an uncalibrated sensor is off by a factor.
Known loads F_i are applied one after the other, each long enough for a plateau. e_i is the mean of
the estimate on the plateau, less the zero before and after it. The model of the fit is

    F_i = g * e_i + r_i,    Var r_i = s_i^2 + g^2 n_i^2 + (m g e_i)^2

with the stated uncertainty s_i of the load, the uncertainty n_i of the plateau and its zero, and
the relative spread m of the estimate from load to load, due to place, object and history. The line
goes through the origin, because the zero is known:

    g = sum(w_i F_i e_i) / sum(w_i e_i^2),    w_i = 1 / Var r_i,
    sd(g)^2 = x / sum(w_i e_i^2),    x = max(1, sum(w_i r_i^2) / (n - 1)).

A force that is measured later has the relative deviation of this prediction, its `share`:

    share^2 = (sd(g) / g)^2 + x m^2.

The sideways force is calibrated in the same way, by masses on a string that pull the pressing
object sideways. Its series is complex (x is real, y imaginary, in the contact frame), and e_i is
the size of the change. The gain is valid at the place and the normal force of these pulls;
`sideways_gain` returns the gain to expect elsewhere.

Nothing here needs ROS: a live sensor and a recording give the same series.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mixtac_core.events.errors import MixtacError

F64 = NDArray[np.float64]
Series = NDArray[np.inexact[Any]]
"""Forces [N]: real for the normal force, complex for the sideways force."""
Reason = Literal['contact', 'unsteady', 'zero', 'loads', 'few']
REMEDIES: Final[dict[Reason, str]] = {
    'contact': 'put the load on the middle of the gel, and nothing else; pull straight and level',
    'unsteady': 'keep each load still for 3 s, do not touch the table, let gel and lamp rest for a'
    ' minute, or use smaller loads',
    'zero': 'fasten the sensor, tare, start over, and leave it alone for 2 s after each load; where'
    ' a contact slid, press harder or pull less',
    'loads': 'check the grams of each load and that nothing else touches the gel',
    'few': 'name each load that was put on, two or more, such as 20,50,100',
}
GRAVITY: Final = 9.80665
"""Standard gravity [m/s^2]."""


class ForceCalibrationError(MixtacError):
    """Loads or a force series by which a sensor cannot be calibrated.

    Args:
        message: What is wrong, with the value.
        reason: See below.
        remedy: What the user can do about it, where that is not the usual remedy of the reason.

    Attributes:
        reason: `contact` (no load arrived), `unsteady` (a load rocks, swings or creeps), `zero`
            (the force does not return after a load), `loads` (loads disagree with the estimates)
            or `few` (too few loads, or another number than was named).
    """

    def __init__(self, message: str, reason: Reason, remedy: str = '') -> None:
        super().__init__(message, remedy=remedy or REMEDIES[reason])
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Load:
    """A known force.

    Attributes:
        force_n: Its size [N].
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


class Kind(NamedTuple):
    """Limits of a kind of load (estimates, but for `spread`).

    Attributes:
        least_n: Smallest change of the estimate that counts as a load [N].
        creep_n_per_s: Largest slope of a plateau [N/s].
        creep_part_per_s: The same, as a part of the change [1/s].
        zero_part: Part of the change that may stay after the load.
        spread: Standard deviation of the estimate between loads, places, objects and days, as a
            part of it.
    """

    least_n: float
    creep_n_per_s: float
    creep_part_per_s: float
    zero_part: float
    spread: float


PRESS: Final = Kind(0.04, 0.02, 0.10, 0.10, 0.07)
"""Weights on the gel; `spread` is 0.03 between loads at one place and 0.06 between places and days
of simulated sensors (`paper_like`). Another indenter makes 0.16 on strange ones (`varied`)."""
PULL: Final = Kind(0.03, 0.02, 0.15, 0.30, 0.12)
"""Pulls aside; `spread` is that of four directions on 14 simulated sensors (`paper_like`)."""
ZERO_N: Final = 0.03
"""Smallest change that may stay after any load [N]."""
ROCKING_N: Final = 0.03
"""Largest standard deviation of a plateau about its line [N] (estimate)."""
ROCKING_PART: Final = 0.10
"""The same, as a part of the change (estimate)."""
BIN_S: Final = 0.04
"""The series is averaged over these steps [s]; frames correct the estimate as often."""
REACH_S: Final = 0.4
"""Means over this time are compared, before and after a moment [s]."""
STEADY_N: Final = 0.02
"""Largest difference between them while the force is steady [N] (estimate)."""
STEADY_PART: Final = 0.12
"""The same, as a part of the force (estimate)."""
SHORTEST_S: Final = 0.8
"""Shortest steady stretch [s]."""
LONGEST_S: Final = 4.0
"""More of a stretch is not used [s]: a gel creeps."""
LONGEST_GAP_S: Final = 3600.0
"""Longest time without an estimate [s]; a longer one, or a step back, is a clock that jumped."""


class Stretch(NamedTuple):
    """A steady stretch of a force series.

    Attributes:
        start_s: Its start [s].
        end_s: Its end [s].
        mean_n: Mean force [N]; complex for the sideways force.
        sd_n: Standard deviation of the means over `BIN_S` about a line [N].
        error_n: Standard error of the mean [N].
        creep_n_per_s: Slope of that line [N/s].
    """

    start_s: float
    end_s: float
    mean_n: complex
    sd_n: float
    error_n: float
    creep_n_per_s: complex

    @property
    def seconds(self) -> float:
        """Its length [s]."""
        return self.end_s - self.start_s


def steady_stretches(t_s: F64, series: Series) -> list[Stretch]:
    """Return the stretches in which a force is steady, in the order of time.

    A force is steady where the means over `REACH_S` before and after a moment are equal, but for a
    slow creep. Before its start and after its end the series is assumed to stay as it is there.

    Args:
        t_s: Times, increasing [s].
        series: Forces at these times [N].

    Raises:
        ForceCalibrationError: Time goes back, or jumps.
    """
    reach = round(REACH_S / BIN_S)
    times, means = _binned(t_s, series)
    if len(times) < reach:
        return []
    ends = [np.full(reach, part.mean()) for part in (means[: reach // 2], means[-reach // 2 :])]
    # A long gap makes NaN of all that it touches, which is never steady.
    moving = sliding_window_view(np.concatenate([ends[0], means, ends[1]]), reach).mean(axis=1)
    before, after = moving[: -reach - 1], moving[reach + 1 :]
    level = np.maximum(np.abs(before), np.abs(after))
    steady = np.abs(after - before) <= np.maximum(STEADY_N, STEADY_PART * level)
    return [_stretch(times[a:b], means[a:b]) for a, b in _long_runs(steady)]


def _long_runs(where: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return start and end of the runs of steps that are long enough for a steady stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], where.astype(np.int8), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a >= SHORTEST_S / BIN_S]


def _binned(t_s: F64, series: Series) -> tuple[F64, Series]:
    """Return the middles of steps of `BIN_S` and the mean force in each.

    Gaps of up to `REACH_S`, where forces were withheld or lost, are bridged by a line. Steps of
    longer ones are NaN.
    """
    if not len(t_s):
        return np.zeros(0), np.zeros(0)
    steps = np.diff(t_s)
    if steps.min(initial=0.0) < 0.0 or steps.max(initial=0.0) > LONGEST_GAP_S:
        raise ForceCalibrationError(
            f'the clock of the camera jumped by {float(steps[np.abs(steps).argmax()]):+.1f} s',
            'zero',
            'look at the log for a reconnection of the camera, and begin again',
        )
    index = ((t_s - t_s[0]) / BIN_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(index, prepend=-1))
    filled = index[starts]
    found = np.add.reduceat(series, starts) / np.diff(starts, append=len(series))
    # The last step may have just begun.
    every = np.arange(filled[-1])
    means = np.interp(every, filled, found)
    after = np.searchsorted(filled, every)
    gap = filled[after] - filled[np.maximum(after - 1, 0)] - 1
    means[(gap > REACH_S / BIN_S) & (filled[after] != every)] = np.nan
    return np.asarray(t_s[0] + BIN_S * (every + 0.5)), means


def _stretch(times: F64, means: Series) -> Stretch:
    """Describe a run of steps without a gap."""
    kept = slice(0, round(LONGEST_S / BIN_S))
    times, means = times[kept], means[kept]
    slope, _ = np.polyfit(times - times.mean(), means, 1)
    rest = means - means.mean() - slope * (times - times.mean())
    # Steps err together for as long as the estimate remembers: blocks of REACH_S do less so.
    block = round(REACH_S / BIN_S)
    blocks = rest[: len(rest) // block * block].reshape(-1, block).mean(axis=1)
    error = max(blocks.std(), rest.std() / np.sqrt(block)) / np.sqrt(len(blocks))
    mean, creep = means.mean().item(), slope.item()
    return Stretch(times[0], times[-1], mean, float(rest.std(ddof=2)), float(error), creep)


@dataclass(frozen=True, slots=True)
class Plateau:
    """The estimate under one load.

    Attributes:
        span: Steady stretch under the load.
        rests: Steady stretches without it: before, and after where that is known.
        seen_n: Change of the estimate by the load [N]; complex for a pull.
        error_n: Standard uncertainty of that change [N].
    """

    span: Stretch
    rests: tuple[Stretch, ...]
    seen_n: complex
    error_n: float

    @property
    def size_n(self) -> float:
        """Size of the change [N]; negative where a weight lowers the estimate."""
        return abs(self.seen_n) if isinstance(self.seen_n, complex) else float(self.seen_n)


def plateau_of(span: Stretch, before: Stretch, after: Stretch | None, kind: Kind) -> Plateau:
    """Return the plateau of a load, measured from the zero before and after it.

    Args:
        span: Steady stretch with the load on.
        before: Steady stretch without the load, before.
        after: The same, after; None where the load is still on.
        kind: Of the load.

    Raises:
        ForceCalibrationError: No load is seen, it moves or creeps, or the zero is not back.
    """
    rests = (before,) if after is None else (before, after)
    seen = span.mean_n - sum(each.mean_n for each in rests) / len(rests)
    # The zero may have changed at any time between the rests, and creep belongs to no moment.
    left = abs(rests[-1].mean_n - before.mean_n)
    errors = [span.error_n, *(each.error_n / len(rests) for each in rests), left / math.sqrt(12.0)]
    errors.append(abs(span.creep_n_per_s) * span.seconds / math.sqrt(12.0))
    found = Plateau(span, rests, seen, math.hypot(*errors))
    size = found.size_n
    where = f'the force from {span.start_s:.1f} to {span.end_s:.1f} s'
    if size < kind.least_n:
        raise ForceCalibrationError(
            f'{where} changes by {size:.3f} N only: no load arrived, or it lies off the gel',
            'contact',
        )
    if span.sd_n > max(ROCKING_N, ROCKING_PART * size):
        raise ForceCalibrationError(
            f'{where} has a standard deviation of {span.sd_n:.3f} N at {size:.3f} N: the load rocks'
            ' or swings',
            'unsteady',
        )
    if abs(span.creep_n_per_s) > max(kind.creep_n_per_s, kind.creep_part_per_s * size):
        raise ForceCalibrationError(
            f'{where} changes by {abs(span.creep_n_per_s):.3f} N/s at {size:.3f} N: the gel creeps,'
            ' or the load slides',
            'unsteady',
        )
    if left > max(ZERO_N, kind.zero_part * size):
        raise zero_lost(before, rests[-1])
    return found


def zero_lost(before: Stretch, after: Stretch) -> ForceCalibrationError:
    """Return the refusal of a sensor whose zero after a load differs from that before it."""
    change_n = abs(after.mean_n - before.mean_n)
    return ForceCalibrationError(
        f'{change_n:.3f} N stay after the load at {before.end_s:.1f} s: the sensor was moved,'
        ' something slid or still touches it, or it had no time to recover',
        'zero',
    )


def find_plateaus(t_s: F64, series: Series, count: int | None, kind: Kind = PRESS) -> list[Plateau]:
    """Find the plateaus of loads in a recording that begins and ends without a load.

    Args:
        t_s: Times, increasing [s].
        series: Estimates before the calibration [N].
        count: Number of loads; None where it is not known.
        kind: Kind of the loads: presses or sideways pulls.

    Raises:
        ForceCalibrationError: A plateau cannot be used, or their number is not that of the loads.
    """
    stretches = steady_stretches(t_s, series)
    found: list[Plateau] = []
    loaded: list[Stretch] = []
    rest = stretches[0] if stretches else None
    for each in stretches[1:]:
        assert rest is not None  # noqa: S101  (there is a first stretch)
        most = max((abs(one.mean_n - rest.mean_n) for one in loaded), default=0.0)
        if abs(each.mean_n - rest.mean_n) > max(kind.least_n, kind.zero_part * most):
            loaded.append(each)
            continue
        found += [plateau_of(one, rest, each, kind) for one in _levels(loaded, rest)]
        rest, loaded = each, []
    if rest is not None and loaded:
        raise zero_lost(rest, loaded[-1])
    if not found or (count is not None and len(found) < count):
        raise unsteady(t_s, series, stretches, kind)
    if count is not None and len(found) > count:
        raise ForceCalibrationError(f'{len(found)} plateaus for {count} loads', 'few')
    return found


SAME_PART: Final = 0.15
"""Neighbouring stretches that differ by less are one load that was touched (estimate)."""


def _levels(loaded: Sequence[Stretch], rest: Stretch) -> list[Stretch]:
    """Return the longest stretch of each load among those of one contact."""
    levels: list[Stretch] = []
    for each in loaded:
        allowed = SAME_PART * abs(each.mean_n - rest.mean_n)
        if not levels or abs(each.mean_n - levels[-1].mean_n) >= allowed:
            levels.append(each)
        elif each.seconds > levels[-1].seconds:
            levels[-1] = each
    return levels


def unsteady(
    t_s: F64, series: Series, stretches: Sequence[Stretch], kind: Kind
) -> ForceCalibrationError:
    """Return why a load made no plateau: it was never steady, or there was none.

    Args:
        t_s: Times [s].
        series: Estimates [N].
        stretches: Where the force is steady; the first is without a load.
        kind: Of the load.
    """
    times, means = _binned(t_s, series)
    away = np.abs(means - (stretches[0].mean_n if stretches else 0.0)) > kind.least_n
    near_s = 2.0 * REACH_S
    for each in stretches:
        away &= (times < each.start_s - near_s) | (times > each.end_s + near_s)
    runs = _long_runs(away)
    if not runs:
        return ForceCalibrationError(
            'too few loads are seen: one did not arrive, or lies off the gel', 'contact'
        )
    first, last = max(runs, key=lambda run: run[1] - run[0])
    return ForceCalibrationError(
        f'the force is never steady from {times[first]:.1f} to {times[last - 1]:.1f} s', 'unsteady'
    )


def last_contact(t_s: F64, force_n: F64) -> tuple[int, slice]:
    """Return where the last contact of a recording begins, and its samples without the flanks.

    Args:
        t_s: Times, increasing [s].
        force_n: Normal force [N]; in the last contact at least half of the largest.

    Raises:
        ForceCalibrationError: No contact ends.
    """
    stretches = steady_stretches(t_s, force_n)
    zero = stretches[0].mean_n.real if stretches else 0.0
    most = max((each.mean_n.real - zero for each in stretches), default=0.0)
    high = np.concatenate([[False], force_n - zero > 0.5 * most, [False]])
    edges = np.flatnonzero(high[1:] != high[:-1]).reshape(-1, 2)
    long = [(a, b) for a, b in edges.tolist() if t_s[b - 1] - t_s[a] > SHORTEST_S]
    if most < PRESS.least_n or not long or long[-1][1] == len(force_n):
        raise unsteady(t_s, force_n, stretches, PRESS)
    first, last = long[-1]
    free_s = max((each.end_s for each in stretches if each.end_s < t_s[first]), default=0.0)
    return int(np.searchsorted(t_s, free_s)), slice(first, last)


FEWEST_SAMPLES: Final = 10
"""Samples of a reference sensor that a plateau needs."""


def reference_loads(t_s: F64, reference_n: F64, plateaus: Sequence[Plateau]) -> list[Load]:
    """Return the force of a reference sensor during plateaus, less its reading in their rests.

    Args:
        t_s: Times on the clock of the plateaus [s]; to a tenth of a second is enough.
        reference_n: Forces of the reference sensor [N], [T, axes].
        plateaus: Plateaus of the estimate.

    Raises:
        ForceCalibrationError: The reference is silent during a plateau, or without a load.
    """

    def level(span: Stretch) -> tuple[F64, float]:
        inside = reference_n[(t_s >= span.start_s) & (t_s <= span.end_s)]
        if len(inside) < FEWEST_SAMPLES:
            raise ForceCalibrationError(
                f'the reference sensor sent {len(inside)} samples from {span.start_s:.1f} to'
                f' {span.end_s:.1f} s',
                'contact',
                'check its driver, or give --loads',
            )
        # Quantiles: a slow host may shift the span onto the flank of a load.
        low, middle, high = np.quantile(inside, (0.16, 0.5, 0.84), axis=0)
        return middle, float(np.linalg.norm(high - low)) / (2.0 * np.sqrt(len(inside)))

    loads = []
    for plateau in plateaus:
        force, sd = level(plateau.span)
        rests = [level(each) for each in plateau.rests]
        zero = np.mean([middle for middle, _ in rests], axis=0)
        zero_sd = math.hypot(*(each for _, each in rests)) / len(rests)
        loads.append(Load(float(np.linalg.norm(force - zero)), math.hypot(sd, zero_sd)))
    return loads


OUTLIER: Final = 3.0
"""Residuals beyond so many standard deviations are loads that disagree."""
SMALLEST_GAIN: Final = 0.2
"""Smallest gain that a gel can explain (estimate)."""
LARGEST_GAIN: Final = 5.0
"""Largest gain that a gel can explain (estimate)."""
ANOTHER: Final = 1.1
"""Largest load over the smallest, at least: one fits the gain, another one checks it."""


class Point(NamedTuple):
    """A load of a fit.

    Attributes:
        load: The known force.
        plateau: Its estimate.
        residual_n: Known force less calibrated estimate [N].
        allowed_n: Largest residual that noise, load and place explain [N].
    """

    load: Load
    plateau: Plateau
    residual_n: float
    allowed_n: float


@dataclass(frozen=True, slots=True)
class ForceCalibration:
    """A fitted gain.

    Attributes:
        points: The loads in their order.
        gain: Ratio of the known force to the estimate.
        gain_sd: Standard uncertainty of the gain.
        share: Relative standard deviation of a force that is measured with this gain.
    """

    points: tuple[Point, ...]
    gain: float
    gain_sd: float
    share: float

    @property
    def exponent(self) -> float:
        """Power of the estimate by which the known forces grow; 1 where one gain fits all."""
        logs = np.log([(each.load.force_n, each.plateau.size_n) for each in self.points])
        return float(np.polyfit(logs[:, 1], logs[:, 0], 1)[0])


def check_loads(loads: Sequence[Load]) -> None:
    """Reject loads that cannot both fit and check a gain.

    Raises:
        ForceCalibrationError: There are too few, or all are alike.
    """
    sizes = [load.force_n for load in loads]
    if len(sizes) < 2 or max(sizes) < ANOTHER * min(sizes):
        raise ForceCalibrationError(
            f'loads of {", ".join(f"{size:.3f}" for size in sizes)} N: one fits the gain, and one'
            f' that is larger by {ANOTHER - 1.0:.0%} or more checks it',
            'few',
        )


def fit_gain(
    loads: Sequence[Load], plateaus: Sequence[Plateau], kind: Kind = PRESS
) -> ForceCalibration:
    """Fit the gain to known loads; see the module for the model.

    Args:
        loads: Known loads, one or more.
        plateaus: Plateau of the estimate for each load.
        kind: Of the loads.

    Raises:
        ForceCalibrationError: The gain is impossible, or the loads disagree.
    """
    force, load_sd = np.array([(load.force_n, load.sd_n) for load in loads]).T
    seen, noise = np.array([(each.size_n, each.error_n) for each in plateaus]).T
    gain, variance = float((force * seen).sum() / (seen**2).sum()), np.ones(len(force))
    for _ in range(3):
        variance = load_sd**2 + (gain * noise) ** 2 + (kind.spread * gain * seen) ** 2
        gain = float((force * seen / variance).sum() / (seen**2 / variance).sum())
    if not SMALLEST_GAIN < gain < LARGEST_GAIN:
        raise ForceCalibrationError(
            f'the loads are {gain:.3g} times the estimates, and a gel explains {SMALLEST_GAIN} to'
            f' {LARGEST_GAIN}',
            'loads',
            'give grams: 50 for a weight of 50 g, which is 0.49 N',
        )
    residual, allowed = force - gain * seen, OUTLIER * np.sqrt(variance)
    worst = int(np.argmax(np.abs(residual) / allowed))
    if abs(residual[worst]) > allowed[worst]:
        raise ForceCalibrationError(
            f'the loads disagree: that of {force[worst]:.3f} N is off by {residual[worst]:+.3f} N,'
            f' and {allowed[worst]:.3f} N can be explained',
            'loads',
        )
    excess = max(1.0, float((residual**2 / variance).sum()) / max(len(force) - 1, 1))
    sd = math.sqrt(excess / float((seen**2 / variance).sum()))
    points = tuple(map(Point, loads, plateaus, residual.tolist(), allowed.tolist()))
    return ForceCalibration(points, gain, sd, math.hypot(sd / gain, excess**0.5 * kind.spread))


SENSOR_SD: Final = 0.29
"""Standard deviation between sensors of the logarithm of the gain of pulls over that of presses."""
PLACE_SD: Final = 0.14
"""The same between places, days and forces of one sensor. Both are of twelve simulated sensors
(`paper_like`) that were pulled under 100 g and handled on another day (correlation 0.96)."""


def sideways_gain(pulls: ForceCalibration, normal_gain: float) -> tuple[float, float]:
    """Return the gain of the sideways force to be expected at other places, days and forces.

    Args:
        pulls: Fit of known pulls.
        normal_gain: Gain of the normal force by known loads.

    Returns:
        The gain and its standard uncertainty.
    """
    noise = PLACE_SD**2 + (pulls.gain_sd / pulls.gain) ** 2
    share = SENSOR_SD**2 / (SENSOR_SD**2 + noise)
    gain = normal_gain * (pulls.gain / normal_gain) ** share
    return gain, gain * math.sqrt(share * noise + PLACE_SD**2)
