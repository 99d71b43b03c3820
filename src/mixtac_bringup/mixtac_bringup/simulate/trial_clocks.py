# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clocks of a simulated trial, and when the host has what the camera saw.

True time counts from the start of the trial. The host's clock runs with true time; the camera's
begins with the trial, as the driver resets it, and runs a little fast or slow; the reference
sensor's has an offset and a drift of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_sim.random_streams import stream
from mixtac_sim.usb.oscillator import Oscillator

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_sim.reference import ReferenceSensor

FIRST_DAY_NS: Final = 1_767_225_600_000_000_000
"""2026-01-01 00:00 UTC: simulated trials lie from here on, an hour apart by their seeds."""
HOUR_NS: Final = 3_600_000_000_000
HOURS: Final = 100_000
LARGEST_SKEW_PPM: Final = 50.0
"""Usual tolerance of a crystal oscillator."""
USB_DELAY_US: Final = (150.0, 100.0)
"""Least time from the end of a USB transfer to the host's stamp, and mean of what comes on top
(estimates)."""


@dataclass(frozen=True, slots=True)
class ClockTruth:
    """True relation of the clocks.

    Attributes:
        rate: Reference clock over camera clock.
        offset_s: Reference clock less its epoch when the camera clock is at its own [s].
        epoch_s: Epoch of both [s since the Unix epoch].
    """

    rate: float
    offset_s: float
    epoch_s: float


class TrialClocks:
    """Converts the times of one trial.

    Args:
        trial_seed: Fixes the camera's skew, the delays and the day.

    Attributes:
        skew_ppm: How much faster than the host's the camera's clock runs [1e-6].
        epoch_ns: Host time at true time 0 [ns since the Unix epoch].
        origin_us: Host time at which the camera's clock read zero [us since the Unix epoch].
    """

    def __init__(self, trial_seed: int) -> None:
        self.skew_ppm = float(
            stream(trial_seed, 'camera clock').uniform(-LARGEST_SKEW_PPM, LARGEST_SKEW_PPM)
        )
        self.epoch_ns = FIRST_DAY_NS + HOUR_NS * (trial_seed % HOURS)
        self.origin_us = self.epoch_ns // 1000
        self._oscillator = Oscillator(self.skew_ppm)
        self._delays = stream(trial_seed, 'usb delay')

    def to_camera_us(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true time [us] to the camera's clock since its reset [us]."""
        return self._oscillator.to_camera(true_us)

    def camera_us(self, true_us: int) -> int:
        """Convert one true time [us] to the camera's clock since its reset [us]."""
        return self._oscillator.now(true_us)

    def to_host_ns(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true time [us] to the host's [ns since the Unix epoch]."""
        return np.asarray(self.epoch_ns + 1000 * true_us, np.int64)

    def arrivals_ns(self, end_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return when the host has transfers that end at true times [us]; draws new delays.

        The delays are at least `USB_DELAY_US[0]`; arrivals are in order.
        """
        least, mean = USB_DELAY_US
        delays_us = least + self._delays.exponential(mean, len(end_us))
        arrivals = self.to_host_ns(end_us) + np.round(1000 * delays_us).astype(np.int64)
        return np.asarray(np.maximum.accumulate(arrivals), np.int64)

    def reference_stamps_ns(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert times on the reference sensor's clock [ns] to its published stamps [ns]."""
        return np.asarray(self.epoch_ns + t_ns, np.int64)

    def truth(self, reference: ReferenceSensor) -> ClockTruth:
        """Return how the reference sensor's published stamps follow from the camera's."""
        rate = (1.0 + 1e-6 * reference.drift_ppm) / (1.0 + 1e-6 * self.skew_ppm)
        return ClockTruth(rate, reference.offset_s, 1e-9 * self.epoch_ns)
