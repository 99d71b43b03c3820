# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Synchronising impulses: what they are, and the time of an extremum between samples.

An impulse is a sharp tap on the sensor. The force sensor sees a short peak; the camera sees two
bursts of events, loading and unloading, with a trough between them where the silicone stands still
at its largest deformation. Force peak and event trough are the same moment (paper, section Aligning
Data). The events come later than that: the silicone's deformation lags its force, and pixels answer
the later the darker they are. Their latency is a constant of the sensor (`event_latency_s`) and is
taken off. The delay of the force sensor's filter (1.5 to 3 ms for a 800 Hz stream) stays in the
offset `b`, from which nothing can tell it: a camera time maps to the stamp of the sample that shows
the force of that moment. The module `stillness` says which moment of the trough is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class ImpulseSettings:
    """What counts as an impulse and how far clocks may differ.

    Attributes:
        min_force: Smallest force peak [N].
        max_width_s: Longest force peak or event trough, at half its height [s].
        min_spacing_s: Of impulses closer than this, bounces mostly, the strongest counts [s].
        min_burst_rate: Smallest rise of both bursts over the trough [events/s].
        max_trough_ratio: Largest rate in the trough, as a part of the weaker burst.
        readout_rate: Rate from which the camera's readout delays events [events/s].
        min_baseline_s: Shortest time between the two impulses [s].
        max_drift: Largest believable difference of clock rates.
        match_s: Largest disagreement of two impulses that are the same [s].
        max_force_gap_s: Longest stretch without force samples [s]; behind a longer one the clock
            of the force sensor may be another.
        event_latency_s: How long after the force its peak shows in the events [s]: the median of
            simulated sensors in ordinary light, where photoreceptor, comparator and gel each take a
            part; a sensor in other light has another.
        event_latency_std_s: Standard deviation of it from sensor to sensor [s].
        tap_latency_s: The same where the whole course of a tap is fitted (`tap_waveform`), which
            accounts for gel and thresholds [s].
        tap_latency_std_s: Standard deviation of it from sensor to sensor [s].
        drift_std: Prior standard deviation of ``a - 1``: two crystals of 30 to 40 ppm each; 0 for
            no prior. The paper's own solution takes none.
    """

    min_force: float = 0.2
    max_width_s: float = 0.06
    min_spacing_s: float = 0.3
    min_burst_rate: float = 5e4
    max_trough_ratio: float = 0.6
    readout_rate: float = 1.0e7
    min_baseline_s: float = 2.0
    max_drift: float = 2e-4
    match_s: float = 0.006
    max_force_gap_s: float = 0.05
    event_latency_s: float = 4.15e-3
    event_latency_std_s: float = 0.7e-3
    tap_latency_s: float = 1.3e-3
    tap_latency_std_s: float = 1.0e-3
    drift_std: float = 5e-5


@dataclass(frozen=True, slots=True)
class Impulse:
    """An impulse in one recording.

    Attributes:
        time_s: Peak or moment of stillness [s] since the start of the recording, on its clock.
        std_s: Standard deviation of `time_s` [s].
        strength: Sharpness, comparable within one recording only.
        width_s: Width at half height [s].
        saturated: True where the peak is cut off.
    """

    time_s: float
    std_s: float
    strength: float
    width_s: float
    saturated: bool = False


def vertex(t: NDArray[np.float64], value: NDArray[np.float64]) -> tuple[float, float]:
    """Return the vertex of the parabola through samples and its standard deviation.

    Args:
        t: Sample times [s], at least 3.
        value: Samples about one extremum.

    Returns:
        Time of the vertex [s], within the samples, and its standard deviation from their scatter.
    """
    middle = float(t.mean())
    half = max(float(np.ptp(t)) / 2.0, 1e-9)
    u = (t - middle) / half
    basis = np.stack([np.ones_like(u), u, u**2], axis=1)
    coefficients, *_ = np.linalg.lstsq(basis, value, rcond=None)
    _, slope, curvature = coefficients
    if abs(curvature) < 1e-12 * (1.0 + abs(slope)):
        return middle, half
    at = -slope / (2.0 * curvature)
    freedom = len(t) - 3
    variance = float(np.sum((value - basis @ coefficients) ** 2)) / freedom if freedom > 0 else 0.0
    gradient = np.array([0.0, -1.0 / (2.0 * curvature), slope / (2.0 * curvature**2)])
    spread = float(gradient @ np.linalg.pinv(basis.T @ basis) @ gradient) * variance
    inside = float(np.clip(at, -1.0, 1.0))
    time = float(np.clip(middle + half * inside, t[0], t[-1]))
    return time, half * float(np.sqrt(spread) + abs(at - inside))


def strongest(impulses: list[Impulse], spacing_s: float) -> list[Impulse]:
    """Return the impulses that have no stronger one within `spacing_s`, in the order of time."""
    kept: list[Impulse] = []
    for impulse in sorted(impulses, key=lambda i: -i.strength):
        if all(abs(impulse.time_s - other.time_s) >= spacing_s for other in kept):
            kept.append(impulse)
    return sorted(kept, key=lambda i: i.time_s)
