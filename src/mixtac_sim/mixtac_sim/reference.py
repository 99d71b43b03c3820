# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The reference force sensor under the sensor: 800 Hz on a clock of its own.

Modelled on six-axis sensors with a sinc filter (a Bota at sinc length 64 gives 800 Hz exactly):
a mount that may ring, a triangular, linear-phase filter of about 200 Hz, a constant delay, gain and
cross-talk errors, white noise, slow drift and a step of 5 mN. All spreads are estimates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.errors import SimulationError
from mixtac_sim.mount import Mount
from mixtac_sim.presets import EASY
from mixtac_sim.random_streams import log_uniform, stream
from mixtac_sim.wander import Wander

if TYPE_CHECKING:
    from numpy.random import Generator
    from numpy.typing import NDArray

    from mixtac_sim.effects import TimingEffects
    from mixtac_sim.presets import Preset

FILTER_US = 1_600.0
"""Half width of the triangular filter [us]: -3 dB at 0.319 / 1.6 ms = 200 Hz."""
TAPS = 33
"""Points at which the filter's integral is taken."""
RESOLUTION = np.array([5e-3, 5e-3, 5e-3, 5e-5, 5e-5, 5e-5])
"""Step of the output [N, Nm]."""
UNITS = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])
"""Size of a reading of a sensor of about 10 mm, forces [N] and torques [Nm]."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceSamples:
    """Samples of the reference sensor.

    Attributes:
        t_ns: Stamp on the reference sensor's own clock [n] [ns], int64.
        wrench: Force [N] and torque [Nm] [n, 6].
    """

    t_ns: NDArray[np.int64]
    wrench: NDArray[np.float64]

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Return the stamps [n] [s]."""
        return np.asarray(1e-9 * self.t_ns)


