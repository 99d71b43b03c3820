# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Synchronising impulses: force peaks, bursts of events, and the pairing of two recordings.

An impulse is a sharp tap on the sensor. The force sensor sees a short peak, the camera a burst of
events. The delay of the force sensor's filter (1.5 to 3 ms for a stream of 800 Hz) cannot be
separated from the offset `b` and stays in it: a camera time maps to the stamp of the sample that
shows the force of that moment.

The pairing needs no knowledge of the clocks. `prefer_isolated` first discards impulses without a
still interval before and after them: a deliberate tap has both, a bouncing load does not.
`coincidences` then selects the clock offset under which the most impulses coincide; edges of a
trigger line are paired in the same way. `paired_impulses` does all of this (paper, section Aligning
Data). A force recording with a gap is rejected, because its clock may have changed at the gap.

SciPy is imported inside the functions: it takes a second to load, which the commands that do not
align need not wait for.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.alignment.clock_fit import (
    MAX_DRIFT,
    AlignmentError,
    AmbiguousImpulsesError,
    GapError,
    NoImpulseError,
    SaturatedImpulseError,
)
from mixtac_fger.alignment.histories import EventCounts
from mixtac_fger.alignment.parameters import DEFAULTS, AlignmentParameters

F64 = NDArray[np.float64]


def gaussian_smooth(values: F64, width: float) -> F64:
    """Return samples smoothed by a Gaussian; beyond the ends the last samples go on.

    Args:
        values: Evenly spaced samples, ``float64 [n]``, not empty.
        width: Standard deviation, in samples.
    """
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, max(width, 1e-9), mode='nearest'))


def noise_std(force_N: F64) -> float:
    """Return the standard deviation of the white noise of samples [N], from second differences."""
    second = np.diff(force_N, 2)
    return float(1.4826 * np.median(np.abs(second - np.median(second))) / np.sqrt(6.0))


def pressing_sign(force_N: F64) -> float:
    """Return the sign that makes pressing positive: 1 or -1."""
    relative = force_N - np.median(force_N)
    return 1.0 if relative.max() >= -relative.min() else -1.0


def prominent_peaks(values: F64, prominence: float, window: int) -> list[tuple[int, float, float]]:
    """Return place, prominence and width at half the prominence of peaks [samples].

    The place of a plateau is its middle.

    Args:
        values: Evenly spaced samples.
        prominence: Least prominence.
        window: Samples, an odd number, about a peak among which its prominence is taken.
    """
    from scipy.signal import find_peaks

    with warnings.catch_warnings():
        # SciPy warns of peaks without prominence before it leaves them out.
        warnings.simplefilter('ignore', RuntimeWarning)
        places, found = find_peaks(values, prominence=prominence, width=0.0, wlen=window)
    sizes = found['prominences'].tolist(), found['widths'].tolist()
    return list(zip(places.tolist(), *sizes, strict=True))


MIN_SPACING_S: Final = 0.3
"""Of impulses closer than this, bounces mostly, the strongest counts [s]."""


@dataclass(frozen=True, slots=True)
class Impulse:
    """An impulse in one recording.

    Attributes:
        time_s: Peak [s] since the start of the recording, on its clock.
        strength: Sharpness, comparable within one recording only.
        saturated: True where the peak is cut off.
    """

    time_s: float
    strength: float
    saturated: bool = False


def vertex(t: F64, value: F64) -> float:
    """Return the time of the vertex of the parabola through samples [s], within the samples.

    Args:
        t: Sample times [s], at least 3.
        value: Samples about one extremum.
    """
    middle, half = float(t.mean()), max(float(np.ptp(t)) / 2.0, 1e-9)
    curvature, slope, _ = np.polyfit((t - middle) / half, value, 2)
    if abs(curvature) < 1e-12 * (1.0 + abs(slope)):
        return middle
    inside = np.clip(-slope / (2.0 * curvature), -1.0, 1.0)
    return float(np.clip(middle + half * inside, t[0], t[-1]))


def strongest(impulses: list[Impulse], spacing_s: float) -> list[Impulse]:
    """Return the impulses that have no stronger one within `spacing_s`, in the order of time."""
    kept: list[Impulse] = []
    for impulse in sorted(impulses, key=lambda i: -i.strength):
        if all(abs(impulse.time_s - other.time_s) >= spacing_s for other in kept):
            kept.append(impulse)
    return sorted(kept, key=lambda i: i.time_s)


