# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The instruments beside the camera: reference force sensor (800 Hz) and inertial unit (IMU).

The mount is a mass on a spring that rings after impacts: a head of 0.15 to 0.4 kg on a stiffness
of 1e6 to 1e7 N/m resonates at 250 to 1300 Hz. The force that reaches the reference, y, follows the
one on the skin, u, as y'' + 2 d w y' + w^2 y = w^2 u; a step with u constant over it is exact.

The force sensor has a clock of its own and is modelled on six-axis sensors with a sinc filter (a
Bota at sinc length 64 gives 800 Hz exactly): a triangular, linear-phase filter of about 200 Hz, a
constant delay, gain and cross-talk errors, white noise, slow drift (an Ornstein-Uhlenbeck process)
and a step of 5 mN. The inertial unit measures gravity, noise, and the acceleration of the head
under contact forces. All spreads are estimates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

from mixtac_core.events.arrays import Floats
from mixtac_sim.grids import STEP_US, log_uniform, stream
from mixtac_sim.mechanics.contact import GRAVITY
from mixtac_sim.usb.words import ImuReading
from mixtac_sim.world.effects import EASY, Preset, TimingEffects


class Mount:
    """Transmits wrenches through a resonance.

    Args:
        resonance_hz: Resonance [Hz]; 0 for a rigid mount.
        damping: Damping ratio, 0 to below 1.
    """

    def __init__(self, resonance_hz: float, damping: float) -> None:
        self.resonance_hz = resonance_hz
        self.damping = damping
        self._state = np.zeros((2, 6))
        self._last_us: float | None = None

    def swing(self, t_us: NDArray[np.int64], wrench: Floats) -> tuple[Floats, Floats]:
        """Return what of a wrench arrives and what of it accelerates the head, both [n, 6].

        The mount is at rest before the first call.

        Args:
            t_us: Times [n] [us], increasing from call to call.
            wrench: Force [N] and torque [Nm] up to each time [n, 6].
        """
        arrived, left = np.empty_like(wrench), np.zeros_like(wrench)
        if self.resonance_hz <= 0.0 or not len(t_us):
            return wrench, left
        first = float(t_us[0]) - STEP_US if self._last_us is None else self._last_us
        steps_s = 1e-6 * np.diff(np.append(first, t_us.astype(np.float64)))
        self._last_us = float(t_us[-1])
        omega = 2.0 * np.pi * self.resonance_hz
        _ring(self._state, omega, self.damping, steps_s, wrench, arrived, left)
        return arrived, left


@njit(cache=True, nogil=True)
def _ring(
    state: Floats,
    omega: float,
    damping: float,
    steps_s: Floats,
    wrench: Floats,
    arrived: Floats,
    left: Floats,
) -> None:
    """Advance displacement and velocity of each axis; see the module."""
    sigma = damping * omega
    turn = omega * np.sqrt(1.0 - damping * damping)
    for k in range(steps_s.size):
        decay = np.exp(-sigma * steps_s[k])
        cos, sin = decay * np.cos(turn * steps_s[k]), decay * np.sin(turn * steps_s[k])
        for axis in range(6):
            off, speed = state[0, axis] - wrench[k, axis], state[1, axis]
            swing = (speed + sigma * off) / turn
            state[0, axis] = wrench[k, axis] + off * cos + swing * sin
            state[1, axis] = speed * cos - (sigma * speed + omega * omega * off) / turn * sin
            arrived[k, axis] = state[0, axis]
            damped = 2.0 * damping / omega * state[1, axis]
            left[k, axis] = wrench[k, axis] - state[0, axis] - damped


WANDER_KNOT_S = 1.0
"""Distance of the points between which the drift is a straight line [s]."""
WANDER_BOUND = 3.0
"""Largest value in standard deviations."""


