# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The gain of the sideways force from known pulls: masses that hang from what presses the gel.

Something presses and rests. A mass on a thread pulls it aside, hangs still, and is taken off; the
estimate of the sideways force under it, less that before and after, is s_i (a complex number: x is
real, y imaginary, in the contact frame). It pulls with F_i towards u_i. The model of the fit is

    F_i u_i = g e^(j a) s_i + r_i

with one gain g and one angle a between the directions that were meant and those of the image. Along
the pull r_i has the variance of the load, of the plateau and of a part of the force by which the
estimate differs from pull to pull; across it, that of the direction as well. Where no directions
are known, they are those of s_i, and a is zero.

The gain g holds at that place, on that day, under that normal force. With the gain G of the normal
force, ln(g / G) is `PULLED_MEAN`, plus a value of the sensor and one of place, day and force, both
normal, with the standard deviations `SENSOR_SD` and `PLACE_SD`. Elsewhere the first and the last
are zero in the mean, and `PullCalibration.elsewhere` is what is to be expected.

Nothing here needs ROS. Plateaus and refusals are those of `mixtac_fger.force_calibration`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.force_calibration import (
    CONTACT_N,
    CREEP_N_PER_S,
    CREEP_PART_PER_S,
    GAINS,
    OUTLIER,
    ROCKING_N,
    ROCKING_PART,
    SHORTEST_S,
    ForceCalibrationError,
    Load,
    Stretch,
    binned,
    load_of,
    reference_loads,
    steady_stretches,
    steady_together,
    stretch_of,
    unsteady,
)

F64 = NDArray[np.float64]
Both = tuple[Stretch, Stretch]
"""One span of both series of the sideways force, x and y."""
WAYS = {'+x': 1.0 + 0.0j, '-x': -1.0 + 0.0j, '+y': 1.0j, '-y': -1.0j}
"""Directions in the contact frame."""
LEAST_PULL_N = 0.03
"""A pull changes the estimate by this at least [N]."""
SLID_PART = 0.3
"""Part of a pull that may stay after it is taken off; more is a contact that slid (estimate)."""
PULL_PART = 0.12
"""Standard deviation of the estimate from pull to pull, as a part of it: between the four
directions on fourteen simulated sensors (`paper_like`)."""
WAY_SD = 0.09
"""Standard uncertainty of the direction of a pull by hand [rad] (estimate): 5 degrees."""
PULLED_MEAN, SENSOR_SD, PLACE_SD = 0.0, 0.29, 0.14
"""Logarithm of the gain of pulls under 100 g over that of the normal force: mean, and standard
deviations between sensors, and between places, days and forces of one. From twelve simulated
sensors (`paper_like`), on which what pulls under 100 g say and what handling on another day needs
go together (correlation 0.96)."""
LARGEST_TURN = 0.5
"""Angles beyond this are other directions than were meant [rad] (estimate)."""


@dataclass(frozen=True, slots=True)
class KnownPull:
    """A known pull, and what the estimate made of it.

    Attributes:
        load: Size of the pull.
        way: Its direction, of size 1; None where it is not known.
        seen: Change of the estimate [N].
        error_n: Standard uncertainty of that change per axis [N].
        span: The span that was used, of x.
        left_n: What of the change stayed after the pull [N]; NaN where that is not known.
    """

    load: Load
    way: complex | None
    seen: complex
    error_n: float
    span: Stretch
    left_n: float = float('nan')


def parse_pulls(text: str, sd_grams: float) -> list[tuple[Load, str]]:
    """Return loads and directions of a text such as `20` (all four) or `+x:20,-y:30`, in grams.

    Args:
        text: Masses by commas, each with its direction or for all four.
        sd_grams: Standard uncertainty of each [g].

    Raises:
        ForceCalibrationError: The text has another form, or names fewer than two pulls.
    """
    found: list[tuple[Load, str]] = []
    for part in text.split(','):
        way, _, grams = part.strip().rpartition(':')
        try:
            mass = float(grams)
        except ValueError:
            mass = 0.0
        if not 0.0 < mass < float('inf') or (way and way not in WAYS):
            raise ForceCalibrationError(
                f'sideways loads {text!r}: {part.strip()!r} is no pull in grams',
                'units',
                'give them like 20, for all four directions, or like +x:20,-y:30',
            )
        found += [(load_of(mass, sd_grams), each) for each in ([way] if way else WAYS)]
    if len(found) < 2:
        raise ForceCalibrationError(
            f'sideways loads {text!r} are one pull: one fits the gain, and another one checks it',
            'few',
            'give two or more, such as +x:20,-x:20',
        )
    return found


