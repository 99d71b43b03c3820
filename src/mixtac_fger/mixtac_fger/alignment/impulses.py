# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Synchronising impulses: force peaks, and the pairing of impulses of two recordings.

An impulse is a sharp tap on the sensor. The force sensor sees a short peak, the camera a burst of
events. The delay of the force sensor's filter (1.5 to 3 ms for a stream of 800 Hz) cannot be
separated from the offset `b` and stays in it: a camera time maps to the stamp of the sample that
shows the force of that moment.

The pairing needs no knowledge of the clocks. `prefer_isolated` first discards impulses without a
still interval before and after them: a deliberate tap has both, a bouncing load does not. Two
impulses of one recording and two of the other define a candidate map, if the intervals between them
agree within the largest drift of the clocks. `pair_impulses` selects the candidate under which the
most impulses coincide.

`paired_impulses` does all of this (paper, section Aligning Data). Intervals without data are found
first. An interval without events, where noise alone would cause some, is marked as lost
(`mark_gaps`). A force recording with a gap is rejected (`require_continuous`), because its clock
may have changed at the gap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.alignment.errors import (
    AlignmentError,
    AmbiguousImpulsesError,
    GapError,
    NoImpulseError,
    SaturatedImpulseError,
)
from mixtac_fger.alignment.histories import EventCounts
from mixtac_fger.alignment.parameters import DEFAULTS, AlignmentParameters
from mixtac_fger.alignment.signals import (
    gaussian_smooth,
    noise_std,
    pressing_sign,
    prominent_peaks,
)

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


def vertex(t: NDArray[np.float64], value: NDArray[np.float64]) -> float:
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
    t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    parameters: AlignmentParameters = DEFAULTS,
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


def _top(force: NDArray[np.float64], peak: int, level: float, least: int = 2) -> tuple[int, int]:
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


def prefer_isolated(
    impulses: list[Impulse], time_s: NDArray[np.float64], signal: NDArray[np.float64]
) -> list[Impulse]:
    """Return the isolated impulses, or all where fewer than two are isolated.

    Args:
        impulses: Impulses found in a signal.
        time_s: Times of the signal [s], increasing, on the impulses' clock.
        signal: The signal in which the impulses were found: event rate or force, in any unit.
    """
    height = np.abs(signal - np.median(signal))
    chosen = [impulse for impulse in impulses if _is_isolated(impulse.time_s, time_s, height)]
    return chosen if len(chosen) >= 2 else impulses


def _is_isolated(at_s: float, time_s: NDArray[np.float64], height: NDArray[np.float64]) -> bool:
    far, left, right, end = np.searchsorted(
        time_s, (at_s - QUIET_S, at_s - IMPULSE_S, at_s + IMPULSE_S, at_s + QUIET_S)
    )
    own = height[left:right]
    around = np.concatenate([height[far:left], height[right:end]])
    if not len(own) or not len(around):
        return False
    return bool(around.max() < DISTURBANCE_SHARE * own.max())


MOST_IMPULSES: Final = 24
"""Impulses of each recording that are tried, the strongest ones."""
MATCH_S: Final = 0.02
"""Largest disagreement of a burst and a force peak that are the same tap [s]."""
RIVAL: Final = 0.8
"""If a second map explains this share of what the best map explains, the result is ambiguous."""


@dataclass(frozen=True, slots=True)
class ImpulsePair:
    """The same impulse in both recordings.

    Attributes:
        camera: In the events, camera clock.
        reference: In the force, reference clock.
        weight: How strong it is in both, 0 to 1.
    """

    camera: Impulse
    reference: Impulse
    weight: float


@dataclass(frozen=True, slots=True)
class _Match:
    offset_s: float
    score: float
    pairs: tuple[ImpulsePair, ...]


