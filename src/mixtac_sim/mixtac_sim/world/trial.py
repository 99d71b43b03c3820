# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One simulated trial: at once (`simulate_trial`), or part by part (`TrialStream`).

Streaming needs little memory however long the trial is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.recordings.dataset import TrialSpec
from mixtac_sim.grids import HEIGHT, WIDTH, stream
from mixtac_sim.usb.words import ImuReading
from mixtac_sim.world.effects import EASY, Preset, preset
from mixtac_sim.world.instruments import InertialUnit, ReferenceSensor, WrenchSamples
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.sensor import SensorOutput, TactileSensor

TRANSFER_US = (300, 1_500)
"""Range of the time from a frame's end to its arrival at the host [us] (estimate)."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One trial; times are camera time [us] = true time unless another clock is named.

    Attributes:
        events: Events, sorted.
        frames: Intensity of each frame [n, 260, 346], uint16, 0 to 1023 DN.
        exposure_start_us: Start of each exposure [n], int64.
        exposure_end_us: End of each exposure [n], int64.
        arrival_us: Arrival of each frame at the host [n], int64.
        truth: Force and dent at 1 kHz, ``TRUTH_DTYPE``.
        reference_t_us: Stamps of the reference sensor on its own clock [m] [us], int64.
        reference_wrench: Readings of the reference sensor [m, 6] [N, Nm].
        clock: True map to the reference clock (a, b): t_ref = a * t_camera + b [us].
        reference_delay_us: Delay of its readings behind their stamps [us].
    """

    events: Events
    frames: NDArray[np.uint16]
    exposure_start_us: NDArray[np.int64]
    exposure_end_us: NDArray[np.int64]
    arrival_us: NDArray[np.int64]
    truth: NDArray[np.void]
    reference_t_us: NDArray[np.int64]
    reference_wrench: NDArray[np.float64]
    clock: tuple[float, float]
    reference_delay_us: float


def simulate_trial(
    device_seed: int,
    trial_seed: int,
    profile_name: str,
    duration_s: float,
    *,
    sync: bool | None = None,
    preset: Preset = EASY,
    session: int | None = None,
) -> Trial:
    """Return a simulated trial; equal arguments give equal trials.

    Args:
        device_seed: Seed of the sensor.
        trial_seed: Seed of the trial and of its profile.
        profile_name: As in ``make_profile``.
        duration_s: Length [s].
        sync: Synchronising impulses, as in ``make_profile``.
        preset: Difficulty of the sensor.
        session: Seed of the day that several trials share; None for a day of its own.

    Raises:
        SimulationError: Unknown profile or a duration that is too short for it.
    """
    profile = make_profile(profile_name, trial_seed, duration_s, sync=sync, preset=preset)
    sensor = TactileSensor(device_seed, trial_seed, profile, preset=preset, session=session)
    output = sensor.advance(round(1e6 * duration_s))
    reference = ReferenceSensor(trial_seed, preset)
    samples = reference.process(output.wrench_us, output.wrench)
    frames = output.frames
    images = np.array([frame.intensity for frame in frames], np.uint16)
    ends = np.array([frame.frame_end_us for frame in frames], np.int64)
    transfer = stream(trial_seed, 'frame transfer').integers(*TRANSFER_US, len(frames))
    return Trial(
        events=output.events,
        frames=images.reshape(-1, HEIGHT, WIDTH),
        exposure_start_us=np.array([frame.exposure_start_us for frame in frames], np.int64),
        exposure_end_us=np.array([frame.exposure_end_us for frame in frames], np.int64),
        arrival_us=ends + transfer,
        truth=output.truth,
        reference_t_us=np.round(samples.t_ns / 1000).astype(np.int64),
        reference_wrench=samples.wrench,
        clock=(1.0 + 1e-6 * reference.drift_ppm, 1e6 * reference.offset_s),
        reference_delay_us=1e6 * reference.delay_s,
    )


STRETCH_US: Final = 100_000
IMU_INTERVAL_US: Final = 1_000
"""The camera's default: 1 kHz."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A stretch of a trial; true time [us] unless another clock is named.

    Attributes:
        start_us: Start of the stretch.
        end_us: End of the stretch.
        sensor: Events, frames, truth.
        readings: Inertial samples.
        reference: Samples of the reference sensor, on its own clock.
    """

    start_us: int
    end_us: int
    sensor: SensorOutput
    readings: list[ImuReading]
    reference: WrenchSamples


class TrialStream:
    """Simulates a trial, stretch by stretch.

    Args:
        spec: The trial.

    Attributes:
        spec: The trial.
        reference: The reference force sensor, with its clock.
        sensor: The tactile sensor.

    Raises:
        SimulationError: Unknown profile or preset, or a duration too short for the profile.
    """

    def __init__(self, spec: TrialSpec) -> None:
        self.spec, level = spec, preset(spec.preset)
        profile = make_profile(spec.profile, spec.trial_seed, spec.seconds, sync=True, preset=level)
        self.sensor = TactileSensor(spec.device_seed, spec.trial_seed, profile, preset=level)
        self.reference = ReferenceSensor(spec.trial_seed, level)
        self._inertial = InertialUnit(spec.trial_seed)

    def stretches(self) -> Iterator[Stretch]:
        """Yield the stretches in order; only once."""
        last_us = round(1e6 * self.spec.seconds)
        for start_us in range(0, last_us, STRETCH_US):
            end_us = min(start_us + STRETCH_US, last_us)
            output = self.sensor.advance(end_us)
            samples = self.reference.process(output.wrench_us, output.wrench)
            self._inertial.feel(output.wrench_us, output.wrench)
            readings = self._inertial.readings(end_us, IMU_INTERVAL_US)
            yield Stretch(start_us, end_us, output, readings, samples)