def mean_of(span: Both) -> complex:
    """Return the mean of both series."""
    return complex(span[0].mean_n, span[1].mean_n)


def pull_of(
    load: Load, way: complex | None, pulled: Both, before: Both, after: Both | None
) -> KnownPull:
    """Return what the estimate made of a pull, measured from the rest before and after it.

    Args:
        load: Size of the pull.
        way: Its direction; None where it is not known.
        pulled: Steady span under the pull.
        before: Steady span of the same contact without it, before.
        after: The same, after; None where there is none.

    Raises:
        ForceCalibrationError: No pull is seen, it swings, or what presses slid.
    """
    rests = [before] if after is None else [before, after]
    left = 0j if after is None else mean_of(after) - mean_of(before)
    seen = mean_of(pulled) - complex(np.mean([mean_of(each) for each in rests]))
    where = f'the pull at {pulled[0].start_s:.1f} to {pulled[0].end_s:.1f} s'
    if abs(seen) < LEAST_PULL_N:
        raise no_pull(load, abs(seen))
    sd = max(each.sd_n for each in pulled)
    if sd > max(ROCKING_N, ROCKING_PART * abs(seen)):
        raise ForceCalibrationError(
            f'{where} has a standard deviation of {sd:.3f} N at {abs(seen):.3f} N: the mass still'
            ' swings',
            'rocking',
        )
    slope = abs(complex(*(each.creep_n_per_s for each in pulled)))
    if slope > max(2.0 * CREEP_N_PER_S, 2.0 * CREEP_PART_PER_S * abs(seen)):
        raise slid(f'{where} changes by {slope:.3f} N/s at {abs(seen):.3f} N')
    if abs(left) > max(LEAST_PULL_N, SLID_PART * abs(seen)):
        raise slid(f'{where} leaves {abs(left):.3f} N of {abs(seen):.3f} N behind')
    errors = [each.error_n for each in pulled]
    errors += [each.error_n / len(rests) for rest in rests for each in rest]
    error = float(np.hypot(np.hypot.reduce(errors) / np.sqrt(2.0), abs(left) / np.sqrt(12.0)))
    stayed = float('nan') if after is None else abs(left)
    return KnownPull(load, way, seen, error, pulled[0], stayed)


def no_pull(load: Load, seen_n: float) -> ForceCalibrationError:
    """Return the refusal of a pull that changes the estimate by `seen_n` only [N]."""
    return ForceCalibrationError(
        f'the pull of {load.grams:.1f} g changes the estimate by {seen_n:.3f} N only', 'pull'
    )


def slid(found: str) -> ForceCalibrationError:
    """Return the refusal of a contact that slid; `found` is what was seen."""
    return ForceCalibrationError(f'{found}: what presses slides', 'slid')


def last_contact(t_s: F64, force_n: F64) -> tuple[int, slice]:
    """Return where the last contact of a recording begins, and its samples without the flanks.

    Args:
        t_s: Times, increasing [s].
        force_n: Normal force [N]; in the last contact at least half of the largest.

    Raises:
        ForceCalibrationError: There is none that ends.
    """
    stretches = steady_stretches(t_s, force_n)
    zero = stretches[0].mean_n if stretches else 0.0
    most = max((each.mean_n - zero for each in stretches), default=0.0)
    high = np.concatenate([[False], force_n - zero > 0.5 * most, [False]])
    edges = np.flatnonzero(high[1:] != high[:-1]).reshape(-1, 2)
    long = [(a, b) for a, b in edges.tolist() if t_s[b - 1] - t_s[a] > SHORTEST_S]
    if most < CONTACT_N or not long or long[-1][1] == len(force_n):
        raise unsteady(t_s, force_n, stretches)
    first, last = long[-1]
    free_s = max((each.end_s for each in stretches if each.end_s < t_s[first]), default=0.0)
    return int(np.searchsorted(t_s, free_s)), slice(first, last)


