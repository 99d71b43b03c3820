# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a host writes into bias registers reaches the pixels; what shakes the head is felt."""

import struct

import numpy as np
import pytest

from mixtac_sim.live.virtual_sensor import SimulationClock, VirtualSensor
from mixtac_sim.pixels.biases import DEFAULT_REGISTERS, OFF, ON, PixelSettings
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.world.instruments import InertialUnit, ReferenceSensor
from mixtac_sim.world.segments import LiveProfile
from mixtac_sim.world.sensor import TactileSensor


class Watched(TactileSensor):
    """Keeps what it is told and what it gives."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.settings, self.events = [], []

    def configure_pixels(self, nominal):
        self.settings.append(nominal)
        super().configure_pixels(nominal)

    def advance(self, until_us):
        output = super().advance(until_us)
        self.events.append((until_us, len(output.events)))
        return output


@pytest.fixture
def parts():
    ns = [5_000]
    clock = SimulationClock(lambda: ns[0], lambda: 0)
    device, profile = VirtualDavis346('V0000001', clock=clock.now_us), LiveProfile()
    simulation = Watched(1, 2, profile)
    sensor = VirtualSensor(simulation, profile, device, ReferenceSensor(2), InertialUnit(1), clock)
    sensor.step()
    clock.start()

    def run(seconds):
        for _ in range(round(seconds / 0.004)):
            ns[0] += 4_000_000
            sensor.step()

    return device, simulation, run


def write(device, biases):
    for place, value in biases.items():
        device.control(0x40, 0xBF, 5, place, struct.pack('>I', value))


def test_default_biases_change_nothing(parts):
    device, simulation, run = parts
    write(device, DEFAULT_REGISTERS)
    run(0.02)
    assert simulation.settings == []


def test_lower_thresholds_let_more_noise_through(parts):
    device, simulation, run = parts
    run(0.2)
    before = np.mean([n for _, n in simulation.events[5:]])
    # On 5,16 and Off 4,15 with Diff 4,39: a third of the usual thresholds.
    low = {ON: 15 | 16 << 4 | 5 << 12, OFF: 15 | 15 << 4 | 4 << 12}
    write(device, low)
    run(0.2)
    expected = PixelSettings.from_biases(low, PixelSettings())
    assert simulation.settings[-1] == expected
    assert expected.threshold_on < 0.4 * PixelSettings().threshold_on
    after = np.mean([n for _, n in simulation.events[-40:]])
    assert after > 1.5 * before
