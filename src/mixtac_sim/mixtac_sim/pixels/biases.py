# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the event pixels, how bias currents set them, and how pixels of a chip differ.

Bias currents follow jAER's formulas (DavisConfig, AddressedIPotCF): thresholds are (kappa_n /
kappa_p^2) (C2 / C1) ln(I / I_diff), the corner of the source follower is I_sf / (2 pi U_T C1), the
refractory time C V / I_refr. They are accurate to a factor only, so they predict the effect of a
change of a bias better than absolute values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_sim.grids import PADDED, PIXELS, stream

DIFF = 10
"""Address of the bias Diff in the register file, as those below of theirs."""
ON = 11
OFF = 12
PHOTORECEPTOR = 14
FOLLOWER = 15
REFRACTORY = 16
DEFAULT_REGISTERS: Mapping[int, int] = MappingProxyType(
    {DIFF: 17023, ON: 24575, OFF: 16415, PHOTORECEPTOR: 9133, FOLLOWER: 4365, REFRACTORY: 16797}
)
"""Register values that libcaer sends: Diff 4,39; On 5,255; Off 4,1; Pr 2,58; SF 1,16; Refr 4,25."""
FULL_SCALE_A = (11e-12, 94e-12, 756e-12, 6054e-12, 48437e-12, 387.5e-9, 3.1e-6, 24.8e-6)
"""Largest current of each coarse step [A] (libcaer)."""
LEAKAGE_A = 1e-14
"""Current of a source that is off [A] (estimate)."""
CAPACITOR_RATIO = 20.0
"""C1 over C2 (jAER; 24 by the drawn capacitors)."""
SLOPE_FACTOR = 0.7
"""kappa of both kinds of transistors (jAER)."""
THERMAL_V = 25e-3
"""Thermal voltage [V] (jAER)."""
FOLLOWER_F = 131e-15
"""Capacitor C1 [F] (jAER)."""
REFRACTORY_C = 20e-15 * 0.8
"""Charge of the refractory capacitor: 20 fF at 0.8 V [C] (jAER)."""
LEAST_THRESHOLD = 0.01
"""Thresholds do not go below this [log-e] (v2e)."""


def current_a(register: int) -> float:
    """Return the current [A] of a coarse-fine bias register."""
    if not register & 1:
        return LEAKAGE_A
    coarse, fine = register >> 12 & 7, register >> 4 & 255
    return max(FULL_SCALE_A[coarse] * fine / 256.0, LEAKAGE_A)


def _threshold(log_ratio: float) -> float:
    return max(log_ratio / (SLOPE_FACTOR * CAPACITOR_RATIO), LEAST_THRESHOLD)