TOP: Final = 0.9
"""Part of the height above which samples belong to the top of a peak."""
NOISE_FACTOR: Final = 8.0
"""Peaks stand out of the noise by this many standard deviations."""


def find_force_impulses(
    t_s: F64, force_N: F64, parameters: AlignmentParameters = DEFAULTS
) -> list[Impulse]:
    """Find sharp force peaks; their times lie between the samples.

    Args:
        t_s: Increasing sample times [s], relative to the start of the recording (epoch times would
            cost digits), reference clock, ``float64 [N]``.
        force_N: Normal force [N], of either sign, ``float64 [N]``.
        parameters: What counts as an impulse.

    Returns:
        Impulses in the order of time; bounces are merged into the strongest.
    """
    force = pressing_sign(force_N) * (force_N - np.median(force_N))
    period = float(np.median(np.diff(t_s)))
    least = max(parameters.min_force, NOISE_FACTOR * noise_std(force))
    window = 2 * max(3, round(2.0 * parameters.max_width / period)) + 1
    impulses = []
    for peak, height, width in prominent_peaks(force, least, window):
        width_s = width * period
        if width_s > parameters.max_width:
            continue
        first, last = _top(force, peak, force[peak] - (1.0 - TOP) * height)
        flat_first, flat_last = _top(force, peak, force[peak] - 1e-6 * height, least=0)
        flat = flat_last - flat_first
        impulses.append(
            Impulse(
                time_s=vertex(t_s[first:last], force[first:last]),
                strength=height / max(width_s, period),
                saturated=bool(flat >= 3 and flat * period > 0.3 * width_s),
            )
        )
    return strongest(impulses, MIN_SPACING_S)


def _top(force: F64, peak: int, level: float, least: int = 2) -> tuple[int, int]:
    """Return the range of samples about the peak above a level, at least `least` to each side."""
    first = last = peak
    while first > 0 and (force[first - 1] >= level or peak - first < least):
        first -= 1
    while last < len(force) - 1 and (force[last + 1] >= level or last - peak < least):
        last += 1
    return first, last + 1


SMOOTHING_S: Final = 0.006
"""Standard deviation of the smoothing that merges both bursts of a tap [s]."""
LOST_NEAR_S: Final = 0.05
"""Distance to lost packets within which a burst does not count [s]."""


def find_bursts(counts: EventCounts, parameters: AlignmentParameters) -> list[Impulse]:
    """Find bursts of the smoothed event rate that are as short as a tap's.

    Args:
        counts: Event counts, camera clock.
        parameters: What counts as an impulse.

    Returns:
        Impulses in the order of time, relative to the start of the counts.
    """
    width_s = counts.width_us * 1e-6
    smooth = gaussian_smooth(counts.counts.astype(np.float64) / width_s, SMOOTHING_S / width_s)
    window = 2 * round(4.0 * parameters.max_width / width_s) + 1
    reach = round(LOST_NEAR_S / width_s)
    impulses = [
        Impulse((peak + 0.5) * width_s, height)
        for peak, height, width in prominent_peaks(smooth, parameters.min_burst_rate, window)
        if width * width_s <= 1.5 * parameters.max_width and not counts.lost_near(peak, reach)
    ]
    return strongest(impulses, MIN_SPACING_S)


QUIET_S: Final = 0.3
"""How long before and after a tap nothing may happen [s]."""
IMPULSE_S: Final = 0.08
"""Time before and after an impulse that counts as part of it [s]."""
DISTURBANCE_SHARE: Final = 0.25
"""Smallest disturbance, as a share of the height of the impulse itself."""


def prefer_isolated(impulses: list[Impulse], time_s: F64, signal: F64) -> list[Impulse]:
    """Return the isolated impulses, or all where fewer than two are isolated.

    Args:
        impulses: Impulses found in a signal.
        time_s: Times of the signal [s], increasing, on the impulses' clock.
        signal: The signal in which the impulses were found: event rate or force, in any unit.
    """
    height = np.abs(signal - np.median(signal))

    def is_isolated(impulse: Impulse) -> bool:
        offsets = np.array([-QUIET_S, -IMPULSE_S, IMPULSE_S, QUIET_S])
        far, left, right, end = np.searchsorted(time_s, impulse.time_s + offsets)
        around = np.concatenate([height[far:left], height[right:end]])
        if left == right or not len(around):
            return False
        return bool(around.max() < DISTURBANCE_SHARE * height[left:right].max())

    chosen = [impulse for impulse in impulses if is_isolated(impulse)]
    return chosen if len(chosen) >= 2 else impulses


