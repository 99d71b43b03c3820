# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""When a tap happened, from the whole course of its events against the whole course of its force.

The force, through the gel's lag, gives the depth of the tap, :math:`d \propto \sqrt{F_e}` (the
force of a ball on a thin layer grows with the square of its depth). Pixels whose log brightness
follows the depth fire each time it has moved by a threshold. Pixels differ in how many thresholds
the tap moves them: the expected events of a few classes of them, non-negative weights of which are
fitted, make the model. It has what a plain comparison of rates lacks: the second burst starts late
and is smaller, because pixels must first come back by their threshold. ON and OFF events count with
opposite signs, weighted by how much each part of the image brightens under force in the frames;
bursts that are no deformation cancel.

A pixel that a load has brightened and that has come back last fired OFF, so it stands nearer to its
OFF threshold: the next load shows later in it than in one that stands anywhere. Noise and leak
scatter pixels again. Pixels are taken to stand anywhere at the first tap of a recording, and half
of them to stand where a load left them at later ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit

from mixtac_alignment.gel_lag import GelLag, LaggedForce
from mixtac_alignment.nonnegative_fit import nonnegative_left

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.event_history import CellEvents

STEP_S: Final = 1e-4
BIN_US: Final = 500
BEFORE_S: Final = 0.06
AFTER_S: Final = 0.10
"""Time around a tap in which its events are counted."""
FITTED_S: Final = 0.03
"""Time to both sides of the force peak that is fitted; taps last 20 to 40 ms."""
SEARCH_S: Final = 0.014
"""How far from the expected moment the tap may be."""
GAINS: Final = (0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 8.0, 13.0)
"""Thresholds that a tap moves the pixels of a class by."""
OFF_OVER_ON: Final = 1.3
"""OFF over ON threshold of a DAVIS346 at its usual biases: 0.27 over 0.21 log-e."""
PIXEL_S: Final = 5e-4
"""Time constant of the pixels; what they are slower belongs to the latency."""
PHASES: Final = 24
COURSE_BIN_US: Final = 4000
COURSE_BINS: Final = 18
LEAST_FORCE_N: Final = 0.02
"""Rounds the root where the contact begins."""
DARKER: Final = 0.02
"""Noise of a cell's log brightness."""


class TapFit(NamedTuple):
    """A tap found in the events.

    Attributes:
        delay_s: How much later than expected it shows [s].
        misfit: Share of the signal's power that the model leaves.
    """

    delay_s: float
    misfit: float


def brightening(values: NDArray[np.float32], depth: NDArray[np.float64]) -> NDArray[np.float64]:
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


def common_course(events: CellEvents, at_us: int, cells: int) -> NDArray[np.float64]:
    """Return weights under which the cells' signed events of a tap have most in common.

    The first singular vector of events over cells and time, which takes no frames; of either sign.

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


def depth_of(force_N: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the depth under a force [N], in any unit."""
    force = np.maximum(force_N, 0.0)
    return np.asarray(np.sqrt(force + LEAST_FORCE_N) - np.sqrt(LEAST_FORCE_N))


class TapModel:
    """The events that a force lets expect.

    Args:
        t_s: Sample times [s], reference clock, evenly spaced, ``float64 [n]``.
        force_N: Smooth force, pressing positive [N], ``float64 [n]``.
        at_s: Time of the force peak [s].
        lag: What is known of the gel.
        loaded: Whether the sensor has been loaded before in the recording.
    """

    def __init__(
        self,
        t_s: NDArray[np.float64],
        force_N: NDArray[np.float64],
        at_s: float,
        lag: GelLag | None = None,
        *,
        loaded: bool = False,
    ) -> None:
        near = (t_s > at_s - 0.15) & (t_s < at_s + 0.2)
        t, force = t_s[near] - at_s, force_N[near]
        rest = float(np.median(force[t < -0.05])) if np.any(t < -0.05) else 0.0
        start, end = max(-BEFORE_S, float(t[0]) + STEP_S), min(AFTER_S, float(t[-1]) - STEP_S)
        fine = np.arange(start, end, STEP_S)
        mean, _ = LaggedForce(t, force - rest).mean(fine - 0.5 * STEP_S, fine + 0.5 * STEP_S)
        depth = depth_of(mean[:, 0] - mean[:, 1:] @ np.array((lag or GelLag()).mean))
        depth /= max(float(depth.max()), 1e-9)
        classes = np.stack([_events(depth, gain, loaded=loaded) for gain in GAINS])
        self._edges = np.append(fine - 0.5 * STEP_S, fine[-1] + 0.5 * STEP_S)
        self._total = np.pad(np.cumsum(classes, axis=1), ((0, 0), (1, 0)))

    def fit(self, edges_s: NDArray[np.float64], signal: NDArray[np.float64]) -> TapFit:
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

    def _left(
        self,
        delay_s: float,
        edges_s: NDArray[np.float64],
        signal: NDArray[np.float64],
        used: NDArray[np.bool_],
    ) -> float:
        at = edges_s - delay_s
        design = np.stack([np.diff(np.interp(at, self._edges, row))[used] for row in self._total])
        return float(nonnegative_left(np.ascontiguousarray(design.T), signal[used]))


def tap_signal(
    events: CellEvents, at_us: int, weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return edges of bins [s] from a moment, and the signed weighted events in them.

    Args:
        events: Events, camera clock.
        at_us: The moment, camera clock [us].
        weight: Weight of each cell.
    """
    start, count = at_us - round(1e6 * BEFORE_S), round(1e6 * (BEFORE_S + AFTER_S)) // BIN_US
    near = events.between(start, start + count * BIN_US)
    inside = near.cell < len(weight)
    bins = (near.t_us[inside] - start) // BIN_US
    size = np.where(near.on[inside], 1.0, -OFF_OVER_ON) * weight[near.cell[inside]]
    edges_us = start - at_us + np.arange(count + 1) * BIN_US
    return edges_us.astype(np.float64) * 1e-6, np.bincount(bins, size, count).astype(np.float64)


def _events(depth: NDArray[np.float64], gain: float, *, loaded: bool) -> NDArray[np.float64]:
    keep = float(np.exp(-STEP_S / PIXEL_S))
    fired = np.asarray(_fire(gain * depth, keep, PHASES, OFF_OVER_ON, 0.0))
    if loaded:
        fired = 0.5 * (fired + _fire(gain * depth, keep, PHASES, OFF_OVER_ON, gain))
    return np.asarray(fired / gain)


@njit(cache=True, nogil=True)
def _fire(
    course: NDArray[np.float64], keep: float, phases: int, off: float, before: float
) -> NDArray[np.float64]:
    """Return the signed events per step of pixels that start at all distances to their thresholds.

    A pixel follows the course, in ON thresholds, through a low-pass of first order. From where it
    starts, a load that moved it by `before`, spread by 0.6 to 1.4, has come and gone.
    """
    fired = np.zeros(len(course))
    for phase in range(phases):
        value = course[0]
        last = value + off - (1.0 + off) * (phase + 0.5) / phases
        # A stride that is coprime to the number of phases: loads independent of the start.
        top = value + before * (0.6 + 0.8 * (phase * 7 % phases) / phases)
        while top - last >= 1.0:
            last += 1.0
        while value - last <= -off:
            last -= off
        for i in range(1, len(course)):
            value = keep * value + (1.0 - keep) * course[i]
            while value - last >= 1.0:
                last += 1.0
                fired[i] += 1.0
            while value - last <= -off:
                last -= off
                fired[i] -= off
    return fired / phases
