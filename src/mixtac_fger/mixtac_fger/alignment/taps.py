# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""The clock map from complete taps: all their events are compared with the force curve.

Bursts of the smoothed event rate are paired with force peaks to about 10 ms. This step does not use
the trough between the two bursts of a tap, which pixels with unequal thresholds can hide or double.
With this first map, frames and force are compared, which shows the parts of the image that brighten
under force. The signed events of each tap are then fitted with the events that the force curve
predicts.

The force, through the lag of the gel, gives the depth of the tap, :math:`d \propto \sqrt{F_e}` (the
force of a ball on a thin layer grows with the square of its depth). Pixels whose log brightness
follows the depth fire each time it has moved by a threshold, and pixels differ in how many
thresholds the tap moves them by. The model is a sum, with non-negative weights, of the expected
events of a few classes of pixels. It explains what a plain comparison of rates cannot: the second
burst starts late and is smaller, because pixels must first come back by their threshold. ON and OFF
events count with opposite signs, weighted by how much each part of the image brightens under force
in the frames, so that bursts without deformation cancel.

The last event of a pixel that a load brightened and released is OFF, so the pixel is nearer to its
OFF threshold than to its ON threshold. It responds to the next load later than a pixel at a random
distance from its thresholds. Noise and leak make these distances random again. At the first tap of
a recording, the distances of all pixels are assumed to be uniformly distributed; at later taps,
half of the pixels are assumed to be in the state after a load.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_fger.alignment.clock_fit import Anchor, ClockFit, NoImpulseError, fit_clock
from mixtac_fger.alignment.histories import CellEvents, FrameFeatures, Recording
from mixtac_fger.alignment.impulses import (
    FORCE_GAP_S,
    ImpulsePair,
    gaussian_smooth,
    noise_std,
    paired_impulses,
    pressing_sign,
)
from mixtac_fger.alignment.parameters import DEFAULTS, AlignmentParameters

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

SCALES_S: Final = (0.0025, 0.005, 0.010)
"""Standard deviations of the Gaussians between which the bands of a force lie [s]."""
CAUTION: Final = 2.5
"""Factor on the noise power: power is estimated from few samples."""
HALF_KERNEL: Final = 200
"""Samples to both sides of an impulse that show the filters completely."""


def even_force(t_s: F64, force_N: F64) -> tuple[F64, F64]:
    """Return evenly spaced times within the samples [s], and the smooth force there [N].

    It is wavelet shrinkage without decimation. Quiet stretches are smoothed over many samples, so
    that the slope of the force is known well; a band whose local power stands out of the noise, as
    in a tap or a bounce, is kept. All filters are symmetric in time and add no delay.

    Args:
        t_s: Increasing sample times [s], ``float64 [n]``, small numbers.
        force_N: Force [N], ``float64 [n]``.
    """
    period = float(np.median(np.diff(t_s)))
    even = np.arange(t_s[0], t_s[-1], period)
    finer = force = np.interp(even, t_s, force_N)
    power = noise_std(force) ** 2
    kernel = impulse = np.eye(1, 2 * HALF_KERNEL + 1, HALF_KERNEL)[0]
    kept = np.zeros_like(force)
    for scale_s in SCALES_S:
        width = scale_s / period
        coarser, wider = gaussian_smooth(force, width), gaussian_smooth(impulse, width)
        noise = power * float(np.sum((kernel - wider) ** 2))
        band = finer - coarser
        local = gaussian_smooth(band**2, 2.0 * width)
        kept += band * np.clip(1.0 - CAUTION * noise / np.maximum(local, 1e-12), 0.0, 1.0)
        finer, kernel = coarser, wider
    return even, finer + kept


STEP_S: Final = 1e-4
"""Time step of the model [s]."""
BIN_US: Final = 500
"""Bin of the events that are fitted [us]."""
BEFORE_S: Final = 0.06
"""Time before a tap from which its events are counted [s]."""
AFTER_S: Final = 0.10
"""Time after a tap up to which its events are counted [s]."""
FITTED_S: Final = 0.03
"""Time to both sides of the force peak that is fitted [s]; taps last 20 to 40 ms."""
SEARCH_S: Final = 0.014
"""How far from the expected moment the tap may be [s]."""
GAINS: Final = (0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 8.0, 13.0)
"""Thresholds that a tap moves the pixels of a class by."""
OFF_OVER_ON: Final = 1.3
"""OFF over ON threshold of a DAVIS346 at its usual biases: 0.27 over 0.21 log-e."""
PIXEL_S: Final = 5e-4
"""Time constant of the pixels [s]; additional delay counts as latency."""
PHASES: Final = 24
"""Distances to the threshold at which the pixels of a class start."""
COURSE_BIN_US: Final = 4000
"""Bin of the events in `common_course` [us]."""
COURSE_BINS: Final = 18
"""Bins of `common_course`, from `FITTED_S` before the tap on."""
LEAST_FORCE_N: Final = 0.02
"""Rounds the square root where the contact begins [N]."""
DARKER: Final = 0.02
"""Noise of a cell's log brightness (natural logarithm)."""


