# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbered checks of what only a physical camera can show, by what it sent for some time.

Each passes, fails or is skipped. The sensor rests untouched in steady light.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_driver.camera import CameraBatch
from mixtac_events.errors import MixtacError
from mixtac_events.readings import Edges, Frame

CHECKS = (
    'clock skew',
    'counter wrap',
    'synchronisation edges',
    'effect of biases',
    'unplugging',
    'noise rate',
    'exposure stamp',
    'focus',
    'lamp ripple',
    'temperature',
)
"""Names of the checks; their numbers count from 1."""
PASSIVE = (1, 2, 3, 6, 8, 9, 10)
"""Numbers of the checks that change nothing and need nobody."""


class Outcome(str, Enum):
    """Outcome of a check."""

    PASS = 'pass'  # noqa: S105 - a word
    FAIL = 'fail'
    SKIP = 'skip'


@dataclass(frozen=True)
class Check:
    """The result of a check.

    Attributes:
        number: Its number, from 1.
        outcome: Its outcome.
        found: What was found, in words.
        figure: What was measured, None without a measurement.
        limit: What the figure is compared with, in words with its unit.
    """

    number: int
    outcome: Outcome
    found: str
    figure: float | None = None
    limit: str = ''

    @property
    def name(self) -> str:
        """Name of the check."""
        return CHECKS[self.number - 1]


def judged(number: int, figure: float, good: bool, limit: str, found: str) -> Check:
    """Return the result of a check that measured a figure; NaN fails."""
    passed = good and math.isfinite(figure)
    known = round(float(figure), 4) if math.isfinite(figure) else None
    return Check(number, Outcome.PASS if passed else Outcome.FAIL, found, known, limit)


def skipped(number: int, reason: str) -> Check:
    """Return a check that was not made."""
    return Check(number, Outcome.SKIP, reason)


def failed(number: int, error: MixtacError) -> Check:
    """Return a check that an error ended."""
    return Check(number, Outcome.FAIL, str(error))


BIN_US = 1000
WIDTH, HEIGHT = 346, 260


