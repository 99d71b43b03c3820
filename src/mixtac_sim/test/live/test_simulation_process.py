# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The simulation in a process of its own."""

from __future__ import annotations

import multiprocessing
from dataclasses import replace

import numpy as np
import pytest

from mixtac_sim import SimulationError
from mixtac_sim.live.simulation_process import SimulationProcess
from mixtac_sim.live.touch import LiveProfile, press
from mixtac_sim.mechanics.indenters import HEMISPHERE
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.effects import EASY
from mixtac_sim.world.sensor import SensorOutput, TactileSensor

CHUNK_US = 20_000


def run(simulation, profile):
    """Return 0.2 s with a press and settings that change on the way."""
    parts = [simulation.advance(CHUNK_US)]
    profile.play(press(HEMISPHERE, 0.5, 1.0), 2 * CHUNK_US)
    simulation.configure_aps(ApsSettings(3000, 30_000, 30_000))
    simulation.configure_pixels(replace(PixelSettings(), threshold_on=0.4))
    parts += [simulation.advance(n * CHUNK_US) for n in range(2, 11)]
    return SensorOutput.join(parts)


def test_it_does_what_a_sensor_in_this_process_does():
    process, profile, mine = SimulationProcess(), LiveProfile(), LiveProfile()
    process.begin(3, 5, profile, preset=EASY)
    found = run(process, profile)
    expected = run(TactileSensor(3, 5, mine, preset=EASY), mine)
    assert found.truth['fz'].max() > 0.1
    assert len(found.frames) == len(expected.frames) > 2
    for name in ('t', 'x', 'y', 'polarity'):
        assert np.array_equal(getattr(found.events, name), getattr(expected.events, name))
    assert np.array_equal(found.truth, expected.truth)
    assert np.array_equal(found.wrench, expected.wrench)


def test_its_end_is_told():
    others = set(multiprocessing.active_children())
    process = SimulationProcess()
    process.begin(3, 5, LiveProfile(), preset=EASY)
    process.advance(CHUNK_US)
    (child,) = set(multiprocessing.active_children()) - others
    child.kill()
    child.join()
    with pytest.raises(SimulationError):
        process.advance(2 * CHUNK_US)
