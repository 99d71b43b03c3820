# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map from two synchronising impulses (paper, section Aligning Data).

Stretches without data are found first: events missing where noise alone would have made some are
marked as lost (`mark_gaps`), and a force recording with a gap is refused (`require_continuous`),
because the clock behind it may be another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_alignment.clock_fit import Anchor
from mixtac_alignment.errors import AlignmentError, GapError, NoImpulseError, SaturatedImpulseError
from mixtac_alignment.histories import EventCounts
from mixtac_alignment.impulses import (
    MATCH_S,
    Impulse,
    ImpulsePair,
    find_force_impulses,
    pair_impulses,
    prefer_isolated,
)
from mixtac_alignment.parameters import AlignmentParameters

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
    if len(t_s) < 3:
        return
    steps = np.diff(t_s)
    worst = int(np.argmax(steps))
    if steps[worst] > max(largest_s, 4.0 * float(np.median(steps))):
        raise GapError(
            f'{steps[worst]:.3f} s without force samples {t_s[worst] - t_s[0]:.2f} s into the '
            'recording: samples were lost or the clock of the force sensor jumped; record again'
        )


STRONG: Final = 0.02
"""Pairs with this part of the strongest one's weight are impulses; that of a dropped load may be
thirty times that of a tap."""


def paired_impulses(
    counts: EventCounts,
    force_t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    parameters: AlignmentParameters,
    find: Callable[[EventCounts, AlignmentParameters], list[Impulse]],
    *,
    match_s: float = MATCH_S,
    max_gap_s: float = FORCE_GAP_S,
) -> tuple[tuple[ImpulsePair, ...], float]:
    """Return the synchronising impulses of both recordings, and the zero of the force's times [s].

    Args:
        counts: Event counts, camera clock.
        force_t_s: Force sample times, reference clock [s], increasing, ``float64``.
        force_N: Normal force [N], either sign, ``float64``.
        parameters: What counts as an impulse, latency of the events, limits of clocks.
        find: Finds impulses in event counts in which gaps are marked, by the parameters.
        match_s: Largest disagreement of two impulses that are the same [s].
        max_gap_s: Longest stretch without force samples [s].

    Raises:
        NoImpulseError: Fewer than two impulses in one recording, or none that match.
        AmbiguousImpulsesError: More than one way to match.
        SaturatedImpulseError: An impulse went over the range of the force sensor.
        GapError: Force samples are missing.
    """
    if len(force_t_s) == 0:
        raise AlignmentError('no force recorded: check the topic of the reference sensor')
    start_s = float(np.floor(force_t_s[0]))
    time_s = force_t_s - start_s
    require_continuous(time_s, max_gap_s)
    reference = prefer_isolated(find_force_impulses(time_s, force_N, parameters), time_s, force_N)
    camera = prefer_isolated(find(mark_gaps(counts), parameters), *_coarse_rate(counts))
    _require_two(reference, 'force', f'tap so that the force passes {parameters.min_force:g} N')
    _require_two(camera, 'event rate', 'tap sharply on the gel, and check for lost packets')
    pairs = pair_impulses(camera, reference, parameters.max_drift_rate, match_s)
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


def _anchor(pair: ImpulsePair, camera_start_us: int, reference_start_s: float) -> Anchor:
    return Anchor(
        camera_us=camera_start_us + round(pair.camera.time_s * 1e6),
        reference_s=reference_start_s + pair.reference.time_s,
        std_s=float(np.hypot(pair.camera.std_s, pair.reference.std_s)),
    )


def _require_two(impulses: list[Impulse], where: str, remedy: str) -> None:
    if len(impulses) < 2:
        times = ', '.join(f'{impulse.time_s:.2f} s' for impulse in impulses) or 'none'
        raise NoImpulseError(
            f'found {len(impulses)} impulses in the {where} ({times}), two are needed: {remedy}, '
            'once at the beginning and once at the end'
        )
