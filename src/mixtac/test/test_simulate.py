# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac simulate`: its bags, which have the defaults of the driver."""

from __future__ import annotations

import pytest
import typer
from typer.testing import CliRunner

from mixtac.simulate import simulate
from mixtac_core.events.windows import PACKET_BYTES, PACKET_PERIOD_US
from mixtac_core.node.topics import CAMERA_FRAME, IMU_FRAME
from mixtac_core.recordings.dataset import DatasetDescription
from mixtac_driver.parameters import DriverParameters
from mixtac_sim import SimulationError
from mixtac_sim.usb.words import ImuSettings

app = typer.Typer()
app.command()(simulate)


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_bags_are_written_and_counted(tmp_path):
    out = tmp_path / 'set'
    words = ('--profile', 'idle', '--trials', 2, '--seconds', 3, '--preset', 'easy', '--out', out)
    result = run(*words, '--jobs', 1, '--compress')
    assert result.exit_code == 0, result.output
    assert '2 bags written' in ' '.join(result.output.split())
    assert '0 bags written' in run(*words, '--jobs', 1).output
    description = DatasetDescription.read(out)
    assert (description.name, description.preset, description.complete) == ('idle', 'easy', True)


@pytest.mark.parametrize(
    'words',
    [
        (),
        ('--profile', 'idle'),
        ('--profile', 'idle', '--dataset', 'static', '--out', 'x'),
        ('--out', 'x'),
        ('--profile', 'idle', '--trials', 0, '--out', 'x'),
        ('--profile', 'idle', '--preset', 'dance', '--out', 'x'),
    ],
)
def test_wrong_usage_is_refused(words):
    assert run(*words).exit_code == 2


@pytest.mark.parametrize('option', ['--profile', '--dataset'])
def test_what_does_not_exist_is_an_expected_failure(option, tmp_path):
    result = run(option, 'dance', '--out', tmp_path / 'y', '--seconds', 3)
    assert isinstance(result.exception, SimulationError)


def test_simulated_bags_use_the_defaults_of_the_driver():
    p = DriverParameters()
    assert round(1e6 * p.event_message_time_threshold) == PACKET_PERIOD_US
    assert p.event_message_size_threshold == PACKET_BYTES
    assert (p.camera_frame_id, p.imu_frame_id) == (CAMERA_FRAME, IMU_FRAME)
    assert ImuSettings() == ImuSettings(
        accel=p.imu_acc_enabled,
        gyro=p.imu_gyro_enabled,
        temperature=p.imu_temp_enabled,
        accel_scale=p.imu_acc_scale,
        gyro_scale=p.imu_gyro_scale,
    )