def find_pulls(
    t_s: F64, across: F64, loads: Sequence[tuple[Load, str]]
) -> tuple[list[KnownPull], list[Stretch]]:
    """Find the pulls in the series of one contact; return them, and the rests around them, of x.

    Args:
        t_s: Times, increasing [s].
        across: Estimates of x and y before the calibration [N], [T, 2].
        loads: Size and direction (of `WAYS`) of each pull, in their order.

    Raises:
        ForceCalibrationError: A pull cannot be used, or their number is another.
    """
    levels: list[Both] = []
    for x, y in steady_together(t_s, across[:, 0], across[:, 1]):
        if not levels or abs(mean_of((x, y)) - mean_of(levels[-1])) >= LEAST_PULL_N:
            levels.append((x, y))
        elif x.end_s - x.start_s > levels[-1][0].end_s - levels[-1][0].start_s:
            levels[-1] = (x, y)
    wanted = 2 * len(loads) + 1
    if len(levels) != wanted:
        raise ForceCalibrationError(
            f'the sideways force rests at {len(levels)} levels in turn, and {len(loads)} pulls with'
            f' a rest before and after each are {wanted}: a mass swung, or what presses slid',
            'slid' if len(levels) < wanted else 'order',
            'name all pulls, keep each and each rest still for 2 s, and press harder or pull less',
        )
    spans = zip(levels[1::2], levels[:-1:2], levels[2::2], strict=True)
    found = [
        pull_of(load, WAYS[way], *three) for (load, way), three in zip(loads, spans, strict=True)
    ]
    return found, [x for x, _ in levels[::2]]


def measured(
    t_s: F64, reference_n: F64, pulls: Sequence[KnownPull], rests: Sequence[Stretch]
) -> list[KnownPull]:
    """Return pulls whose size is what a reference sensor measured.

    Args:
        t_s: Times on the clock of the pulls [s]; to a tenth of a second is enough.
        reference_n: Forces of the reference sensor along its x and y [N], [T, 2].
        pulls: Pulls.
        rests: Spans without a pull, between which the zero of the reference sensor drifts.

    Raises:
        ForceCalibrationError: The reference is silent, or felt no pull.
    """
    spans = [each.span for each in pulls]
    x, y = (reference_loads(t_s, column, spans, rests) for column in reference_n.T)
    found = []
    for pull, right, up in zip(pulls, x, y, strict=True):
        size = float(np.hypot(right.force_n, up.force_n))
        if size < LEAST_PULL_N:
            raise ForceCalibrationError(f'the reference sensor felt a pull of {size:.3f} N', 'pull')
        load = Load(size, float(np.hypot(right.sd_n, up.sd_n)))
        found.append(replace(pull, load=load))
    return found


def span_at(t_s: F64, across: F64, start_s: float, end_s: float) -> Both | None:
    """Return both series between two times; None if there are none for long enough."""
    inside = (t_s >= start_s) & (t_s <= end_s) & np.isfinite(across[:, :2]).all(axis=1)
    found = [binned(t_s[inside], across[inside, axis]) for axis in range(2)]
    if len(found[0][0]) < FEWEST_STEPS or np.isnan(found[0][1]).any():
        return None
    x, y = (stretch_of(*each) for each in found)
    return x, y


FEWEST_STEPS = 10
"""Steps of `BIN_S` that a span needs."""


class PullPoint(NamedTuple):
    """A pull of a fit.

    Attributes:
        pull: What is known and seen.
        residual_n: Known less calibrated force along the pull [N].
        across_n: The same across it, to the left [N].
        allowed_n: Largest size of the first that noise, load and place explain [N].
    """

    pull: KnownPull
    residual_n: float
    across_n: float
    allowed_n: float


