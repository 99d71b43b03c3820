# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual sensor and a recording read without ROS."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mixtac import ModelError, NoCameraError, NotOpenError, Reading, Sensor, SensorError
from mixtac_core.node.parameters import ParameterError
from mixtac_core.recordings.recording import RecordingError
from mixtac_driver.errors import UnknownDeviceError
from mixtac_driver.parameters import DriverParameters
from mixtac_fger.parameters import FgerParameters
from mixtac_fger.streaming import ForceEstimator
from mixtac_sim.bags.trial_bag import write_trial
from mixtac_sim.world.plans import plan_profile


@pytest.fixture(scope='module')
def seen() -> SimpleNamespace:
    """Return what a virtual sensor gave."""
    taring, overlaps, push = threading.Event(), [], ForceEstimator.push_frame

    def tare(_feed) -> None:
        taring.set()
        time.sleep(0.5)
        taring.clear()

    def push_frame(feed, *frame) -> None:
        overlaps.append(taring.is_set())
        push(feed, *frame)

    with Sensor('virtual') as sensor, pytest.MonkeyPatch.context() as patch:
        patch.setattr(ForceEstimator, 'push_frame', push_frame)
        patch.setattr(ForceEstimator, 'tare', tare)
        sensor.read()
        sensor.tare()
        found = SimpleNamespace(
            overlaps=overlaps,
            sensor=sensor,
            first=sensor.read(),
            second=sensor.read(),
            latest=sensor.read_latest(max_age_ms=60_000),
            picture=sensor.pictures.read(),
            serial=sensor.serial,
        )
        with pytest.raises(SensorError):
            sensor.open()
    return found


@pytest.mark.live
def test_forces_come_one_after_another_and_can_be_trusted(seen):
    first, second = seen.first, seen.second
    assert isinstance(first, Reading)
    assert first.stamp_us < second.stamp_us <= seen.latest.stamp_us
    assert first.valid
    assert abs(first.force) < 0.05
    assert seen.serial


@pytest.mark.live
def test_no_frame_is_added_while_another_thread_tares(seen):
    assert seen.overlaps
    assert not any(seen.overlaps)


@pytest.mark.live
def test_pictures_have_the_frame_and_its_difference_to_no_contact(seen):
    picture = seen.picture
    assert picture.image.shape == (260, 346)
    assert picture.image.dtype == np.uint16
    assert picture.difference.dtype == np.float32
    assert np.abs(picture.difference).mean() < 0.05


@pytest.mark.live
def test_a_closed_sensor_cannot_be_read(seen):
    assert not seen.sensor.is_open
    for read in (seen.sensor.read, seen.sensor.read_latest, seen.sensor.tare):
        with pytest.raises(NotOpenError):
            read()
    seen.sensor.close()


@pytest.mark.live
def test_a_recording_is_a_sensor_until_it_ends(tmp_path):
    spec = plan_profile('idle', 1, 3.0, preset='easy')[0]
    write_trial(spec, tmp_path)
    with Sensor(str(tmp_path / spec.name)) as sensor:
        assert sensor.read().valid
        ended = None
        while ended is None:
            try:
                sensor.async_read(timeout_ms=10_000)
            except SensorError as error:
                ended = error
    assert not isinstance(ended, TimeoutError)


@pytest.mark.parametrize(
    ('source', 'model', 'error'),
    [
        ('virtual', 'no_such_model', ModelError),
        ('usb:no_such_serial', '', NoCameraError),
        ('no_such_device', '', UnknownDeviceError),
        (Path('no_such_bag.mcap'), '', RecordingError),
    ],
)
def test_what_cannot_be_opened_says_why(source, model, error):
    sensor = Sensor(source, model=model)
    with pytest.raises(error):
        sensor.open()
    assert not sensor.is_open


def test_a_line_says_that_a_virtual_sensor_starts(capsys):
    sensor = Sensor('virtual:no_such_scenario')
    with pytest.raises(SensorError) as caught:
        sensor.open()
    assert 'no_such_scenario' in str(caught.value)
    assert not sensor.is_open
    assert 'virtual sensor' in capsys.readouterr().err


@pytest.mark.parametrize(
    'options',
    [
        {'driver': DriverParameters(playback_rate=-1.0)},
        {'fger': FgerParameters(force_scale=-3.0)},
        {'fger': FgerParameters(invalid_force='give')},
    ],
)
def test_values_that_a_node_would_refuse_are_refused(options):
    with pytest.raises(ParameterError):
        Sensor('virtual', **options)


def test_nothing_of_it_needs_ros():
    assert without_ros('import mixtac, mixtac.virtual').returncode == 0


@pytest.mark.parametrize('words', [['record', 'bag'], ['demo', '--out', 'new']])
def test_what_needs_ros_says_so(words):
    result = main_without_ros(words)
    assert result.returncode == 1
    assert 'ROS 2' in result.stderr
    assert len(result.stderr.splitlines()) == 1


def without_ros(code: str) -> subprocess.CompletedProcess[str]:
    hidden = ('ament_index_python', 'builtin_interfaces', 'rclpy', 'sensor_msgs')
    code = f'import sys; sys.modules.update(dict.fromkeys({hidden}))\n{code}'
    command = [sys.executable, '-c', code]
    return subprocess.run(command, capture_output=True, text=True, cwd=Path('/'), check=False)


def main_without_ros(words: list[str]) -> subprocess.CompletedProcess[str]:
    return without_ros(f'from mixtac.main import main; sys.exit(main({words}))')


@pytest.mark.live
def test_up_shows_forces_without_ros():
    shown = main_without_ros(['up', '--device', 'virtual', '--seconds', '1'])
    assert shown.returncode == 0
    (line,) = [line for line in shown.stdout.splitlines() if ' N +- ' in line]
    assert 'simulated' in line