class TapFit(NamedTuple):
    """A tap found in the events.

    Attributes:
        delay_s: How much later than expected it shows [s].
        misfit: Share of the signal's power that the model leaves.
    """

    delay_s: float
    misfit: float


def brightening(values: NDArray[np.float32], depth: F64) -> F64:
    """Return weights that make the cells' change of brightness one signal, ``[cells]``.

    Args:
        values: Log brightness of the cells in each frame, ``[n, cells]``.
        depth: Depth at each frame, in any unit, ``[n]``.
    """
    centred = values - values.mean(axis=0)
    moved = depth - depth.mean()
    slope = (centred.T @ moved) / max(float(moved @ moved), 1e-12)
    scatter = np.var(centred - np.outer(moved, slope), axis=0)
    return np.asarray(slope / (scatter + DARKER**2), np.float64)


def common_course(events: CellEvents, at_us: int, cells: int) -> F64:
    """Return weights under which the cells' signed events of a tap have most in common.

    They are the first singular vector of events over cells and time, of either sign.

    Args:
        events: Events, camera clock.
        at_us: Expected moment of the tap, camera clock [us].
        cells: Number of cells.
    """
    start = at_us - round(1e6 * FITTED_S)
    near = events.between(start, start + COURSE_BINS * COURSE_BIN_US)
    inside = near.cell < cells
    cell = near.cell[inside].astype(np.int64)
    place = cell * COURSE_BINS + (near.t_us[inside] - start) // COURSE_BIN_US
    signed = np.bincount(
        place, np.where(near.on[inside], 1.0, -OFF_OVER_ON), cells * COURSE_BINS
    ).reshape(cells, COURSE_BINS)
    noise = np.sqrt(np.bincount(cell, minlength=cells) + 5.0)
    common = np.linalg.svd(signed / noise[:, None], full_matrices=False)[0][:, 0]
    return np.asarray(common / noise, np.float64)


def depth_of(force_N: F64) -> F64:
    """Return the depth under a force [N], in any unit."""
    force = np.maximum(force_N, 0.0)
    return np.asarray(np.sqrt(force + LEAST_FORCE_N) - np.sqrt(LEAST_FORCE_N))


LAG_TIMES_S: Final = (0.7e-3, 4.1e-3, 0.055, 1.05, 20.0)
"""Retardation times of a soft silicone [s]."""
LAG_WEIGHTS: Final = (0.26, 0.26, 0.035, 0.035, 0.03)
"""Weight of the response with each time."""


