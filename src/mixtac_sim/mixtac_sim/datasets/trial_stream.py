# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A trial as a stream of short stretches, so that long trials need little memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mixtac_sim.conditions import draw_conditions
from mixtac_sim.inertial_unit import InertialUnit
from mixtac_sim.presets import preset
from mixtac_sim.profiles import make_profile
from mixtac_sim.reference import ReferenceSensor
from mixtac_sim.sensor import TactileSensor

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_sim.datasets.trial_spec import TrialSpec
    from mixtac_sim.reference import ReferenceSamples
    from mixtac_sim.sensor import SensorOutput
    from mixtac_sim.usb.imu_words import ImuReading

STRETCH_US: Final = 100_000
IMU_INTERVAL_US: Final = 1_000
"""The camera's default: 1 kHz."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """What happened in a stretch of a trial; true time [us] unless said otherwise.

    Attributes:
        start_us: Its start.
        end_us: Its end.
        sensor: Events, frames, truth.
        readings: Inertial samples.
        reference: Samples of the reference sensor, on its own clock.
    """

    start_us: int
    end_us: int
    sensor: SensorOutput
    readings: list[ImuReading]
    reference: ReferenceSamples


class TrialStream:
    """Simulates a trial, stretch by stretch.

    Args:
        spec: The trial.

    Attributes:
        spec: The trial.
        profile: What touches the sensor.
        contact_mm: Where, from the optical axis [mm].
        reference: The reference force sensor, with its clock.
        sensor: The tactile sensor.

    Raises:
        SimulationError: Unknown profile or preset, or a duration too short for the profile.
    """

    def __init__(self, spec: TrialSpec) -> None:
        self.spec, hardness = spec, preset(spec.preset)
        self.profile = make_profile(
            spec.profile, spec.trial_seed, spec.seconds, sync=True, preset=hardness
        )
        self.sensor = TactileSensor(
            spec.device_seed, spec.trial_seed, self.profile, preset=hardness
        )
        self.contact_mm = draw_conditions(spec.trial_seed, hardness).contact_mm
        self.reference = ReferenceSensor(spec.trial_seed, preset=hardness)
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