class ReferenceSensor:
    """Turns the true wrench into what the reference sensor reports.

    A sample stamped s on the reference clock belongs to the true time (s - offset) / (1 + drift)
    and shows the wrench ``delay_s`` earlier. The output does not depend on how the true wrench is
    cut into calls.

    Args:
        seed: Seed of the trial.
        rate_hz: Samples per second of the reference clock.
        preset: How large its errors are.

    Attributes:
        offset_s: Reading of the reference clock at true time 0 [s].
        drift_ppm: How much faster than true time it runs [ppm].
        delay_s: Delay of its filter and transport [s].
        mount: What the sensor stands on it with.
    """

    def __init__(self, seed: int, rate_hz: float = 800.0, preset: Preset = EASY) -> None:
        if not 10.0 <= rate_hz <= 8000.0:
            msg = f'reference rate {rate_hz} Hz is outside 10 to 8000 Hz; choose another'
            raise SimulationError(msg)
        rng, timing = stream(seed, 'reference sensor'), preset.timing
        self.offset_s = rng.uniform(-timing.offset_s, timing.offset_s)
        self.drift_ppm = rng.uniform(-timing.drift_ppm, timing.drift_ppm)
        self.delay_s = rng.uniform(*timing.delay_s)
        self._period_s = 1.0 / rate_hz
        self._mix = _mixing(rng, timing) + _coupling(stream(seed, 'reference coupling'), timing)
        self._noise = rng.uniform(*timing.noise_n) * UNITS
        self._drift = rng.normal(0.0, 1.0, (2, 6)) * np.outer(
            [timing.slope_n, timing.wave_n], UNITS
        )
        self._wave_s = rng.uniform(15.0, 60.0)
        self._samples = stream(seed, 'reference noise')
        more = stream(seed, 'reference wander')
        self._wander_n = timing.wander_n
        self._wander = Wander(more, more.uniform(*timing.wander_s))
        self.mount = _draw_mount(stream(seed, 'reference mount'), preset)
        self._next = int(np.ceil((self.offset_s + FILTER_US * 2e-6) * rate_hz))
        self._past_us = np.array([-1e9])
        self._past = np.zeros((1, 6))

    def process(self, t_us: NDArray[np.int64], wrench: NDArray[np.float64]) -> ReferenceSamples:
        """Return the samples that the true wrench up to ``t_us[-1]`` allows.

        Args:
            t_us: True time [n] [us], increasing from call to call; 1 kHz or more.
            wrench: Force [N] and torque [Nm] on the sensor [n, 6]; zero before the first.

        Raises:
            SimulationError: Times that do not increase, or arrays that do not pair up.
        """
        self._append(t_us, wrench)
        last = int(np.floor(self._stamp_s(1e-6 * self._past_us[-1]) / self._period_s))
        ticks = np.arange(self._next, last + 1)
        self._next = max(self._next, last + 1)
        stamps_s = ticks.astype(np.float64) * self._period_s
        true_s = (stamps_s - self.offset_s) / (1.0 + 1e-6 * self.drift_ppm)
        values = self._filtered(1e6 * (true_s - self.delay_s)) @ self._mix.T
        values += self._slow(true_s) + self._noise * self._samples.standard_normal(values.shape)
        self._forget()
        rounded = RESOLUTION * np.round(values / RESOLUTION)
        return ReferenceSamples(np.round(1e9 * stamps_s).astype(np.int64), rounded)

    def _stamp_s(self, true_s: float) -> float:
        return self.offset_s + (1.0 + 1e-6 * self.drift_ppm) * true_s

    def _append(self, t_us: NDArray[np.int64], wrench: NDArray[np.float64]) -> None:
        times = np.concatenate([self._past_us, np.asarray(t_us, np.float64)])
        if wrench.shape != (len(t_us), 6) or np.any(np.diff(times) <= 0.0):
            msg = (
                f'{len(t_us)} times with a wrench of shape {wrench.shape}: give [n] increasing '
                'times, later than those before, and [n, 6] forces and torques'
            )
            raise SimulationError(msg)
        arrived = self.mount.transmit(t_us, wrench)
        self._past_us, self._past = times, np.concatenate([self._past, arrived])

    def _filtered(self, centre_us: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the wrench around times [us] under the triangular filter."""
        shift = np.linspace(-FILTER_US, FILTER_US, TAPS)
        weight = FILTER_US - np.abs(shift)
        weight /= weight.sum()
        at = centre_us[:, None] + shift
        columns = [np.interp(at, self._past_us, column) @ weight for column in self._past.T]
        return np.stack(columns, axis=1)

    def _slow(self, true_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the drift: a slope and a slow wave, or one that saturates."""
        wave = np.sin(2.0 * np.pi * true_s / self._wave_s)
        drift = np.outer(true_s / 25.0, self._drift[0]) + np.outer(wave, self._drift[1])
        if self._wander_n > 0.0:
            drift += self._wander_n * UNITS * self._wander.at(true_s)
        return np.asarray(drift)

    def _forget(self) -> None:
        """Drop what no coming sample needs."""
        keep_us = self._past_us[-1] - 1e6 * (self.delay_s + self._period_s) - 2.0 * FILTER_US
        first = max(int(np.searchsorted(self._past_us, keep_us)) - 1, 0)
        self._past_us, self._past = self._past_us[first:], self._past[first:]


def _mixing(rng: Generator, timing: TimingEffects) -> NDArray[np.float64]:
    """Return gain errors, and cross-talk between axes."""
    error = timing.cross_talk
    mix = np.diag(1.0 + rng.uniform(-error, error, 6))
    for block in (slice(0, 3), slice(3, 6)):
        mix[block, block] += rng.normal(0.0, error, (3, 3)) * (1.0 - np.eye(3))
    return np.asarray(mix)


def _coupling(rng: Generator, timing: TimingEffects) -> NDArray[np.float64]:
    """Return cross-talk between forces and torques."""
    coupling = np.zeros((6, 6))
    for rows, columns in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
        ratio = np.outer(UNITS[rows], 1.0 / UNITS[columns])
        coupling[rows, columns] = rng.normal(0.0, timing.coupling, (3, 3)) * ratio
    return coupling


def _draw_mount(rng: Generator, preset: Preset) -> Mount:
    """Return the mount that the sensor stands on in this trial."""
    impact = preset.impact
    return Mount(log_uniform(rng, impact.ringing_hz), rng.uniform(*impact.ringing_damping))