def elastic_force(t_s: F64, force_N: F64, at_s: F64) -> F64:
    """Return the elastic part of a force, which the deformation of the gel follows.

    The force on a layer of silicone leads its deformation: F = F_e + sum h_i with
    ``dh_i/dt = -h_i / tau_i + g_i dF_e/dt`` (quasi-linear viscoelasticity, Prony series). Expressed
    by the force, F_e = F - sum w_i H_i, where H_i is the force after a high-pass filter with the
    time constant T_i.

    Args:
        t_s: Times of evenly sampled force [s].
        force_N: Force [N].
        at_s: Times at which the elastic part is returned, in steps of `STEP_S` [s].
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import lfilter

    force = CubicSpline(t_s, force_N, bc_type='natural')(at_s)
    change = np.diff(force, prepend=force[0])
    for time_s, weight in zip(LAG_TIMES_S, LAG_WEIGHTS, strict=True):
        decay = float(np.exp(-STEP_S / time_s))
        gain = time_s / STEP_S * (1.0 - decay)
        force = force - weight * lfilter([gain], [1.0, -decay], change)
    return np.asarray(force, np.float64)


class TapModel:
    """Predicted events for a force profile.

    Args:
        t_s: Sample times [s], reference clock, evenly spaced, ``float64 [n]``.
        force_N: Smooth force, pressing positive [N], ``float64 [n]``.
        at_s: Time of the force peak [s].
        loaded: Whether the sensor has been loaded before in the recording.
    """

    def __init__(self, t_s: F64, force_N: F64, at_s: float, *, loaded: bool = False) -> None:
        near = (t_s > at_s - 0.15) & (t_s < at_s + 0.2)
        t, force = t_s[near] - at_s, force_N[near]
        rest = float(np.median(force[t < -0.05])) if np.any(t < -0.05) else 0.0
        start, end = max(-BEFORE_S, float(t[0]) + STEP_S), min(AFTER_S, float(t[-1]) - STEP_S)
        fine = np.arange(start, end, STEP_S)
        depth = depth_of(elastic_force(t, force - rest, fine))
        depth /= max(float(depth.max()), 1e-9)
        classes = np.stack([_events(depth, gain, loaded=loaded) for gain in GAINS])
        self._edges = np.append(fine - 0.5 * STEP_S, fine[-1] + 0.5 * STEP_S)
        self._total = np.pad(np.cumsum(classes, axis=1), ((0, 0), (1, 0)))

    def fit(self, edges_s: F64, signal: F64) -> TapFit:
        """Return when the tap shows in a signal.

        Args:
            edges_s: Edges of the bins [s], from the expected moment of the force peak, ``[m + 1]``.
            signal: Signed events per bin, ``[m]``.
        """
        used = (edges_s[:-1] >= -FITTED_S) & (edges_s[1:] <= FITTED_S)
        power = float(signal[used] @ signal[used])
        if power <= 0.0:
            return TapFit(0.0, 1.0)
        coarse = np.arange(-SEARCH_S, SEARCH_S + 1e-9, 1e-3)
        left = np.array([self._left(x, edges_s, signal, used) for x in coarse])
        fine = coarse[int(np.argmin(left))] + np.arange(-1.2e-3, 1.3e-3, 2e-4)
        left = np.array([self._left(x, edges_s, signal, used) for x in fine])
        k = int(np.clip(np.argmin(left), 2, len(left) - 3))
        bend, slope, _ = np.polyfit(fine[k - 2 : k + 3] - fine[k], left[k - 2 : k + 3], 2)
        aside = -slope / (2.0 * bend) if bend > 0.0 else 0.0
        return TapFit(float(fine[k] + np.clip(aside, -4e-4, 4e-4)), float(left[k]) / power)

    def _left(self, delay_s: float, edges_s: F64, signal: F64, used: Bools) -> float:
        at = edges_s - delay_s
        design = np.stack([np.diff(np.interp(at, self._edges, row))[used] for row in self._total])
        from scipy.optimize import nnls

        try:
            left = nnls(design.T, signal[used])[1]
        except RuntimeError:  # too many steps: as if no weights explained the signal
            left = np.linalg.norm(signal[used])
        return float(left) ** 2


def tap_signal(events: CellEvents, at_us: int, weight: F64) -> tuple[F64, F64]:
    """Return the edges of time bins around a moment [s], and the signed events in each bin.

    Args:
        events: Events, camera clock.
        at_us: The moment, camera clock [us].
        weight: Weight of each cell by which its events are multiplied.
    """
    start, count = at_us - round(1e6 * BEFORE_S), round(1e6 * (BEFORE_S + AFTER_S)) // BIN_US
    near = events.between(start, start + count * BIN_US)
    inside = near.cell < len(weight)
    bins = (near.t_us[inside] - start) // BIN_US
    size = np.where(near.on[inside], 1.0, -OFF_OVER_ON) * weight[near.cell[inside]]
    edges_us = start - at_us + np.arange(count + 1) * BIN_US
    return edges_us.astype(np.float64) * 1e-6, np.bincount(bins, size, count).astype(np.float64)


def _events(depth: F64, gain: float, *, loaded: bool) -> F64:
    keep = float(np.exp(-STEP_S / PIXEL_S))
    fired = np.asarray(_fire(gain * depth, keep, 0.0))
    if loaded:
        fired = 0.5 * (fired + _fire(gain * depth, keep, gain))
    return np.asarray(fired / gain)


@njit(cache=True, nogil=True)
def _fire(course: F64, keep: float, before: float) -> F64:
    """Return the signed events per step of pixels that start at all distances to their thresholds.

    A pixel follows the course, in ON thresholds, through a low-pass of first order. From where it
    starts, a load that moved it by `before`, spread by 0.6 to 1.4, has come and gone.
    """
    fired = np.zeros(len(course))
    for phase in range(PHASES):
        value = course[0]
        last = value + OFF_OVER_ON - (1.0 + OFF_OVER_ON) * (phase + 0.5) / PHASES
        # A stride that is coprime to the number of PHASES: loads independent of the start.
        top = value + before * (0.6 + 0.8 * (phase * 7 % PHASES) / PHASES)
        while top - last >= 1.0:
            last += 1.0
        while value - last <= -OFF_OVER_ON:
            last -= OFF_OVER_ON
        for i in range(1, len(course)):
            value = keep * value + (1.0 - keep) * course[i]
            while value - last >= 1.0:
                last += 1.0
                fired[i] += 1.0
            while value - last <= -OFF_OVER_ON:
                last -= OFF_OVER_ON
                fired[i] -= OFF_OVER_ON
    return fired / PHASES


BURST_LATENCY_S: Final = 0.001
"""Delay from the force peak to the peak of the smoothed burst [s]."""
TAP_STD_S: Final = 4.5e-4
"""Scatter of taps of one sensor [s], found on simulated trials outside the benchmark."""
COMMON_STD_S: Final = 1.0e-3
"""Scatter of taps whose deformation the frames do not show, because another object made it [s]."""
DOUBTFUL_MISFIT: Final = 0.4
"""Share of a tap's signal left over from which the weights of the frames are doubted."""
LARGEST_MISFIT: Final = 0.65
"""Share of a tap's signal that may be left: 0.05 to 0.3 on simulated trials."""
FEWEST_FRAMES: Final = 20
"""Frames while the force was recorded that show which cells brighten under force."""
UNLOADED_PERCENT: Final = 5.0
"""Percentile of the force that counts as unloaded: before and after the taps nothing touches."""