class Wander:
    """Six independent drifts of mean 0 and deviation 1, zeroed at time 0 as a bench would.

    Args:
        rng: Draws the drift; used by nothing else.
        correlation_s: Time over which it forgets [s].
    """

    def __init__(self, rng: Generator, correlation_s: float) -> None:
        self._rng = rng
        self._kept = float(np.exp(-WANDER_KNOT_S / correlation_s))
        self._knots = rng.standard_normal((1, 6))

    def at(self, t_s: Floats) -> Floats:
        """Return the drift since time 0 at times from 0 on [n] [s], as [n, 6]."""
        if not len(t_s):
            return np.zeros((0, 6))
        first, end = int(t_s.min() / WANDER_KNOT_S), int(t_s.max() / WANDER_KNOT_S) + 2
        self._extend(end)
        times = WANDER_KNOT_S * np.arange(first, end)
        bounded = np.clip(self._knots[[0, *range(first, end)]], -WANDER_BOUND, WANDER_BOUND)
        columns = [np.interp(t_s, times, column[1:] - column[0]) for column in bounded.T]
        return np.stack(columns, axis=1)

    def _extend(self, count: int) -> None:
        """Draw knots up to a number of them, in order, so that calls may be cut anyhow."""
        missing = count - len(self._knots)
        if missing <= 0:
            return
        steps = np.sqrt(1.0 - self._kept**2) * self._rng.standard_normal((missing, 6))
        knots = [self._knots[-1]]
        for step in steps:
            knots.append(self._kept * knots[-1] + step)
        self._knots = np.concatenate([self._knots, knots[1:]])


