# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Puts a virtual sensor together."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from mixtac_sim.inertial_unit import InertialUnit
from mixtac_sim.live_objects import OBJECTS
from mixtac_sim.live_profile import LiveProfile
from mixtac_sim.presets import EASY
from mixtac_sim.reference import ReferenceSensor
from mixtac_sim.sensor import TactileSensor
from mixtac_sim.simulation_clock import SimulationClock
from mixtac_sim.usb.descriptors import serial_number
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.virtual_sensor import VirtualSensor

if TYPE_CHECKING:
    from mixtac_sim.presets import Preset
    from mixtac_sim.segments import Profile


def make_virtual_sensor(
    *, device_seed: int, seed: int, skew_ppm: float = 0.0, preset: Preset = EASY
) -> VirtualSensor:
    """Return a virtual sensor that nothing touches yet; `VirtualSensor.start` lets it run.

    Args:
        device_seed: Which sensor: beads, stiffness, lamp, pixels, and the camera's serial number.
        seed: Which day: contact point, noise, drifts, and the clock of the reference sensor.
        skew_ppm: How much faster than the host the camera's clock runs [ppm].
        preset: How hard the sensor is.
    """
    profile, clock = LiveProfile(tuple(OBJECTS.values())), SimulationClock()
    device = VirtualDavis346(serial_number(device_seed), skew_ppm=skew_ppm, clock=clock.now_us)
    # The simulation only asks for what a live profile has: indenters and commands.
    simulation = TactileSensor(device_seed, seed, cast('Profile', profile), preset=preset)
    return VirtualSensor(
        simulation,
        profile,
        device,
        ReferenceSensor(seed, preset=preset),
        InertialUnit(device_seed),
        clock,
    )