@dataclass(frozen=True, slots=True)
class PullCalibration:
    """A fitted gain of the sideways force.

    Attributes:
        points: The pulls in their order.
        gain: Known force over estimate, at these pulls; see `elsewhere`.
        gain_sd: Its standard uncertainty.
        turn: Angle from what is seen to what was meant [rad], from x to y; None without directions.
        turn_sd: Its standard uncertainty [rad].
    """

    points: tuple[PullPoint, ...]
    gain: float
    gain_sd: float
    turn: float | None
    turn_sd: float

    def elsewhere(self, normal_gain: float) -> tuple[float, float]:
        """Return the gain to be expected at other places, days and forces, and its uncertainty.

        Args:
            normal_gain: Gain of the normal force by known loads.
        """
        noise = PLACE_SD**2 + (self.gain_sd / self.gain) ** 2
        share = SENSOR_SD**2 / (SENSOR_SD**2 + noise)
        ratio = share * (math.log(self.gain / normal_gain) - PULLED_MEAN)
        gain = normal_gain * math.exp(ratio)
        return gain, gain * math.sqrt(share * noise + PLACE_SD**2)

    @property
    def mae_before_n(self) -> float:
        """Mean absolute error of the size of the pulls as they were [N]."""
        return float(np.mean([abs(p.pull.load.force_n - abs(p.pull.seen)) for p in self.points]))

    @property
    def mae_after_n(self) -> float:
        """Mean absolute residual along the pulls [N]."""
        return float(np.mean([abs(point.residual_n) for point in self.points]))


def fit_pulls(pulls: Sequence[KnownPull]) -> PullCalibration:
    """Fit the gain, and where directions are known the angle; see the module for the model.

    Args:
        pulls: One or more; directions of all are known, or of none.

    Raises:
        ForceCalibrationError: The gain is impossible, the pulls disagree, or went elsewhere.
    """
    known = np.array([each.load.force_n for each in pulls])
    seen = np.array([each.seen for each in pulls])
    noise = np.array([each.error_n for each in pulls])
    load_sd = np.array([each.load.sd_n for each in pulls])
    told = all(each.way is not None for each in pulls)
    ways = seen / np.abs(seen)
    if told:
        ways = np.array([each.way for each in pulls])
    turn = float(np.angle((known * ways * seen.conj()).sum())) if told else 0.0
    along = (ways.conj() * seen * np.exp(1j * turn)).real
    gain, variance = float((known * along).sum() / (along**2).sum()), np.ones(len(known))
    for _ in range(3):
        variance = load_sd**2 + (gain * noise) ** 2 + (PULL_PART * known) ** 2
        gain = float((known * along / variance).sum() / (along**2 / variance).sum())
    sideways = np.hypot(gain * noise, np.hypot(PULL_PART, WAY_SD) * known)
    turn_sd = float(1.0 / np.sqrt(((known / sideways) ** 2).sum()))
    if told and abs(turn) > LARGEST_TURN:
        raise ForceCalibrationError(
            f'the pulls are seen {np.degrees(-turn):+.0f} degrees from the directions that were'
            ' asked for, counted from x to y',
            'ways',
        )
    if not GAINS[0] < gain < GAINS[1]:
        raise ForceCalibrationError(
            f'the pulls are {gain:.3g} times the estimates, and a gel explains {GAINS[0]} to'
            f' {GAINS[1]}: check the unit',
            'units',
        )
    residual = known - gain * seen * np.exp(1j * turn) * ways.conj()
    allowed = OUTLIER * np.sqrt(variance)
    parts = np.maximum(np.abs(residual.real) / allowed, np.abs(residual.imag) / OUTLIER / sideways)
    worst = int(np.argmax(parts))
    if parts[worst] > 1.0:
        raise ForceCalibrationError(
            f'the pulls disagree: that of {known[worst]:.3f} N, number {worst + 1}, is off by'
            f' {residual[worst].real:+.3f} N along its direction and {residual[worst].imag:+.3f} N'
            f' across it; {allowed[worst]:.3f} and {OUTLIER * sideways[worst]:.3f} N can be'
            ' explained',
            'loads',
            'check its grams and its direction, and press harder if it may have slid',
        )
    spread = max(1.0, float((residual.real**2 / variance).sum()) / max(len(known) - 1, 1))
    gain_sd = float(np.sqrt(spread / (along**2 / variance).sum()))
    columns = (residual.real.tolist(), residual.imag.tolist(), allowed.tolist())
    points = tuple(map(PullPoint, pulls, *columns))
    return PullCalibration(points, gain, gain_sd, turn if told else None, turn_sd)
