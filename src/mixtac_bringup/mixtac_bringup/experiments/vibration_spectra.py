# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The dominant frequency of a vibration, by three signals."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_bringup.experiments.shaking import recorded, shake
from mixtac_bringup.experiments.sources_digest import sensor_digest
from mixtac_sim.vibration_lines import binned

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_bringup.experiments.shaking import Shaken

COUNT, POLARITY, FLOW = 'count', 'polarity', 'flow'
"""Number of events; ON less OFF; polarity times the gradient of a frame."""
BINS_US = {COUNT: 2000, POLARITY: 2000, FLOW: 1000}
"""Length of a bin [us]: the paper's, and half of it where twice the drive has to fit."""
LOWEST_HZ = 30.0
"""Below lies the relaxation of the gel [Hz]."""
_FINER = 8
"""Zero padding: peaks are read to an eighth of the resolution."""


@dataclass(frozen=True, slots=True)
class ShakePiece:
    """One vibration of the simulated sensor.

    Attributes:
        kind: How it touches, see `mixtac_bringup.experiments.shaking`.
        tone_hz: Its frequency [Hz].
        size_mm: Amplitude or depth [mm].
        seed: Which sensor and day.
    """

    kind: str
    tone_hz: float
    size_mm: float
    seed: int

    @property
    def label(self) -> str:
        """All of it."""
        return f'shake_{self.kind}_{self.tone_hz:g}hz_{1e3 * self.size_mm:g}um_s{self.seed}'

    def identity(self) -> str:
        """Return the fields and the simulator."""
        return f'{asdict(self)} {sensor_digest()}'

    def compute(self, _folder: Path, _stem: str) -> dict[str, Any]:
        """Return dominant frequencies and spectra."""
        return spectra(shake(self.kind, self.tone_hz, self.size_mm, self.seed))


@dataclass(frozen=True, slots=True)
class BagShakePiece:
    """One recorded vibration.

    Attributes:
        path: The bag.
        tone_hz: Its frequency [Hz].
    """

    path: Path
    tone_hz: float

    @property
    def label(self) -> str:
        """Name of the bag."""
        return f'shake_{self.path.name}'

    def identity(self) -> str:
        """Return path, size and date of the bag's files."""
        return repr(
            [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in sorted(self.path.iterdir())]
        )

    def compute(self, _folder: Path, _stem: str) -> dict[str, Any]:
        """Return dominant frequencies and spectra.

        Raises:
            MixtacError: The bag cannot be used.
        """
        return spectra(recorded(self.path))


def spectra(shaken: Shaken) -> dict[str, Any]:
    """Return, per signal, `dominant_hz` and `spectrum`, one value per Hz, largest is 1."""
    found = {}
    for bin_us in sorted(set(BINS_US.values())):
        count, polarity, flow = binned(shaken.events, shaken.frame, shaken.span_s, bin_us)
        for name, signal in ((COUNT, count), (POLARITY, polarity), (FLOW, flow)):
            if BINS_US[name] == bin_us:
                found[name] = spectrum_of(signal, bin_us)
    return found


def spectrum_of(signal: NDArray[np.float64], bin_us: int) -> dict[str, Any]:
    """Return the dominant frequency of a signal and its spectrum from 0 Hz, per Hz.

    Args:
        signal: One value per bin.
        bin_us: Length of a bin [us].
    """
    windowed = (signal - signal.mean()) * np.hanning(len(signal))
    strength = np.abs(np.fft.rfft(windowed, _FINER * len(signal)))
    hz = np.fft.rfftfreq(_FINER * len(signal), 1e-6 * bin_us)
    strength[hz < LOWEST_HZ] = 0.0
    dominant = float(hz[int(np.argmax(strength))])
    top = max(float(strength.max()), 1e-12)
    whole = np.arange(int(hz[-1]) + 1)
    nearest = np.searchsorted(hz, whole - 0.5), np.searchsorted(hz, whole + 0.5)
    values = [float(strength[a:b].max(initial=0.0)) / top for a, b in zip(*nearest, strict=True)]
    return {'dominant_hz': dominant, 'spectrum': [round(value, 3) for value in values]}
