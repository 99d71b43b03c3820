# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Clock maps of simulated trials, from none at all to the true ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from mixtac_alignment.clock_fit import ClockFit
    from mixtac_alignment.refinement import Refinement
    from mixtac_alignment.sensor_pool import SensorTiming
    from mixtac_sim.trial import Trial

LABELS: Final = ('raw', 'arrival', 'two_impulse', 'refined', 'perfect')
HOST_S: Final = (1e-3, 8e-3)
"""Time from the first event to its arrival at the host: packets of 1 to 8 ms."""
REFERENCE_HOST_S: Final = (1e-4, 1e-3)
"""The same for a sample of the reference sensor."""


@dataclass(frozen=True, slots=True)
class Map:
    """A clock map t_reference = rate * t_camera + offset_us [us], and its error [ms]."""

    rate: float
    offset_us: float
    error_ms: float


def clock_maps(trials: list[Trial], seed: int) -> dict[str, list[Map]]:
    """Return the maps of trials of one sensor by the kinds of `LABELS`.

    Args:
        trials: Trials of one sensor with taps at both ends.
        seed: Of how long packets take to the host.

    `raw` takes both clocks for one. `arrival` is the difference of the clocks by the times at which
    the host got the first data: the clocks' offset, wrong by how long packets take to the host,
    with the sensor's delay and the drift left in. `two_impulse` and `refined` are as `mixtac align`
    on a folder fits them, `perfect` is the truth.
    """
    from mixtac_alignment.sensor_pool import pool_sensor

    rng = np.random.default_rng(seed)
    maps: dict[str, list[Map]] = {name: [] for name in LABELS}
    alone = [_fit(trial, None) for trial in trials]
    known = pool_sensor([refined for _, refined in alone])
    for trial in trials:
        first, refined = _fit(trial, known)
        rate, offset_us = trial.clock
        late_us = 1e6 * (rng.uniform(*REFERENCE_HOST_S) - rng.uniform(*HOST_S))
        maps['raw'].append(_rated(1.0, 0.0, trial))
        maps['arrival'].append(_rated(1.0, offset_us - late_us, trial))
        maps['two_impulse'].append(_rated(*_plain(first), trial))
        maps['refined'].append(_rated(*_plain(refined.fit), trial))
        maps['perfect'].append(_rated(rate, offset_us + trial.reference_delay_us, trial))
    return maps


def _fit(trial: Trial, known: SensorTiming | None) -> tuple[ClockFit, Refinement]:
    from mixtac_alignment.event_history import by_cell
    from mixtac_alignment.frame_features import FrameFeatures, reduce_frame
    from mixtac_alignment.rate_history import EventCounts
    from mixtac_alignment.refinement import refine
    from mixtac_alignment.tap_anchors import fit_taps

    rows, columns = trial.frames.shape[1:]
    values = np.stack([reduce_frame(frame, 1023.0) for frame in trial.frames])
    frames = FrameFeatures(trial.exposure_start_us, trial.exposure_end_us, values)
    force = (trial.reference_t_us.astype(np.float64) * 1e-6, trial.reference_wrench[:, 2])
    settings, lag = (None, None) if known is None else (known.settings, known.lag)
    counts, events = EventCounts.of(trial.events.t), by_cell(trial.events, columns, rows)
    first = fit_taps(counts, events, frames, *force, settings, lag)
    return first, refine(first, frames, *force, lag)


def _plain(fit: ClockFit) -> tuple[float, float]:
    return fit.a, 1e6 * fit.paper_offset_s


def _rated(rate: float, offset_us: float, trial: Trial) -> Map:
    t_us = np.linspace(0.0, float(trial.events.t[-1]), 41)
    true_us = trial.clock[0] * t_us + trial.clock[1] + trial.reference_delay_us
    error = np.abs(rate * t_us + offset_us - true_us)
    return Map(rate, offset_us, 1e-3 * float(error.mean()))
