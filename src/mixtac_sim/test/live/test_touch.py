# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Requests to the live sensor: what they command, and how one follows on another."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_core.events.errors import MixtacError
from mixtac_sim.live import touch as live_gestures
from mixtac_sim.live.touch import TouchControl
from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.mechanics.elastomer import LIVE_INDENTERS
from mixtac_sim.world.segments import LiveProfile
from mixtac_sim.world.sensor import TactileSensor

STEP_US = 125
AHEAD_US = 8_000


class Sensor:
    """A live sensor whose time the test turns; the contact is not simulated."""

    def __init__(self):
        self.profile = LiveProfile(tuple(LIVE_INDENTERS.values()))
        self.now_us = 0

    def play(self, scenario):
        self.profile.play(scenario, self.now_us + AHEAD_US)
        return self.now_us + AHEAD_US

    def commanded_force(self):
        return self.profile.force_at(self.now_us + AHEAD_US)

    def commanded_pull(self):
        return self.profile.pull_at(self.now_us + AHEAD_US)

    def commands(self, until_us):
        """Return modes and targets from now on and move on."""
        first, last = self.now_us // STEP_US, until_us // STEP_US
        self.now_us = until_us
        modes, targets, _ = self.profile.commands(first, last - first)
        return modes, targets


@pytest.fixture
def sensor():
    return Sensor()


@pytest.fixture
def control(sensor):
    return TouchControl(sensor)


def test_a_slide_and_a_turn_move_the_object_there_and_back(sensor, control):
    assert sensor.profile.motion(0, 32) is None
    control.touch(gesture='slide', distance=1.5, hold=0.5)
    steps = sensor.profile.motion(0, 24_000)
    assert np.nansum(steps[:, :5], axis=0) == pytest.approx([0.0] * 5, abs=1e-9)
    assert np.isnan(steps[:, 5:]).all()
    assert np.nancumsum(steps[:, 0]).max() == pytest.approx(1.5)
    sensor.commands(3_000_000)
    control.touch(gesture='torsion', angle=-30.0, hold=0.0)
    turned = sensor.profile.motion(24_000, 80_000)[:, 2]
    assert np.nansum(turned) == pytest.approx(np.radians(-30.0))


def test_a_pull_goes_on_from_the_press_and_from_the_pull_before(sensor, control):
    held = {'gesture': 'pull', 'force': 0.8, 'hold': 0.0}
    control.touch(**held, pull=0.0)
    sensor.commands(1_000_000)
    control.touch(**held, pull=0.3, pull_direction=90.0)
    first, last = 1_000_000 // STEP_US, 3_000_000 // STEP_US
    pull = sensor.profile.motion(first, last - first)[:, 5:]
    _, targets = sensor.commands(3_000_000)
    assert targets == pytest.approx(0.8)
    assert np.abs(np.diff(pull, axis=0)).max() < 1e-4
    assert pull[0] == pytest.approx([0.0, 0.0], abs=1e-4)
    # Upwards in the image is against the rows.
    assert pull[-1] == pytest.approx([0.0, -0.3])
    assert sensor.commanded_pull() == pytest.approx((0.0, -0.3))
    control.touch(**held, pull=0.2)
    assert sensor.profile.motion(last, 80)[-1, 5:] == pytest.approx([0.0, -0.3], abs=0.01)
    control.touch(gesture='release')
    sensor.commands(4_000_000)
    assert sensor.commanded_pull() == (0.0, 0.0)


def test_a_load_is_the_weight_of_the_object(sensor, control):
    control.touch(gesture='load', object='weight_50_g', hold=0.0)
    _, targets = sensor.commands(60_000_000)
    assert targets[-1] == pytest.approx(0.05 * 9.80665)
    control.touch(gesture='release')
    modes, targets = sensor.commands(61_000_000)
    assert not modes[-100:].any()
    assert np.abs(np.diff(targets)).max() < 0.01


def test_a_drop_falls_from_its_height_again_and_again(sensor, control):
    for until_us in (400_000, 2_000_000):
        control.touch(gesture='drop', object='weight_20_g', height=30.0, hold=0.5)
        modes, targets = sensor.commands(until_us)
        falling = modes == Mode.DROP
        begins = np.flatnonzero(falling[1:] & ~falling[:-1]) + 1
        # Only a mass that was off is raised anew.
        assert len(begins) == 1
        assert targets[begins[0]] == 30.0


def test_a_vibration_has_its_frequency_and_amplitude(sensor, control):
    control.touch(gesture='vibrate', frequency=80.0, amplitude=0.04, depth=0.2)
    modes, targets = sensor.commands(1_500_000)
    middle = targets[(modes == Mode.POSITION)][4000:8000]
    assert middle.max() == pytest.approx(0.24, abs=1e-3)
    assert middle.min() == pytest.approx(0.16, abs=1e-3)
    spectrum = np.abs(np.fft.rfft(middle - middle.mean()))
    assert np.fft.rfftfreq(len(middle), 125e-6)[spectrum.argmax()] == pytest.approx(80.0, abs=2.0)


@pytest.mark.parametrize(
    'request_',
    [
        {'gesture': 'poke'},
        {'gesture': 'press', 'object': 'banana'},
        {'gesture': 'press', 'force': 21.0},
        {'gesture': 'press', 'force': float('nan')},
        {'gesture': 'load', 'object': 'hemisphere'},
        {'gesture': 'drop', 'object': 'hemisphere'},
        {'gesture': 'vibrate', 'amplitude': 0.5, 'depth': 0.2},
    ],
)
def test_what_cannot_be_done_is_refused_and_changes_nothing(sensor, control, request_):
    with pytest.raises(MixtacError):
        control.touch(**request_)
    assert sensor.profile.end_us() is None


def test_what_was_pulled_away_touches_where_it_did_at_first():
    """Also when it was taken off before it moved back, and from the skin that it left."""
    tool = LIVE_INDENTERS['hemisphere']
    profile = LiveProfile(tuple(LIVE_INDENTERS.values()))
    sensor = TactileSensor(1, 1, profile)

    def torques(scenario, until_us):
        """Return the torques about the middle of the sensor in the end [Nm]."""
        profile.play(scenario, sensor_us[-1])
        sensor_us.append(until_us)
        return sensor.advance(until_us).wrench[-1, 3:5]

    sensor_us = [0]
    first = torques(live_gestures.press(tool, 0.5, 9.0), 400_000)
    torques(live_gestures.release(tool, 0.5), 700_000)
    pulled = torques(live_gestures.pull(tool, (0.0, 0.5), ((0.0, 0.0), (3.0, 0.0)), 9.0), 1_900_000)
    assert np.abs(pulled - first).max() > 1e-3
    held = torques(live_gestures.pull(tool, (0.5, 0.5), ((0.0, 0.0), (0.1, 0.0)), 9.0), 2_100_000)
    assert np.abs(held - first).max() > 1e-3
    torques(live_gestures.release(tool, 0.5), 2_500_000)
    again = torques(live_gestures.press(tool, 0.5, 9.0), 2_900_000)
    np.testing.assert_allclose(again, first, atol=1e-4)