REFERENCE_HZ = 800.0
"""Samples per second of the reference clock."""
PERIOD_S = 1.0 / REFERENCE_HZ
FILTER_US = 1_600.0
"""Half width of the triangular filter [us]: -3 dB at 0.319 / 1.6 ms = 200 Hz."""
FILTER_TAPS = 33
"""Points at which the filter's integral is taken."""
WARM_UP_S = 25.0
"""Time of the warm-up [s] (estimate)."""
REFERENCE_RESOLUTION = np.array([5e-3, 5e-3, 5e-3, 5e-5, 5e-5, 5e-5])
"""Step of the output [N, Nm]."""
REFERENCE_UNITS = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])
"""Size of a reading of a sensor of about 10 mm, forces [N] and torques [Nm]."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchSamples:
    """Samples of a wrench, as the reference sensor measures it or as it truly is.

    Attributes:
        t_ns: Stamp [n] [ns], int64, on the reference sensor's own clock or on the host's; live
            sensors count both from the Unix epoch.
        wrench: Force [N] and torque [Nm] [n, 6].
    """

    t_ns: NDArray[np.int64]
    wrench: Floats


class ReferenceSensor:
    """Turns the true wrench into what the reference sensor reports.

    A sample stamped s on the reference clock belongs to the true time (s - offset) / (1 + drift)
    and shows the wrench ``delay_s`` earlier. The output does not depend on how the true wrench is
    cut into calls.

    Args:
        seed: Seed of the trial.
        preset: Difficulty: sizes of the errors.

    Attributes:
        offset_s: Reading of the reference clock at true time 0 [s].
        drift_ppm: Rate of its clock over true time, less one [ppm].
        delay_s: Delay of its filter and transport [s].
        mount: Mount of the sensor.
    """

    def __init__(self, seed: int, preset: Preset = EASY) -> None:
        rng, timing = stream(seed, 'reference sensor'), preset.timing
        self.offset_s = rng.uniform(-timing.offset_s, timing.offset_s)
        self.drift_ppm = rng.uniform(-timing.drift_ppm, timing.drift_ppm)
        self.delay_s = rng.uniform(*timing.delay_s)
        self._mix = _mixing(rng, stream(seed, 'reference coupling'), timing)
        self._noise = rng.uniform(*timing.noise_n) * REFERENCE_UNITS
        self._drift = rng.normal(0.0, 1.0, (2, 6)) * np.outer(
            [timing.slope_n, timing.wave_n], REFERENCE_UNITS
        )
        self._wave_s = rng.uniform(15.0, 60.0)
        self._samples = stream(seed, 'reference noise')
        more = stream(seed, 'reference wander')
        self._wander_n = timing.wander_n
        self._wander = Wander(more, more.uniform(*timing.wander_s))
        mount, impact = stream(seed, 'reference mount'), preset.impact
        self.mount = Mount(
            log_uniform(mount, impact.ringing_hz), mount.uniform(*impact.ringing_damping)
        )
        self._next = int(np.ceil((self.offset_s + FILTER_US * 2e-6) * REFERENCE_HZ))
        self._past_us = np.array([-1e9])
        self._past = np.zeros((1, 6))

    def process(self, t_us: NDArray[np.int64], wrench: Floats) -> WrenchSamples:
        """Return the samples that the true wrench up to ``t_us[-1]`` allows.

        Args:
            t_us: True time [n] [us], increasing from call to call; 1 kHz or more.
            wrench: Force [N] and torque [Nm] on the sensor [n, 6]; zero before the first.
        """
        arrived, _ = self.mount.swing(t_us, wrench)
        self._past_us = np.concatenate([self._past_us, t_us.astype(np.float64)])
        self._past = np.concatenate([self._past, arrived])
        rate = 1.0 + 1e-6 * self.drift_ppm
        last = int(np.floor((self.offset_s + rate * (1e-6 * self._past_us[-1])) / PERIOD_S))
        ticks = np.arange(self._next, last + 1)
        self._next = max(self._next, last + 1)
        stamps_s = ticks.astype(np.float64) * PERIOD_S
        true_s = (stamps_s - self.offset_s) / rate
        values = self._filtered(1e6 * (true_s - self.delay_s)) @ self._mix.T
        values += self._slow(true_s) + self._noise * self._samples.standard_normal(values.shape)
        self._forget()
        rounded = REFERENCE_RESOLUTION * np.round(values / REFERENCE_RESOLUTION)
        return WrenchSamples(np.round(1e9 * stamps_s).astype(np.int64), rounded)

    def _filtered(self, centre_us: Floats) -> Floats:
        """Return the wrench around times [us] under the triangular filter."""
        shift = np.linspace(-FILTER_US, FILTER_US, FILTER_TAPS)
        weight = FILTER_US - np.abs(shift)
        weight /= weight.sum()
        at = centre_us[:, None] + shift
        columns = [np.interp(at, self._past_us, column) @ weight for column in self._past.T]
        return np.stack(columns, axis=1)

    def _slow(self, true_s: Floats) -> Floats:
        """Return the drift: a warm-up and a slow wave, or one that saturates."""
        wave = np.sin(2.0 * np.pi * true_s / self._wave_s)
        drift = np.outer(np.minimum(true_s / WARM_UP_S, 1.0), self._drift[0]) + np.outer(
            wave, self._drift[1]
        )
        if self._wander_n > 0.0:
            drift += self._wander_n * REFERENCE_UNITS * self._wander.at(true_s)
        return np.asarray(drift)

    def _forget(self) -> None:
        """Drop what no coming sample needs."""
        keep_us = self._past_us[-1] - 1e6 * (self.delay_s + PERIOD_S) - 2.0 * FILTER_US
        first = max(int(np.searchsorted(self._past_us, keep_us)) - 1, 0)
        self._past_us, self._past = self._past_us[first:], self._past[first:]


def _mixing(rng: Generator, coupled: Generator, timing: TimingEffects) -> Floats:
    """Return gain errors, and cross-talk between axes and between forces and torques."""
    error = timing.cross_talk
    mix = np.diag(1.0 + rng.uniform(-error, error, 6))
    for own, other in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
        mix[own, own] += rng.normal(0.0, error, (3, 3)) * (1.0 - np.eye(3))
        ratio = np.outer(REFERENCE_UNITS[own], 1.0 / REFERENCE_UNITS[other])
        mix[own, other] = coupled.normal(0.0, timing.coupling, (3, 3)) * ratio
    return np.asarray(mix)


ACCELERATION_NOISE_G = 0.004
"""Noise of one sample [g]: 300 ug/sqrt(Hz) over 184 Hz (MPU-9250 data sheet)."""
RATE_NOISE_DPS = 0.14
"""Noise of one sample [deg/s]: 0.01 deg/s/sqrt(Hz) over 184 Hz (MPU-9250 data sheet)."""
TEMPERATURE_C = 38.0
"""Die temperature of a camera that has run for a while (estimate)."""
HEAD_KG = (0.15, 0.4)
"""Mass of the sensor's head [kg] (estimate)."""
RESONANCE_HZ = (250.0, 1300.0)
"""Resonance of the head on its mount [Hz] (estimate)."""
CORNER_HZ = 184.0
"""Bandwidth of the acceleration [Hz] (MPU-9250 data sheet, default filter)."""