def pair_impulses(
    camera: list[Impulse],
    reference: list[Impulse],
    max_drift: float,
) -> tuple[ImpulsePair, ...]:
    """Pair the impulses of both recordings.

    Args:
        camera: Impulses in the events, at least two.
        reference: Impulses in the force, at least two.
        max_drift: Largest believable difference of clock rates.

    Returns:
        At least two pairs in the order of time.

    Raises:
        NoImpulseError: No two impulses agree.
        AmbiguousImpulsesError: Two different maps fit about as well.
    """
    events, forces = _leading(camera), _leading(reference)
    times = np.array([impulse.time_s for impulse in forces])
    matches = []
    for (e0, e1), (f0, f1) in product(combinations(events, 2), combinations(forces, 2)):
        span, other = e1.time_s - e0.time_s, f1.time_s - f0.time_s
        if abs(other - span) > max_drift * span + MATCH_S:
            continue
        pairs = []
        for impulse in events:
            at = f0.time_s + other / span * (impulse.time_s - e0.time_s)
            nearest = int(np.argmin(np.abs(times - at)))
            if abs(times[nearest] - at) <= MATCH_S:
                weight = _weight(impulse, events) * _weight(forces[nearest], forces)
                pairs.append(ImpulsePair(impulse, forces[nearest], float(np.sqrt(weight))))
        middle = events[len(events) // 2].time_s
        offset = f0.time_s + other / span * (middle - e0.time_s) - middle
        matches.append(_Match(offset, sum(pair.weight for pair in pairs), tuple(pairs)))
    if not matches:
        raise NoImpulseError(
            f'{len(camera)} impulses in the events and {len(reference)} in the force, but no two '
            'with the same time between them: record both over the same two taps'
        )
    best = max(matches, key=lambda match: match.score)
    for match in matches:
        apart = abs(match.offset_s - best.offset_s)
        if apart > 4.0 * MATCH_S and match.score > RIVAL * best.score:
            raise AmbiguousImpulsesError(
                f'impulses match at clock offsets of {best.offset_s:.3f} s and '
                f'{match.offset_s:.3f} s alike: leave other taps out, or tap twice at one end so '
                'that the pattern has one fit only'
            )
    return best.pairs


def _leading(impulses: list[Impulse]) -> list[Impulse]:
    chosen = sorted(impulses, key=lambda i: -i.strength)[:MOST_IMPULSES]
    return sorted(chosen, key=lambda i: i.time_s)


def _weight(impulse: Impulse, among: list[Impulse]) -> float:
    return impulse.strength / max(other.strength for other in among)


EVENT_GAP_S: Final = 0.02
"""Silence of the pixels that noise makes impossible [s]: at rest a sensor gives 20 events/ms."""
FEWEST_AT_REST: Final = 40.0
"""Events expected in such a silence, below which it means nothing."""
FORCE_GAP_S: Final = 0.05
"""Longest stretch without force samples [s]; after a longer one the clock may be another."""


def mark_gaps(counts: EventCounts) -> EventCounts:
    """Return counts in which stretches without a single event are marked as lost."""
    bins = max(1, round(EVENT_GAP_S * 1e6 / counts.width_us))
    if float(np.median(counts.counts)) * bins < FEWEST_AT_REST:
        return counts
    silent = np.concatenate([[False], counts.counts == 0, [False]])
    turns = np.flatnonzero(np.diff(silent.astype(np.int8)))
    found = tuple(
        (int(first), int(end))
        for first, end in zip(turns[::2], turns[1::2], strict=True)
        if end - first >= bins
    )
    return replace(counts, lost=counts.lost + found)


def require_continuous(t_s: NDArray[np.float64], largest_s: float = FORCE_GAP_S) -> None:
    """Refuse force samples with a gap, behind which the clock may be another.

    Args:
        t_s: Times of the samples [s].
        largest_s: Gap that is still believed to be lost samples only [s].

    Raises:
        GapError: Samples are further apart than that and four periods.
    """
    steps = np.diff(t_s)
    worst = int(np.argmax(steps))
    if steps[worst] > max(largest_s, 4.0 * float(np.median(steps))):
        raise GapError(
            f'{steps[worst]:.3f} s without force samples {t_s[worst] - t_s[0]:.2f} s into the '
            'recording: samples were lost or the clock of the force sensor jumped; record again'
        )


FEWEST_SAMPLES: Final = 16
"""Samples of the force in which an impulse can be found."""
STRONG: Final = 0.02
"""Pairs with this part of the strongest one's weight are impulses; that of a dropped load may be
thirty times that of a tap."""


def paired_impulses(
    counts: EventCounts,
    force_t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    parameters: AlignmentParameters,
    *,
    max_gap_s: float = FORCE_GAP_S,
) -> tuple[tuple[ImpulsePair, ...], float]:
    """Return the synchronising impulses of both recordings, and the zero of the force's times [s].

    Args:
        counts: Event counts, camera clock.
        force_t_s: Force sample times, reference clock [s], increasing, ``float64``.
        force_N: Normal force [N], either sign, ``float64``.
        parameters: What counts as an impulse, latency of the events, limits of clocks.
        max_gap_s: Longest stretch without force samples [s].

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
    require_continuous(time_s, max_gap_s)
    reference = prefer_isolated(find_force_impulses(time_s, force_N, parameters), time_s, force_N)
    camera = find_bursts(mark_gaps(counts), parameters)
    camera = prefer_isolated(camera, *_coarse_rate(counts))
    _require_two(reference, 'force', f'tap so that the force passes {parameters.min_force:g} N')
    _require_two(camera, 'event rate', 'tap sharply on the gel, and check for lost packets')
    pairs = pair_impulses(camera, reference, 1e-6 * parameters.max_drift)
    return _synchronising(pairs), start_s


def _coarse_rate(counts: EventCounts) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return centres [s] and event counts of intervals of 10 ms: noise averages out, taps stay."""
    bins = max(1, round(10_000 / counts.width_us))
    whole = len(counts.counts) // bins
    rate = counts.counts[: whole * bins].reshape(whole, bins).sum(axis=1).astype(np.float64)
    centres = (np.arange(whole) + 0.5) * bins * counts.width_us * 1e-6
    return np.asarray(centres, np.float64), rate


def _synchronising(pairs: tuple[ImpulsePair, ...]) -> tuple[ImpulsePair, ...]:
    least = STRONG * max(pair.weight for pair in pairs)
    strong = tuple(pair for pair in pairs if pair.weight >= least)
    if len(strong) < 2:
        raise NoImpulseError(
            'only one strong impulse is in both recordings: tap once at the beginning and once at '
            'the end, about equally hard'
        )
    for pair in strong:
        if pair.reference.saturated:
            raise SaturatedImpulseError(
                f'the force peak {pair.reference.time_s:.3f} s into the recording is cut off at '
                'the range of the force sensor: tap more gently'
            )
    return strong


def _require_two(impulses: list[Impulse], where: str, remedy: str) -> None:
    if len(impulses) < 2:
        times = ', '.join(f'{impulse.time_s:.2f} s' for impulse in impulses) or 'none'
        raise NoImpulseError(
            f'found {len(impulses)} impulses in the {where} ({times}), two are needed: {remedy}, '
            'once at the beginning and once at the end'
        )
