# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock map from the taps at both ends, with the help of frames: two impulses, done better.

Bursts of the smoothed event rate are paired with force peaks to about 10 ms; this takes no trough,
which mismatched pixels can hide or double. The frames, laid over the force by that map, say which
parts of the image brighten under force. The signed events of each tap are then fitted with the
course of the force (`tap_waveform`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.clock_fit import Anchor, ClockFit, fit_clock, with_drift_prior
from mixtac_alignment.errors import NoImpulseError
from mixtac_alignment.force_smoothing import smooth_force
from mixtac_alignment.gaussian_smoothing import gaussian_smooth
from mixtac_alignment.impulses import Impulse, ImpulseSettings, strongest
from mixtac_alignment.prominent_peaks import prominent_peaks
from mixtac_alignment.tap_waveform import TapModel, brightening, common_course, depth_of, tap_signal
from mixtac_alignment.two_impulse import paired_impulses

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.event_history import CellEvents
    from mixtac_alignment.frame_features import FrameFeatures
    from mixtac_alignment.gel_lag import GelLag
    from mixtac_alignment.pairing import ImpulsePair
    from mixtac_alignment.rate_history import EventCounts

SMOOTHING_S: Final = 0.006
"""Standard deviation of the smoothing that makes one burst of a tap."""
BURST_STD_S: Final = 0.003
BURST_LATENCY_S: Final = 0.001
"""How much later than the force peak the smoothed burst peaks."""
MATCH_S: Final = 0.02
TAP_STD_S: Final = 4.5e-4
"""Scatter of taps of one sensor, found on simulated trials outside the benchmark."""
COMMON_STD_S: Final = 1.0e-3
"""The same where the frames do not show the deformation of the tap, but that of another object."""
DOUBTFUL_MISFIT: Final = 0.4
LARGEST_MISFIT: Final = 0.65
"""Share of a tap's signal that may be left: 0.05 to 0.3 on simulated trials."""
FEWEST_FRAMES: Final = 20
UNLOADED_PERCENT: Final = 5.0
"""The sensor is free for at least this part of a recording, before and after the taps."""


def fit_taps(
    counts: EventCounts,
    events: CellEvents,
    frames: FrameFeatures,
    force_t_s: NDArray[np.float64],
    force_N: NDArray[np.float64],
    settings: ImpulseSettings | None = None,
    lag: GelLag | None = None,
    *,
    use_all: bool = False,
) -> ClockFit:
    """Fit the clock map to the first and the last tap.

    Args:
        counts: Event counts, camera clock.
        events: Events around the taps at least, camera clock.
        frames: Frames, camera clock.
        force_t_s: Force sample times, reference clock [s], increasing.
        force_N: Normal force [N], either sign.
        settings: What counts as a tap, and the latency of the events.
        lag: What is known of the gel.
        use_all: Fit all strong taps by least squares instead of the first and the last.

    Raises:
        AlignmentError: As `two_impulse.fit_counts`, or taps whose events do not follow the force.
    """
    chosen = replace(settings or ImpulseSettings(), match_s=MATCH_S)
    pairs, start_s = paired_impulses(
        counts, force_t_s, force_N, chosen, lambda marked: find_bursts(marked, chosen)
    )
    used = pairs if use_all else (pairs[0], pairs[-1])
    t_s, force = _even(force_t_s - start_s, force_N)
    weight = _weights(pairs, counts.start_us, frames, t_s, force)
    anchors = [
        _anchor(
            pair,
            counts.start_us,
            start_s,
            events,
            weight,
            TapModel(t_s, force, pair.reference.time_s, lag, loaded=number > 0),
            chosen,
        )
        for number, pair in enumerate(used)
    ]
    fit = fit_clock(
        anchors,
        min_baseline_s=chosen.min_baseline_s,
        max_drift=chosen.max_drift,
        common_std_s=chosen.tap_latency_std_s,
    )
    return with_drift_prior(fit, chosen.drift_std)


def find_bursts(counts: EventCounts, settings: ImpulseSettings) -> list[Impulse]:
    """Find bursts of the smoothed event rate that are as short as a tap's.

    Args:
        counts: Event counts, camera clock.
        settings: What counts as an impulse.

    Returns:
        Impulses in the order of time, relative to the start of the counts.
    """
    width_s = counts.width_us * 1e-6
    rate = counts.counts.astype(np.float64) / width_s
    smooth = gaussian_smooth(rate, SMOOTHING_S / width_s)
    window = 2 * round(4.0 * settings.max_width_s / width_s) + 1
    peaks = prominent_peaks(smooth, settings.min_burst_rate, window)
    reach = round(0.05 / width_s)
    impulses = [
        Impulse((peak + 0.5) * width_s, BURST_STD_S, float(height), float(width) * width_s)
        for peak, height, width in zip(*peaks, strict=True)
        if width * width_s <= 1.5 * settings.max_width_s and not counts.lost_near(int(peak), reach)
    ]
    return strongest(impulses, settings.min_spacing_s)


def _even(
    t_s: NDArray[np.float64], force_N: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return smooth force on even times, pressing positive."""
    period = float(np.median(np.diff(t_s)))
    even = np.arange(t_s[0], t_s[-1], period)
    force = smooth_force(np.interp(even, t_s, force_N), period)
    turned = force - np.median(force)
    pressing = force if turned.max() >= -turned.min() else -force
    return even, pressing - np.percentile(pressing, UNLOADED_PERCENT)


def _weights(
    pairs: tuple[ImpulsePair, ...],
    start_us: int,
    frames: FrameFeatures,
    t_s: NDArray[np.float64],
    force: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the weights of the cells from frames laid over the force by the coarse map."""
    first, last = pairs[0], pairs[-1]
    span = last.camera.time_s - first.camera.time_s
    rate = (last.reference.time_s - first.reference.time_s) / span
    middle = 0.5 * ((frames.start_us - start_us) + (frames.end_us - start_us)) * 1e-6
    at = first.reference.time_s + rate * (middle - first.camera.time_s + BURST_LATENCY_S)
    inside = (at > t_s[0]) & (at < t_s[-1])
    if int(inside.sum()) < FEWEST_FRAMES:
        raise NoImpulseError(
            f'{int(inside.sum())} frames while the force was recorded, {FEWEST_FRAMES} are needed '
            'to tell deformation in the events: record frames too, or use the impulses alone'
        )
    return brightening(frames.values[inside], depth_of(np.interp(at[inside], t_s, force)))


def _anchor(
    pair: ImpulsePair,
    start_us: int,
    start_s: float,
    events: CellEvents,
    weight: NDArray[np.float64],
    model: TapModel,
    settings: ImpulseSettings,
) -> Anchor:
    expected_us = start_us + round(1e6 * (pair.camera.time_s - BURST_LATENCY_S))
    found, std_s = model.fit(*tap_signal(events, expected_us, weight)), TAP_STD_S
    if found.misfit > DOUBTFUL_MISFIT:
        common = common_course(events, expected_us, len(weight))
        for own in (common, -common):
            other = model.fit(*tap_signal(events, expected_us, own))
            if other.misfit < found.misfit:
                found, std_s = other, COMMON_STD_S
    if found.misfit > LARGEST_MISFIT:
        raise NoImpulseError(
            f'the events {pair.camera.time_s:.2f} s into the recording do not follow the force of '
            f'the tap ({100.0 * found.misfit:.0f} % are left over): tap on the gel once, sharply'
        )
    at_us = expected_us + round(1e6 * (found.delay_s - settings.tap_latency_s))
    return Anchor(at_us, start_s + pair.reference.time_s, std_s)