@dataclass
class Stretch:
    """What a camera sent for some time.

    Camera time goes on where the clock is reset, or a recording starts again.

    Attributes:
        size: Columns and rows of the event array.
        arrivals: Camera time [us] and arrival [us since the Unix epoch] of reads.
        counts: Events per pixel, OFF and ON, `int64` [2, rows, columns].
        bins: Events per polarity and millisecond of camera time.
        frames: Frames.
        temperatures: Temperatures of the inertial unit [degrees Celsius].
        edges: Edges at the synchronisation connector.
    """

    size: tuple[int, int] = (WIDTH, HEIGHT)
    arrivals: list[tuple[int, float]] = field(default_factory=list)
    counts: NDArray[np.int64] = field(init=False)
    bins: list[tuple[int, NDArray[np.int64]]] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    temperatures: list[float] = field(default_factory=list)
    edges: list[Edges] = field(default_factory=list)
    _origin_us: int = 0

    def __post_init__(self) -> None:
        """Make room for the counts."""
        width, height = self.size
        self.counts = np.zeros((2, height, width), np.int64)

    def add(self, batch: CameraBatch) -> None:
        """Take a batch into account."""
        decoded, e = batch.decoded, batch.decoded.events
        if not self.arrivals:
            self._origin_us = batch.origin.us
        gone_on_us = batch.origin.us - self._origin_us
        self.arrivals.append((decoded.time_us + gone_on_us, batch.arrival_ns / 1000))
        if len(e):
            on = e.polarity.astype(np.int64)
            np.add.at(self.counts, (on, e.y, e.x), 1)
            t = e.t + gone_on_us
            first = int(t[0]) // BIN_US
            self.bins.append((first, np.bincount(2 * (t // BIN_US - first) + on)))
        self.frames += decoded.frames
        self.temperatures += decoded.imu.temperature.tolist()
        if len(decoded.edges.t):
            self.edges.append(decoded.edges)

    @property
    def seconds(self) -> float:
        """Length by the camera's clock [s]."""
        return (self.arrivals[-1][0] - self.arrivals[0][0]) / 1e6 if self.arrivals else 0.0

    def series(self) -> NDArray[np.int64]:
        """Return the events per millisecond, OFF and ON [n, 2], `int64`."""
        if not self.bins:
            return np.zeros((0, 2), np.int64)
        start = self.bins[0][0]
        length = max(first + (len(part) + 1) // 2 for first, part in self.bins) - start
        total = np.zeros(2 * length, np.int64)
        for first, part in self.bins:
            at = 2 * (first - start)
            total[at : at + len(part)] += part
        return total.reshape(-1, 2)

    def rates(self) -> tuple[float, float]:
        """Return the rates of OFF and ON events [1/s]."""
        off, on = self.counts.reshape(2, -1).sum(axis=1) / max(self.seconds, 1e-9)
        return float(off), float(on)


WRAP_US = 0x8000
BUCKET_US = 50_000
LEAST_BUCKETS = 5
STEP_MS = 16.0
"""Half the time between wraps [ms]: a step of the clock by more is a wrap that was missed."""
SKEW_PPM = 100.0
JITTER_US = 1000.0
"""Error of the quickest arrivals [us], which limits the skew of a short run."""


def _quickest(stretch: Stretch) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the time [us] and delay [us] of the quickest arrival of every 50 ms."""
    pairs = np.array(stretch.arrivals, np.float64).reshape(-1, 2)
    if not len(pairs):
        return np.empty(0), np.empty(0)
    # Buckets by arrival: the camera's own clock is what is in question.
    times, delays = pairs[:, 1], pairs[:, 1] - pairs[:, 0]
    bucket = ((times - times[0]) // BUCKET_US).astype(int)
    order = np.lexsort((delays, bucket))
    first = order[np.unique(bucket[order], return_index=True)[1]]
    return times[first] - times[0], delays[first] - delays.min()


def _largest_step(delays: NDArray[np.float64]) -> tuple[int, float]:
    """Return the bucket before which the delay changes most for good, and by how much [us]."""
    n = len(delays)
    if n < 2 * LEAST_BUCKETS:
        return 0, 0.0
    before = np.minimum.accumulate(delays)[:-1]
    after = np.minimum.accumulate(delays[::-1])[::-1][1:]
    steps = after - before
    # Back in time the earlier arrivals are the slow ones: compare with the quickest of each side.
    at = np.arange(1, n)
    inside = (at >= LEAST_BUCKETS) & (at <= n - LEAST_BUCKETS)
    k = int(np.argmax(np.where(inside, np.abs(steps), -1.0)))
    return k + 1, float(steps[k])


def check_skew(stretch: Stretch) -> Check:
    """Compare the rate of the camera's clock with that of the host."""
    times, delays = _quickest(stretch)
    if len(times) < 2 * LEAST_BUCKETS:
        return judged(1, math.nan, good=False, limit='', found='too few data')
    at, step_us = _largest_step(delays)
    delays = delays.copy()
    if abs(step_us) > STEP_MS * 1000:
        delays[at:] -= step_us
    third = len(times) // 3
    a = int(np.argmin(delays[:third]))
    b = len(times) - third + int(np.argmin(delays[-third:]))
    span_us = times[b] - times[a]
    skew = 1e6 * (delays[b] - delays[a]) / span_us
    limit = SKEW_PPM + 1e6 * JITTER_US / span_us
    found = f'the host runs {skew:+.0f} ppm faster, over {span_us / 1e6:.1f} s'
    return judged(1, skew, abs(skew) <= limit, f'{limit:.0f} ppm', found)


def check_wrap(stretch: Stretch) -> Check:
    """Check that time goes on across wraps of the 15-bit counter."""
    times, delays = _quickest(stretch)
    wraps = stretch.seconds * 1e6 / WRAP_US
    if len(times) < 2 * LEAST_BUCKETS:
        return judged(2, math.nan, good=False, limit='', found='too few data')
    step_ms = abs(_largest_step(delays)[1]) / 1000
    found = f'{wraps:.0f} wraps; largest step of the clock {step_ms:.1f} ms'
    return judged(2, step_ms, step_ms <= STEP_MS, f'{STEP_MS:g} ms', found)


EDGE_TOLERANCE = 0.02
PERIODS_OF_WRAP = 2


def check_edges(stretch: Stretch, signal_hz: float) -> Check:
    """Compare the rising edges at the synchronisation connector with the signal applied.

    Args:
        stretch: What the camera sent.
        signal_hz: Frequency of the signal [Hz]; 0 for none.
    """
    if not signal_hz:
        return skipped(3, 'no signal at the synchronisation connector (--edges HZ)')
    t = np.concatenate([e.t[e.kind == 3] for e in stretch.edges] or [np.empty(0, np.int64)])
    limit = f'{EDGE_TOLERANCE:.0%}'
    if len(t) < 3:
        return judged(3, 1.0, good=False, limit=limit, found=f'{len(t)} rising edges')
    errors = np.diff(t) - 1e6 / signal_hz
    wrong_periods = int(np.sum(np.abs(errors) * signal_hz / 1e6 > EDGE_TOLERANCE))
    # Those around a wrap that was missed are found by another check.
    wrong = max(wrong_periods - PERIODS_OF_WRAP, 0) / len(errors)
    missing = 1.0 - len(t) / max(stretch.seconds * signal_hz, 1.0)
    figure = max(wrong, missing - 2.0 / max(stretch.seconds * signal_hz, 1.0))
    found = f'{len(t)} rising edges, {wrong_periods} periods wrong'
    return judged(3, figure, figure <= EDGE_TOLERANCE, limit, found)


MOST_NOISE_HZ = 1.0
HOT_HZ = 10.0


def check_noise(stretch: Stretch) -> Check:
    """Check the rate of events per pixel of a sensor that sees nothing move."""
    rates = stretch.counts.sum(axis=0) / max(stretch.seconds, 1e-9)
    figure, hot = float(rates.mean()), int((rates > HOT_HZ).sum())
    off, on = stretch.rates()
    found = f'{figure:.3f} events per pixel and second, {on / max(off, 1e-9):.2f} ON per OFF, '
    found += f'{hot} pixels above {HOT_HZ:g} Hz'
    return judged(6, figure, 0.0 < figure <= MOST_NOISE_HZ, f'0 .. {MOST_NOISE_HZ:g} Hz', found)


LEAST_SHARPNESS = 0.12
LEAST_FRAMES = 5
NEAR, FAR = 1, 4


def sharpness(frames: list[Frame]) -> float:
    """Return how sharp a still scene is; NaN without frames or without contrast.

    The mean square difference of neighbours over that of pixels four apart, without the noise:
    1 for a scene with detail of every size, 1/16 for one that is smooth over four pixels.
    """
    shape = frames[0].image.shape if frames else (0, 0)
    stack = np.array([f.image for f in frames if f.image.shape == shape], np.float64)
    if len(stack) < LEAST_FRAMES:
        return math.nan
    picture = stack.mean(axis=0)
    noise = 2.0 * float(stack.var(axis=0, ddof=1).mean()) / len(stack)

    def contrast(step: int) -> float:
        across = picture[:, step:] - picture[:, :-step]
        down = picture[step:] - picture[:-step]
        return float(((across**2).mean() + (down**2).mean()) / 2) - noise

    far = contrast(FAR)
    return max(contrast(NEAR), 0.0) / far if far > noise else math.nan


def check_focus(stretch: Stretch) -> Check:
    """Check that the frames are sharp."""
    if len(stretch.frames) < LEAST_FRAMES:
        return skipped(8, f'{len(stretch.frames)} frames, {LEAST_FRAMES} are needed')
    figure = sharpness(stretch.frames)
    if math.isnan(figure):
        return skipped(8, 'no contrast in view')
    limit = f'at least {LEAST_SHARPNESS:g}'
    found = f'neighbours differ by {figure:.2f} of what pixels {FAR} apart do (squared)'
    return judged(8, figure, figure >= LEAST_SHARPNESS, limit, found)


MOST_RIPPLE = 0.25
RIPPLE_HZ = (40.0, 450.0)
CLEAR = 20.0
"""A peak counts when its power is so many times the median."""


def check_ripple(stretch: Stretch) -> Check:
    """Look for a rhythm of the events between 40 and 450 Hz, as of a lamp on the mains."""
    counts = stretch.series().sum(axis=1)
    if len(counts) < 500 or not counts.any():
        return skipped(9, 'too few events')
    # Bursts are no rhythm.
    counts = np.minimum(counts, 5 * np.median(counts) + 20)
    spectrum = np.abs(np.fft.rfft((counts - counts.mean()) * np.hanning(len(counts)))) * 4
    depth = spectrum / len(counts) / counts.mean()
    hz = np.fft.rfftfreq(len(counts), BIN_US / 1e6)
    inside = (hz >= RIPPLE_HZ[0]) & (hz <= RIPPLE_HZ[1])
    k = int(np.argmax(np.where(inside, depth, 0.0)))
    clear = depth[k] ** 2 > CLEAR * np.median(depth[inside] ** 2)
    figure = float(depth[k]) if clear else 0.0
    found = f'{figure:.0%} at {hz[k]:.0f} Hz' if clear else 'none'
    return judged(9, figure, figure <= MOST_RIPPLE, f'{MOST_RIPPLE:.0%} of the rate', found)


TEMPERATURES_C = (0.0, 70.0)


def check_temperature(stretch: Stretch) -> Check:
    """Check the temperature of the inertial unit."""
    known = [t for t in stretch.temperatures if math.isfinite(t)]
    if not known:
        return skipped(10, 'no inertial samples')
    figure, (low, high) = float(np.mean(known)), TEMPERATURES_C
    found = f'{figure:.1f} degrees Celsius'
    return judged(10, figure, low <= figure <= high, f'{low:g} .. {high:g} C', found)


@dataclass(frozen=True)
class BiasChange:
    """A change of a bias, and what it must do to the noise.

    Attributes:
        bias: The bias.
        values: Parameters to change.
        polarity: Whose rate counts: 0 OFF, 1 ON, 2 both.
        rises: Whether the rate rises.
    """

    bias: str
    values: Mapping[str, Any]
    polarity: int
    rises: bool


BIAS_CHANGES = (
    # A leak takes seconds to fill a threshold that was raised: lower ones come later.
    BiasChange('DiffBn', {'DiffBn_coarse': 4, 'DiffBn_fine': 140}, 1, rises=True),
    BiasChange('ONBn', {'ONBn_coarse': 5, 'ONBn_fine': 40}, 1, rises=True),
    BiasChange('OFFBn', {'OFFBn_coarse': 4, 'OFFBn_fine': 6}, 0, rises=True),
    BiasChange('PrBp', {'PrBp_coarse': 0}, 2, rises=False),
    BiasChange('PrSFBp', {'PrSFBp_coarse': 0}, 2, rises=False),
)
"""Biases of the event pixels; the refractory period does not show in the noise of most of them."""
LEAST_EFFECT = 1.2


def check_biases(usual: Stretch, changed: Mapping[str, Stretch]) -> Check:
    """Compare the noise with other biases with that of the usual ones."""
    factors = {}
    for change in BIAS_CHANGES:
        rates = [(*s.rates(), sum(s.rates())) for s in (usual, changed[change.bias])]
        before, after = (each[change.polarity] for each in rates)
        if not before:
            return skipped(4, 'no events to compare')
        factor = after / before
        factors[change.bias] = factor if change.rises else 1.0 / max(factor, 1e-3)
    worst = min(factors.values())
    listed = ', '.join(f'{name} {factor:.1f}' for name, factor in factors.items())
    found = f'the noise changes by the factors {listed}'
    return judged(4, worst, worst >= LEAST_EFFECT, f'at least {LEAST_EFFECT:g} each', found)


FLASH_SHARE = 0.02
"""A flash makes at least this share of the pixels fire, within `FLASH_US`."""
FLASH_US = 20_000
OFFSETS_US = np.arange(-30_000, 30_001, 250)
MOST_LATE_MS = 2.0
LEAST_FLASHES = 3


def flashes(stretch: Stretch) -> list[tuple[int, int]]:
    """Return start and end [us, camera clock] of each flash, by the bursts of events."""
    series = stretch.series()
    if not len(series):
        return []
    window = np.ones(FLASH_US // BIN_US)
    sums = [np.convolve(series[:, k] - np.median(series[:, k]), window) for k in (1, 0)]
    enough = FLASH_SHARE * math.prod(stretch.size)
    start = stretch.bins[0][0] * BIN_US

    def bursts(k: int) -> list[int]:
        above = np.flatnonzero(sums[k] > enough)
        runs = np.split(above, np.flatnonzero(np.diff(above) > 1) + 1) if len(above) else []
        # The strongest millisecond of each run.
        column = series[:, 1 - k]
        found = []
        for run in runs:
            low, high = max(run[0] - len(window) + 1, 0), min(run[-1] + 1, len(column))
            found.append(start + (low + int(np.argmax(column[low:high]))) * BIN_US + BIN_US // 2)
        return found

    falls = bursts(1)
    pairs = []
    for rise, following in pairwise([*bursts(0), math.inf]):
        ends = [t for t in falls if rise < t < following]
        if ends:
            pairs.append((int(rise), ends[0]))
    return pairs


def stamp_offset_ms(stretch: Stretch, lit: list[tuple[int, int]]) -> tuple[float, float]:
    """Return by how much exposures are stamped late [ms], least and most.

    The brightness of a frame is fitted by the share of its exposure in which the light was on, for
    every possible offset; NaN where the frames do not follow the light.
    """
    first, last = lit[0][0] - 500_000, lit[-1][1] + 500_000
    frames = [f for f in stretch.frames if first < f.exposure_start_us < last]
    if len(frames) < LEAST_FRAMES:
        return math.nan, math.nan
    brightness = np.array([float(f.image.mean()) for f in frames])
    begins = np.array([f.exposure_start_us for f in frames], float)
    ends = np.array([f.exposure_end_us for f in frames], float)
    costs = []
    for offset in OFFSETS_US:
        share = np.zeros(len(frames))
        for on, off in lit:
            overlap = np.minimum(ends - offset, off) - np.maximum(begins - offset, on)
            share += np.maximum(overlap, 0.0)
        share /= np.maximum(ends - begins, 1.0)
        design = np.stack([share, np.ones_like(share)], axis=1)
        solution = np.linalg.lstsq(design, brightness, rcond=None)[0]
        costs.append(float(((design @ solution - brightness) ** 2).sum()))
    cost = np.array(costs)
    total = float(((brightness - brightness.mean()) ** 2).sum())
    if total <= 0 or cost.min() > 0.5 * total:
        return math.nan, math.nan
    # All offsets that explain the frames as well.
    good = OFFSETS_US[cost <= cost.min() + 0.02 * total]
    return float(good[0]) / 1000, float(good[-1]) / 1000


def check_stamps(stretch: Stretch) -> Check:
    """Check the times of the exposures by a light that was flashed."""
    lit, limit = flashes(stretch), f'{MOST_LATE_MS:g} ms'
    if len(lit) < LEAST_FLASHES:
        return skipped(7, f'{len(lit)} flashes seen in the events, {LEAST_FLASHES} are needed')
    least, most = stamp_offset_ms(stretch, lit)
    # The smallest error that explains the frames.
    figure = min(max(least, 0.0), most) if math.isfinite(least) else math.nan
    found = f'exposures are stamped {least:+.1f} to {most:+.1f} ms late, by {len(lit)} flashes'
    return judged(7, figure, abs(figure) <= MOST_LATE_MS, limit, found)


def passive_checks(still: Stretch, edges_hz: float = 0.0) -> list[Check]:
    """Return the checks of a still stretch, which disturb nothing.

    Args:
        still: What a camera sent that saw nothing move.
        edges_hz: Frequency of the signal at the synchronisation connector [Hz]; 0 for none.
    """
    return [
        check_skew(still),
        check_wrap(still),
        check_edges(still, edges_hz),
        check_noise(still),
        check_focus(still),
        check_ripple(still),
        check_temperature(still),
    ]
