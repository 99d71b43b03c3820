# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The real-time loop, on a clock of the test's own and a simulation that is known exactly."""

from __future__ import annotations

import multiprocessing
import struct
import time
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from usb.core import USBTimeoutError

from mixtac_core.events.arrays import Events
from mixtac_sim import SimulationError
from mixtac_sim.live import touch
from mixtac_sim.live.virtual_sensor import SimulationClock, SimulationProcess, VirtualSensor
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.mechanics.elastomer import HEMISPHERE
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.pixels.biases import DEFAULT_REGISTERS, ON, PixelSettings
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.world.effects import EASY
from mixtac_sim.world.instruments import InertialUnit, WrenchSamples
from mixtac_sim.world.segments import LiveProfile, Profile, Segment
from mixtac_sim.world.sensor import TRUTH_DTYPE, SensorOutput, TactileSensor

PATIENCE_S = 60.0
EPOCH_NS = 1_700_000_000_000_000_000


class OneEventPerMillisecond:
    """Counts time; its force is its time in seconds."""

    def __init__(self):
        self.until = 0
        self.aps, self.pixels = [], []

    def configure_aps(self, settings):
        self.aps.append((settings.exposure_us, settings.interval_us))

    def configure_pixels(self, nominal):
        self.pixels.append(nominal)

    def advance(self, until_us):
        assert until_us > self.until
        t = np.arange(-(-self.until // 1000) * 1000, until_us, 1000, dtype=np.int64)
        self.until = until_us
        ones = np.ones(len(t), np.uint16)
        truth = np.zeros(len(t), TRUTH_DTYPE)
        truth['t_us'] = t
        truth['fz'] = t * 1e-6
        wrench = np.zeros((len(t), 6))
        wrench[:, 2] = truth['fz']
        return SensorOutput(Events(t, ones, ones, ones.astype(bool)), [], truth, t, wrench)


class Echo:
    """A reference that returns what it is given, a day late."""

    def process(self, t_us, wrench):
        return WrenchSamples(t_us * 1000 + 86_400_000_000_000, wrench)


class Host:
    """A monotonic clock that the test turns."""

    def __init__(self):
        self.ns = 5_000

    def __call__(self):
        return self.ns


@pytest.fixture
def host():
    return Host()


@pytest.fixture
def simulation():
    return OneEventPerMillisecond()


@pytest.fixture
def clock(host):
    return SimulationClock(host, lambda: EPOCH_NS)


def make_sensor(simulation, clock):
    device = VirtualDavis346('V0000001', clock=clock.now_us)
    for module, param in ((0, 3), (9, 0), (0, 1), (0, 0), (1, 3), (2, 4), (3, 2)):
        device.control(0x40, 0xBF, module, param, struct.pack('>I', 1))
    device.control(0x40, 0xBF, 9, 1, struct.pack('>I', 0))
    return VirtualSensor(simulation, LiveProfile(), device, Echo(), InertialUnit(1), clock)


@pytest.fixture
def sensor(simulation, clock):
    sensor = make_sensor(simulation, clock)
    sensor.step()
    clock.start()
    return sensor


def words(device):
    try:
        return np.frombuffer(device.read_bulk(0x82, 1 << 22, 0.0), '<u2')
    except USBTimeoutError:
        return np.empty(0, np.uint16)


def run_for(sensor, host, seconds, period=0.001):
    for _ in range(round(seconds / period)):
        host.ns += round(period * 1e9)
        sensor.step()


def test_everything_goes_out_when_its_time_has_come(sensor, simulation, host):
    assert len(words(sensor.device)) == 0
    assert sensor.take_truth() == []
    run_for(sensor, host, 0.5)
    data = words(sensor.device)
    # ON events are words 0x3..., inertial samples start with special 5.
    assert np.count_nonzero(data >> 12 == 3) == 500
    assert np.count_nonzero(data == 5) == 500
    # The simulation is ahead by exposure and readout, not by more than a chunk beyond.
    assert 10_000 < simulation.until - 500_000 < 30_000
    truth = sensor.take_truth()
    stamps = np.concatenate([batch.t_ns for batch in truth])
    np.testing.assert_array_equal(stamps, EPOCH_NS + np.arange(500) * 1_000_000)
    force = np.concatenate([batch.wrench for batch in truth])
    np.testing.assert_allclose(force[:, 2], np.arange(500) * 1e-3)
    assert sensor.true_force(sensor.device.stamp_us(300_000)) == pytest.approx(0.3)
    reference = np.concatenate([batch.t_ns for batch in sensor.take_reference()])
    np.testing.assert_array_equal(reference, stamps + 86_400_000_000_000)
    assert sensor.take_truth() == []


def test_time_stops_while_the_host_is_behind_and_goes_on_where_it_stood(sensor, host):
    run_for(sensor, host, 0.1)
    words(sensor.device)
    sensor.take_truth()
    run_for(sensor, host, 5.0, period=5.0)
    assert sensor.state().lost_us == 5_000_000
    assert len(words(sensor.device)) == 0
    run_for(sensor, host, 0.1)
    assert np.count_nonzero(words(sensor.device) >> 12 == 3) == 100
    # Host stamps of the truth take the loss into account.
    stamps = np.concatenate([batch.t_ns for batch in sensor.take_truth()])
    np.testing.assert_array_equal(np.diff(stamps), 1_000_000)
    assert abs(stamps[0] - EPOCH_NS - 5_100_000_000) < 10_000_000
    assert sensor.time_ns() == EPOCH_NS + 200_000_000


def test_time_stops_while_nobody_reads_the_camera_and_nothing_is_lost(sensor, host):
    while sensor.device.backlog <= 1 << 19:
        assert sensor.device.feed(np.zeros(1 << 16, np.uint16))
    run_for(sensor, host, 2.0)
    assert sensor.state().lost_us == 2_000_000
    while len(words(sensor.device)):
        pass
    run_for(sensor, host, 0.1)
    assert np.count_nonzero(words(sensor.device) >> 12 == 3) == 100
    assert not any(sensor.device.losses.values())


def test_exposure_and_interval_follow_the_registers(sensor, simulation, host):
    assert simulation.aps == [(4000, 40_000)]
    sensor.device.control(0x40, 0xBF, 2, 12, struct.pack('>I', 302_400))
    run_for(sensor, host, 0.002)
    assert simulation.aps[1:] == [(10_000, 40_000)]
    # Faster than the readout: as fast as it goes.
    sensor.device.control(0x40, 0xBF, 2, 13, struct.pack('>I', 0))
    run_for(sensor, host, 0.002)
    exposure_us, interval_us = simulation.aps[2]
    assert exposure_us == 10_000
    assert 16_000 <= interval_us < 17_000


def test_pixels_follow_the_bias_registers(sensor, simulation, host):
    for place, value in DEFAULT_REGISTERS.items():
        sensor.device.control(0x40, 0xBF, 5, place, struct.pack('>I', value))
    run_for(sensor, host, 0.002)
    assert simulation.pixels == []
    low = 15 | 16 << 4 | 5 << 12  # coarse 5, fine 16
    sensor.device.control(0x40, 0xBF, 5, ON, struct.pack('>I', low))
    run_for(sensor, host, 0.002)
    assert simulation.pixels == [PixelSettings.from_biases({ON: low})]


def test_unfetched_batches_are_bounded(sensor, host):
    run_for(sensor, host, 10.0)
    truth = sensor.take_truth()
    assert len(truth) == 2048
    last = truth[-1].t_ns[-1]
    assert last == EPOCH_NS + 9_999_000_000


def press():
    return Profile(1.0, (Segment(0.0, 0.5, Mode.FORCE, (0.0, 0.25), (0.0, 1.0)),))


def test_live_profile_plays_from_any_step_in_any_cut():
    live, scenario = LiveProfile(), press()
    live.play(scenario, 10_060)
    start = 81
    whole = [live.commands(0, 9000)]
    parts = [live.commands(first, 100) for first in range(0, 9000, 100)]
    modes, targets, _ = (np.concatenate(column) for column in zip(*parts, strict=True))
    np.testing.assert_array_equal(modes, whole[0][0])
    np.testing.assert_allclose(targets, whole[0][1])
    expected = scenario.commands(0, 9000 - start)
    np.testing.assert_array_equal(modes[start:], expected[0])
    np.testing.assert_allclose(targets[start:], expected[1])
    assert not modes[:start].any()
    assert live.end_us() == start * 125 + 1_000_000


class Blocking(OneEventPerMillisecond):
    """Takes for ever to compute what comes after a time, until it is released."""

    def __init__(self, from_us):
        super().__init__()
        self.from_us = from_us
        self.released = Event()

    def advance(self, until_us):
        if until_us > self.from_us:
            assert self.released.wait(PATIENCE_S)
        return super().advance(until_us)


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_a_scenario_is_computed_ahead_so_that_a_slow_moment_does_not_show(host, clock):
    simulation = Blocking(800_000)
    sensor = make_sensor(simulation, clock)
    sensor.start()
    assert simulation.until < 50_000
    start_us = sensor.play(Profile(1.0, ()), lead_us=600_000)
    assert 600_000 <= start_us < 650_000
    wait_for(lambda: simulation.until >= 800_000)
    # The simulation is stuck at 0.8 s.
    for k in range(1, 66):
        host.ns += 10_000_000
        wait_for(lambda k=k: sensor.time_ns() == EPOCH_NS + 10_000_000 * k)
    assert np.count_nonzero(words(sensor.device) >> 12 == 3) == 650
    assert sensor.state().lost_us == 0
    simulation.released.set()
    sensor.close()


STRETCH_US = 20_000


def run(simulation, profile):
    """Return 0.2 s with a press and settings that change on the way."""
    parts = [simulation.advance(STRETCH_US)]
    profile.play(touch.press(HEMISPHERE, 0.5, 1.0), 2 * STRETCH_US)
    simulation.configure_aps(ApsSettings(3000, 30_000, 30_000))
    simulation.configure_pixels(replace(PixelSettings(), threshold_on=0.4))
    parts += [simulation.advance(n * STRETCH_US) for n in range(2, 11)]
    return SensorOutput.join(parts)


def test_a_simulation_process_does_what_a_sensor_in_this_process_does():
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


def test_the_end_of_the_simulation_process_is_an_error():
    others = set(multiprocessing.active_children())
    process = SimulationProcess()
    process.begin(3, 5, LiveProfile(), preset=EASY)
    process.advance(STRETCH_US)
    (child,) = set(multiprocessing.active_children()) - others
    # A signal to the whole group reaches it before the other end of the pipe has closed.
    child.terminate()
    process.advance(2 * STRETCH_US)
    child.kill()
    child.join()
    with pytest.raises(SimulationError):
        process.advance(3 * STRETCH_US)
