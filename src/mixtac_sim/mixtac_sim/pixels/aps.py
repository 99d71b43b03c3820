# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The APS: frames with a global shutter, read as reset and signal levels of a 10-bit converter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_sim.grids import HEIGHT, PIXELS, TILE, WIDTH, BlockStreams, stream

READOUT_US = 6_000
"""Time from the end of the exposure to the last pixel [us] (estimate, 40 frames/s at most)."""
RESET_US = 30
"""Time from the start of the frame to the exposure [us] (estimate)."""
ELECTRONS_PER_DN = 34.0
"""Conversion gain [e-/DN]: 35 ke- over 10 bit (from 56 dB and 55 e- read noise)."""
READ_NOISE_DN = 55.0 / ELECTRONS_PER_DN
"""Noise of one reading [DN] (specification: 55 e-)."""
DARK_DN_PER_MS = 18.0 / ELECTRONS_PER_DN
"""Dark signal [DN/ms] (specification: 18 ke-/s)."""
_WORD = np.uint64(0xFFFFFFFF)
"""Lower half of a random number of 64 bits."""
_HALF = np.uint64(32)
"""Shift of its upper half [bits]."""
RESPONSE_SPREAD = 0.02
"""Standard deviation of the pixels' response (specification: 4.2 % FPN, most of it offset)."""


@dataclass(frozen=True, slots=True)
class ApsSettings:
    """When frames are taken.

    Attributes:
        exposure_us: Exposure [us].
        interval_us: From one exposure to the next [us]; 25 Hz in the paper.
        first_us: First exposure [us] of true time.
    """

    exposure_us: int = 7_000
    interval_us: int = 40_000
    first_us: int = 5_000


@dataclass(frozen=True, slots=True, eq=False)
class ApsFrame:
    """One frame; times in us of true time, levels in counts of the converter.

    Attributes:
        frame_start_us: The frame begins.
        exposure_start_us: The shutter opens.
        exposure_end_us: The shutter closes.
        frame_end_us: The last pixel has been read.
        reset: Reset level [260, 346], uint16, about 900 to 1000.
        signal: Signal level [260, 346], uint16; light lowers it.
    """

    frame_start_us: int
    exposure_start_us: int
    exposure_end_us: int
    frame_end_us: int
    reset: NDArray[np.uint16]
    signal: NDArray[np.uint16]

    @property
    def intensity(self) -> NDArray[np.uint16]:
        """Return reset less signal [260, 346], uint16, not below 0: the image, in DN."""
        return np.asarray(self.reset - np.minimum(self.signal, self.reset))