RIVAL: Final = 0.8
"""Share of the best map's coincidences from which on another map is a rival."""
TRIED: Final = 24
"""Moments, spread over the recording, for which a partner is searched, and partners tried for each:
trying all pairs of thousands of edges takes minutes."""
NEIGHBOURS: Final = 8
"""Moments before and after each that show its likeliest partners."""


def coincidences(
    x: F64,
    y: F64,
    weight: F64 | None = None,
    *,
    tolerance_s: float,
    fewest: int,
    drift: float = MAX_DRIFT,
) -> list[tuple[int, int]]:
    """Return the pairs of moments that coincide under the clock offset with the most of them.

    Args:
        x: Moments on one clock [s], increasing.
        y: Moments on the other clock [s], increasing.
        weight: Weight of each pair, ``[len(x), len(y)]``; None for 1.
        tolerance_s: Largest distance of a pair, in addition to the drift [s].
        fewest: Least number of pairs.
        drift: Largest relative rate of the clocks, less one.

    Raises:
        NoImpulseError: There are fewer pairs under each offset.
        AmbiguousImpulsesError: Other pairs coincide about as well.
    """
    weight = np.ones((len(x), len(y))) if weight is None else weight
    found = []
    if min(len(x), len(y)) >= fewest:
        tried = np.unique(np.linspace(0, len(x) - 1, TRIED).astype(np.int64)).tolist()
        likely = [(i, j) for i in tried for j in _likely(x, y, i, tolerance_s, drift)]
        found = [pairs_at(x, y, i, j, tolerance_s, drift) for i, j in likely]
    # One strong pair counts less than several weak ones that agree.
    enough = [pairs for pairs in found if len(pairs) >= fewest]
    scored = [(sum(weight[pair] for pair in pairs), pairs) for pairs in enough]
    score, best = max(scored, key=lambda each: each[0], default=(0.0, []))
    if not best:
        raise NoImpulseError(
            f'{len(x)} impulses or edges from the camera and {len(y)} from the reference: {fewest}'
            ' with the same times between them are needed',
            remedy='record both while you tap sharply on the gel, once at the beginning and once at'
            ' the end, or external_edges and reference_edges with the trigger line connected',
        )
    for other_score, other in scored:
        if other_score > RIVAL * score and not set(other) & set(best):
            raise AmbiguousImpulsesError(
                f'{len(best)} impulses or edges coincide in more than one way: leave other taps out'
                ' and tap twice at one end, or send edges at unequal distances'
            )
    return best


def _nearest(y: F64, times: F64) -> NDArray[np.int64]:
    """Return the indices of the moments that are nearest to some times."""
    after = np.clip(np.searchsorted(y, times), 1, len(y) - 1)
    return np.asarray(after - ((times - y[after - 1]) < (y[after] - times)), np.int64)


def _likely(x: F64, y: F64, i: int, tolerance_s: float, drift: float) -> list[int]:
    """Return the moments of y that are most likely moment i of x, by the moments around it."""
    around = x[max(i - NEIGHBOURS, 0) : i + NEIGHBOURS + 1] - x[i]
    expected = y[:, None] + around
    distance = np.abs(y[_nearest(y, expected)] - expected)
    meets = (distance <= tolerance_s + drift * np.abs(around)).sum(axis=1)
    return np.argsort(-meets, kind='stable')[:TRIED].tolist()  # type: ignore[no-any-return]


def pairs_at(
    x: F64, y: F64, i: int, j: int, tolerance_s: float, drift: float = MAX_DRIFT
) -> list[tuple[int, int]]:
    """Return the pairs of moments that coincide where moment i of x is moment j of y.

    The list is empty if two moments of x have the same partner.

    Args:
        x: Moments on one clock [s].
        y: Moments on the other clock [s], increasing.
        i: Index into x.
        j: Index into y.
        tolerance_s: Largest distance of a pair, in addition to the drift [s].
        drift: Largest relative rate of the clocks, less one.
    """
    expected = x - x[i] + y[j]
    nearest = _nearest(y, expected)
    allowed = tolerance_s + drift * np.abs(x - x[i])
    meets = np.flatnonzero(np.abs(y[nearest] - expected) <= allowed)
    partners = nearest[meets]
    if len(np.unique(partners)) < len(partners):
        return []
    return list(zip(meets.tolist(), partners.tolist(), strict=True))