def fit_taps(
    recording: Recording,
    parameters: AlignmentParameters = DEFAULTS,
    *,
    max_gap_s: float = FORCE_GAP_S,
) -> ClockFit:
    """Fit the clock map to the first and the last tap, or to all of them.

    Without some twenty frames, the direction that the events of a tap share weighs the cells.

    Args:
        recording: The recording.
        parameters: What counts as a tap, the latency of the events, limits of clocks.
        max_gap_s: Longest stretch without force samples [s].

    Raises:
        AlignmentError: As `impulses.paired_impulses`, or taps whose events do not follow the
            force.
    """
    counts, events = recording.counts, recording.events
    force_t_s, force_N = recording.force_t_s, recording.force
    pairs, start_s = paired_impulses(counts, force_t_s, force_N, parameters, max_gap_s=max_gap_s)
    used = pairs if parameters.use_all else (pairs[0], pairs[-1])
    t_s, force = even_force(force_t_s - start_s, force_N)
    force = pressing_sign(force) * force
    force -= np.percentile(force, UNLOADED_PERCENT)
    weight = _weights(pairs, counts.start_us, recording.frames, t_s, force)
    if weight is None:
        weight = np.zeros(int(events.cell.max(initial=0)) + 1)
    anchors = []
    for number, pair in enumerate(used):
        model = TapModel(t_s, force, pair.reference.time_s, loaded=number > 0)
        expected_us = counts.start_us + round(1e6 * (pair.camera.time_s - BURST_LATENCY_S))
        found, std_s = _delay(model, events, expected_us, weight)
        if found.misfit > LARGEST_MISFIT:
            raise NoImpulseError(
                f'the events {pair.camera.time_s:.2f} s into the recording do not follow the force '
                f'of the tap ({100.0 * found.misfit:.0f} % are left over): tap on the gel once, '
                'sharply'
            )
        at_us = expected_us + round(1e6 * (found.delay_s - 1e-3 * parameters.tap_latency))
        anchors.append(Anchor(at_us, start_s + pair.reference.time_s, std_s))
    return fit_clock(
        anchors,
        min_baseline_s=parameters.min_baseline,
        max_drift=1e-6 * parameters.max_drift,
        common_std_s=1e-3 * parameters.tap_latency_std,
        drift_std=1e-6 * parameters.drift_std,
    )


def _weights(
    pairs: list[ImpulsePair], start_us: int, frames: FrameFeatures | None, t_s: F64, force: F64
) -> F64 | None:
    """Return the weights of the cells from frames laid over the force by the coarse map.

    They are None without enough frames.
    """
    if frames is None:
        return None
    first, last = pairs[0], pairs[-1]
    span = last.camera.time_s - first.camera.time_s
    rate = (last.reference.time_s - first.reference.time_s) / span
    middle = 0.5 * ((frames.start_us - start_us) + (frames.end_us - start_us)) * 1e-6
    at = first.reference.time_s + rate * (middle - first.camera.time_s + BURST_LATENCY_S)
    inside = (at > t_s[0]) & (at < t_s[-1])
    if int(inside.sum()) < FEWEST_FRAMES:
        return None
    return brightening(frames.values[inside], depth_of(np.interp(at[inside], t_s, force)))


def _delay(
    model: TapModel, events: CellEvents, expected_us: int, weight: F64
) -> tuple[TapFit, float]:
    """Return the tap found about an expected moment, and its standard deviation [s]."""
    found, std_s = model.fit(*tap_signal(events, expected_us, weight)), TAP_STD_S
    if found.misfit > DOUBTFUL_MISFIT:
        common = common_course(events, expected_us, len(weight))
        for own in (common, -common):
            other = model.fit(*tap_signal(events, expected_us, own))
            if other.misfit < found.misfit:
                found, std_s = other, COMMON_STD_S
    return found, std_s