class InertialUnit:
    """Makes the samples of a sensor that stands on its mount, lens up.

    Args:
        seed: Fixes biases and noise.
    """

    def __init__(self, seed: int) -> None:
        self._rng: Generator = stream(seed, 'inertial unit')
        self._bias_g = self._rng.normal((0.0, 0.0, 1.0), 0.02)
        self._bias_dps = self._rng.normal(0.0, 1.0, 3)
        self._next_us = 0
        mount = stream(seed, 'inertial mount')
        self._mount = Mount(log_uniform(mount, RESONANCE_HZ), 0.04)
        self._per_n = 1.0 / (mount.uniform(*HEAD_KG) * GRAVITY)
        self._kept = float(np.exp(-2.0 * np.pi * CORNER_HZ * 1e-6 * STEP_US))
        self._memory = np.zeros(3)
        self._felt_us, self._felt_g = np.zeros(1), np.zeros((1, 3))

    def feel(self, t_us: NDArray[np.int64], wrench: Floats) -> None:
        """Add the wrench that shakes the head; call it before the ``readings`` of that time.

        Args:
            t_us: Simulated time [n] [us], 125 us apart, later than at the previous call.
            wrench: Force [N] and torque [Nm] on the skin [n, 6]; right, down, normal.
        """
        _, left = self._mount.swing(t_us, wrench)
        # The camera looks up, so a press on the skin accelerates it downwards.
        push = self._per_n * left[:, :3] * np.array([1.0, 1.0, -1.0])
        _soften(push, self._kept, self._memory)
        keep = max(int(np.searchsorted(self._felt_us, self._next_us)) - 1, 0)
        self._felt_us = np.append(self._felt_us[keep:], t_us.astype(np.float64))
        self._felt_g = np.vstack([self._felt_g[keep:], push])

    def readings(self, until_us: int, interval_us: int) -> list[ImuReading]:
        """Return the samples before a time [us, simulated time] that were not returned before.

        Args:
            until_us: End, not earlier than at the previous call.
            interval_us: Time between samples [us]; 0 switches the unit off.
        """
        if not interval_us:
            self._next_us = until_us
            return []
        times = range(self._next_us, until_us, interval_us)
        if not times:
            return []
        self._next_us = times[-1] + interval_us
        acceleration = self._rng.normal(self._bias_g, ACCELERATION_NOISE_G, (len(times), 3))
        for axis in range(3):
            acceleration[:, axis] += np.interp(times, self._felt_us, self._felt_g[:, axis])
        rate = self._rng.normal(self._bias_dps, RATE_NOISE_DPS, (len(times), 3))
        return [
            ImuReading(t, (a[0], a[1], a[2]), (r[0], r[1], r[2]), TEMPERATURE_C)
            for t, a, r in zip(times, acceleration.tolist(), rate.tolist(), strict=True)
        ]


@njit(cache=True, nogil=True)
def _soften(push: Floats, kept: float, memory: Floats) -> None:
    """Pass each axis through a low-pass of the first order, in place; `memory` is its state [3]."""
    for k in range(push.shape[0]):
        for axis in range(push.shape[1]):
            push[k, axis] = memory[axis] + (1.0 - kept) * push[k, axis]
            memory[axis] = kept * push[k, axis]