MOST_IMPULSES: Final = 24
"""Impulses of each recording that are tried, the strongest ones."""
MATCH_S: Final = 0.02
"""Largest disagreement of a burst and a force peak that are the same tap [s]."""
FORCE_GAP_S: Final = 0.05
"""Longest stretch without force samples [s]; after a longer one the clock may be another."""
FEWEST_SAMPLES: Final = 16
"""Samples of the force in which an impulse can be found."""
STRONG: Final = 0.02
"""Pairs with this part of the strongest one's weight are impulses; that of a dropped load may be
thirty times that of a tap."""


class ImpulsePair(NamedTuple):
    """The same impulse in both recordings.

    Attributes:
        camera: In the events, camera clock.
        reference: In the force, reference clock.
    """

    camera: Impulse
    reference: Impulse


def pair_impulses(
    camera: list[Impulse], reference: list[Impulse], drift: float = MAX_DRIFT
) -> list[ImpulsePair]:
    """Pair the impulses of both recordings; return the strong pairs in the order of time.

    Args:
        camera: Impulses in the events.
        reference: Impulses in the force.
        drift: Largest relative rate of the clocks, less one.

    Raises:
        NoImpulseError: No two impulses agree, or only one of those that do is strong.
        AmbiguousImpulsesError: Two different maps fit about as well.
        SaturatedImpulseError: An impulse went over the range of the force sensor.
    """
    events, forces = (
        sorted(sorted(each, key=lambda i: -i.strength)[:MOST_IMPULSES], key=lambda i: i.time_s)
        for each in (camera, reference)
    )
    (x, y), strengths = (
        [np.array([getattr(i, name) for i in each]) for each in (events, forces)]
        for name in ('time_s', 'strength')
    )
    weight = np.sqrt(np.outer(*(each / each.max(initial=1e-9) for each in strengths)))
    found = coincidences(x, y, weight, tolerance_s=MATCH_S, fewest=2, drift=drift)
    least = STRONG * max(weight[pair] for pair in found)
    pairs = [ImpulsePair(events[i], forces[j]) for i, j in found if weight[i, j] >= least]
    if len(pairs) < 2:
        raise NoImpulseError(
            'only one strong impulse is in both recordings: tap once at the beginning and once at '
            'the end, about equally hard'
        )
    for _, impulse in pairs:
        if impulse.saturated:
            raise SaturatedImpulseError(
                f'the force peak {impulse.time_s:.3f} s into the recording is cut off at the range'
                ' of the force sensor: tap more gently'
            )
    return pairs


def paired_impulses(
    counts: EventCounts,
    force_t_s: F64,
    force_N: F64,
    parameters: AlignmentParameters,
    *,
    max_gap_s: float = FORCE_GAP_S,
) -> tuple[list[ImpulsePair], float]:
    """Return the synchronising impulses of both recordings, and the zero of the force's times [s].

    Args:
        counts: Event counts, camera clock.
        force_t_s: Force sample times, reference clock [s], increasing, ``float64``.
        force_N: Normal force [N], either sign, ``float64``.
        parameters: What counts as an impulse.
        max_gap_s: Longest stretch without force samples, in addition to four periods [s].

    Raises:
        NoImpulseError: Fewer than two impulses in one recording, or none that match.
        AmbiguousImpulsesError: More than one way to match.
        SaturatedImpulseError: An impulse went over the range of the force sensor.
        GapError: Force samples are missing.
    """
    if len(force_t_s) < FEWEST_SAMPLES:
        raise AlignmentError(
            f'{len(force_t_s)} force samples recorded: check the topic of the reference sensor'
        )
    start_s = float(np.floor(force_t_s[0]))
    time_s = force_t_s - start_s
    steps = np.diff(time_s)
    worst = int(np.argmax(steps))
    if steps[worst] > max(max_gap_s, 4.0 * float(np.median(steps))):
        raise GapError(
            f'{steps[worst]:.3f} s without force samples {time_s[worst] - time_s[0]:.2f} s into'
            ' the recording: samples were lost or the clock of the force sensor jumped; record'
            ' again'
        )
    reference = prefer_isolated(find_force_impulses(time_s, force_N, parameters), time_s, force_N)
    # Over intervals of 10 ms noise averages out, and taps stay.
    bins = 10_000 // counts.width_us
    whole = len(counts.counts) // bins
    rate = counts.counts[: whole * bins].reshape(whole, bins).sum(axis=1).astype(np.float64)
    centres = np.arange(0.5, whole, dtype=np.float64) * bins * counts.width_us * 1e-6
    camera = prefer_isolated(find_bursts(counts, parameters), centres, rate)
    return pair_impulses(camera, reference, 1e-6 * parameters.max_drift), start_s