class Aps:
    """The frame side of the chip.

    Args:
        device_seed: Fixes offsets and responses of the pixels.
        trial_seed: Fixes the noise.
        dn_per_lux_ms: Response [DN/(lx ms)].
        settings: When frames are taken.
        grain: Read noise over the specification's.
    """

    def __init__(
        self,
        device_seed: int,
        trial_seed: int,
        dn_per_lux_ms: float,
        settings: ApsSettings,
        grain: float = 1.0,
    ) -> None:
        self._read_dn = np.float32(READ_NOISE_DN * grain)
        rng = stream(device_seed, 'aps')
        columns = rng.normal(0.0, 6.0, (1, WIDTH))
        level = 950.0 + columns + rng.normal(0.0, 8.0, (HEIGHT, WIDTH))
        self._level = level.astype(np.float32).ravel()
        spread = rng.normal(1.0, RESPONSE_SPREAD, PIXELS)
        self._dn_per_lux_us = (1e-3 * dn_per_lux_ms * spread).astype(np.float32)
        self._noise = BlockStreams(trial_seed, 'aps noise')
        self._light = np.zeros(PIXELS, np.float32)
        self._index = 0
        self._settings = self._wanted = settings
        self._next_us = settings.first_us
        self._busy_until_us = 0

    def configure(self, settings: ApsSettings) -> None:
        """Change the settings from the next exposure that has not begun."""
        self._wanted = settings

    def _adopt(self, now_us: float) -> None:
        """Apply new settings unless an exposure is under way."""
        settings = self._wanted
        if settings is self._settings or self._next_us < now_us:
            return
        self._next_us = max(self._next_us, settings.first_us, self._busy_until_us + RESET_US)
        self._settings = settings

    def shares_us(self, start_us: float, end_us: float) -> tuple[float, float]:
        """Return how long [us] the light at start and at end of the next step is exposed.

        Args:
            start_us: Start of the step [us].
            end_us: Its end [us].
        """
        self._adopt(start_us)
        opens, closes = self.exposure_us
        opened, closed = max(start_us, float(opens)), min(end_us, float(closes))
        if closed <= opened:
            return 0.0, 0.0
        late = (0.5 * (opened + closed) - start_us) / (end_us - start_us)
        return (1.0 - late) * (closed - opened), late * (closed - opened)

    def expose(self, light: NDArray[np.float32], span_us: float) -> None:
        """Collect light [tiles, 64] [lx] for a time [us]."""
        if span_us > 0.0:
            _add(self._light, light, np.float32(span_us))

    def disturbances_us(self, start_us: int, end_us: int) -> list[int]:
        """Return the resets and readouts between two times [us] that may make pixels fire."""
        return [t for t in self.exposure_us if start_us <= t < end_us]

    @property
    def exposure_us(self) -> tuple[int, int]:
        """Return start and end of the exposure that is under way or comes next [us]."""
        return self._next_us, self._next_us + self._settings.exposure_us

    def finish(self, until_us: float, brightness: float) -> ApsFrame | None:
        """Return the frame whose exposure ended by a time [us], once.

        Args:
            until_us: End of the last step [us].
            brightness: Light over that of the scene: lamps age and warm.
        """
        start, end = self.exposure_us
        if end > until_us:
            return None
        reset, signal = self._convert(brightness)
        self._light[:] = 0.0
        self._index += 1
        self._next_us += self._settings.interval_us
        self._busy_until_us = end + READOUT_US
        return ApsFrame(start - RESET_US, start, end, end + READOUT_US, reset, signal)

    def _convert(self, brightness: float) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        """Return the two readings of the collected light."""
        draws = self._noise.block(self._index).integers(0, 2**64, PIXELS, np.uint64)
        reset = np.empty((HEIGHT, WIDTH), np.uint16)
        signal = np.empty_like(reset)
        dark = np.float32(1e-3 * self._settings.exposure_us * DARK_DN_PER_MS)
        _digitise(
            self._light,
            self._dn_per_lux_us * np.float32(brightness),
            dark,
            self._level,
            draws,
            self._read_dn,
            reset.reshape(-1),
            signal.reshape(-1),
        )
        return reset, signal


@njit(cache=True, nogil=True, error_model='numpy')
def _bell(draw: int) -> float:
    """Return a number of mean 0 and deviation 1 from 32 random bits: the sum of four bytes."""
    total = (draw & 255) + ((draw >> 8) & 255) + ((draw >> 16) & 255) + ((draw >> 24) & 255)
    return float((np.float32(total) - np.float32(510.0)) * np.float32(1.0 / 147.7972))


@njit(cache=True, nogil=True, error_model='numpy')
def _digitise(
    light: NDArray[np.float32],
    response: NDArray[np.float32],
    dark: float,
    level: NDArray[np.float32],
    draws: NDArray[np.uint64],
    read: float,
    reset: NDArray[np.uint16],
    signal: NDArray[np.uint16],
) -> None:
    """Read all pixels before and after the exposure, with read and shot noise, in 10 bits."""
    gain = np.float32(1.0 / ELECTRONS_PER_DN)
    half, top = np.float32(0.5), np.float32(1023.0)
    for p in range(light.size):
        exposed = light[p] * response[p] + dark
        grain = np.sqrt(read * read + exposed * gain)
        before = level[p] + read * _bell(np.int64(draws[p] & _WORD)) + half
        after = level[p] - exposed + grain * _bell(np.int64(draws[p] >> _HALF)) + half
        reset[p] = np.uint16(min(max(before, np.float32(0.0)), top))
        signal[p] = np.uint16(min(max(after, np.float32(0.0)), top))


@njit(cache=True, nogil=True, error_model='numpy')
def _add(total: NDArray[np.float32], light: NDArray[np.float32], span_us: float) -> None:
    """Add light of tiles [tiles, 64] to pixels."""
    for tile in range(light.shape[0]):
        first = tile * TILE
        for j in range(min(TILE, total.size - first)):
            total[first + j] += span_us * light[tile, j]