@dataclass(frozen=True, slots=True)
class PixelSettings:
    """Properties that the biases set, equal for all pixels of a nominal chip.

    Attributes:
        threshold_on: Rise of log-e intensity per ON event; 0.18 to 0.42 for DAVIS346 biases.
        threshold_off: Fall per OFF event; up to 1.6 times the other way or this.
        source_follower_hz: Corner that caps the pixel's bandwidth [Hz]; 100 to 1000.
        hz_per_lux: Photoreceptor corner per illuminance of the chip [Hz/lx]; 1.6 to 4.
        refractory_us: Blind time after an event [us]; 3 to 500.
        leak_hz: Rate of ON events from junction leak [Hz]; about 0.1.
        leak_hz_per_lux: Rate of ON events from parasitic light [Hz/lx].
        shot_hz: Rate of noise events in the dark [Hz], both polarities together.
        drift_per_s: How fast the light rises, as a part of it [1/s].
        shot_lux: Illuminance that halves the noise [lx].
    """

    threshold_on: float = 0.21
    threshold_off: float = 0.27
    source_follower_hz: float = 590.0
    hz_per_lux: float = 2.5
    refractory_us: float = 100.0
    leak_hz: float = 0.05
    leak_hz_per_lux: float = 0.0005
    shot_hz: float = 0.6
    drift_per_s: float = 0.0
    shot_lux: float = 4.0

    @staticmethod
    def from_formulas(registers: Mapping[int, int]) -> PixelSettings:
        """Return the settings by jAER's formulas for register values by address.

        What is missing or 0, as no host has written it yet, is at its default. Above half the
        photoreceptor's current the formula of the corner does not hold; the corner stays there. The
        refractory time is a lower bound.
        """
        written = {place: value for place, value in registers.items() if value}
        amperes = {p: current_a(value) for p, value in {**DEFAULT_REGISTERS, **written}.items()}
        follower = min(amperes[FOLLOWER], 0.5 * amperes[PHOTORECEPTOR])
        return PixelSettings(
            threshold_on=_threshold(float(np.log(amperes[ON] / amperes[DIFF]))),
            threshold_off=_threshold(float(np.log(amperes[DIFF] / amperes[OFF]))),
            source_follower_hz=float(follower / (2.0 * np.pi * THERMAL_V * FOLLOWER_F)),
            refractory_us=1e6 * REFRACTORY_C / amperes[REFRACTORY],
        )

    @staticmethod
    def from_biases(registers: Mapping[int, int]) -> PixelSettings:
        """Return the settings of a nominal chip with some bias registers.

        Those at the default registers are scaled by what the formulas say of the change.

        Args:
            registers: Values by address, module 5 of the camera; defaults where one is missing.

        Shot noise grows with the bandwidth and with the inverse of the threshold (estimate); a leak
        reaches a lower threshold sooner.
        """
        nominal = PixelSettings()
        now, usual = (PixelSettings.from_formulas(each) for each in (registers, {}))
        on, off = now.threshold_on / usual.threshold_on, now.threshold_off / usual.threshold_off
        speed = now.source_follower_hz / usual.source_follower_hz
        return replace(
            nominal,
            threshold_on=nominal.threshold_on * on,
            threshold_off=nominal.threshold_off * off,
            source_follower_hz=nominal.source_follower_hz * speed,
            refractory_us=nominal.refractory_us * now.refractory_us / usual.refractory_us,
            leak_hz=nominal.leak_hz / on,
            leak_hz_per_lux=nominal.leak_hz_per_lux / on,
            shot_hz=nominal.shot_hz * speed * 2.0 / (on + off),
        )


class PixelSpread(NamedTuple):
    """Differences between the pixels of one chip; factors over padded pixels, float32.

    Attributes:
        on: ON threshold over nominal.
        off: OFF threshold over nominal.
        leak: Leak over nominal.
        hot_pixel: Numbers of the hot pixels [n], int64.
        hot_hz: Event rates of the hot pixels [n] [Hz].
    """

    on: NDArray[np.float32]
    off: NDArray[np.float32]
    leak: NDArray[np.float32]
    hot_pixel: NDArray[np.int64]
    hot_hz: NDArray[np.float64]


LEAK_DECADES = 0.1
"""Spread between pixels of the leak [decades] (v2e)."""


def draw_spread(
    device_seed: int, mismatch: float, hot_pixels: tuple[int, int] = (10, 120)
) -> PixelSpread:
    """Return the spread of a chip.

    Args:
        device_seed: Seed of the device.
        mismatch: Standard deviation of a threshold over its nominal value; 0.1 to 0.2 (v2e: 0.03
            of 0.2).
        hot_pixels: Range of the number of hot pixels, the upper end excluded.
    """
    rng = stream(device_seed, 'pixels')
    on = np.maximum(rng.normal(1.0, mismatch, PADDED), 0.3)
    off = np.maximum(rng.normal(1.0, mismatch, PADDED), 0.3)
    leak = 10.0 ** rng.normal(0.0, LEAK_DECADES, PADDED)
    hot = rng.choice(PIXELS, size=int(rng.integers(*hot_pixels)), replace=False)
    rates = 10.0 ** rng.uniform(0.7, 2.3, size=len(hot))  # 5 to 200 Hz (estimate)
    on[PIXELS:] = off[PIXELS:] = 1e6  # what pads the last tile never fires
    return PixelSpread(
        on.astype(np.float32), off.astype(np.float32), leak.astype(np.float32), hot, rates
    )
