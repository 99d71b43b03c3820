# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Node parameters and the camera settings they stand for."""

from __future__ import annotations

import dataclasses

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_driver.camera import Davis346
from mixtac_driver.configuration import Configuration, register_writes
from mixtac_driver.driver_parameters import (
    DriverParameters,
    camera_configuration,
    stream_settings,
)
from mixtac_driver.errors import ConfigurationError
from mixtac_node.parameters import ParameterError, build, specs


@pytest.fixture(scope='module')
def identity():
    with Davis346(backend=FakeBackend(FakeCamera())) as camera:
        return camera.identity


def writes(identity, **values):
    configuration = camera_configuration(build(DriverParameters, values))
    return {write[:2]: write.value for write in register_writes(configuration, identity)}


def test_defaults_are_those_of_libcaer_but_for_what_the_estimator_needs(identity):
    ours = register_writes(camera_configuration(DriverParameters()), identity)
    expected = Configuration(aps_exposure_us=7000, background_activity_filter_enabled=False)
    assert ours == register_writes(expected, identity)


def test_defaults_pass_their_own_checks():
    values = dataclasses.asdict(DriverParameters())
    assert build(DriverParameters, values) == DriverParameters()


@pytest.mark.parametrize(
    ('name', 'value', 'address', 'register'),
    [
        ('aps_exposure', 1000, (2, 12), 30240),
        ('aps_frame_interval', 20_000, (2, 13), 604_800),
        ('aps_global_shutter', False, (2, 7), 0),
        ('aps_roi_end_row', 100, (2, 11), 100),
        ('roi_start_col', 7, (1, 41), 7),
        ('background_activity_filter_enabled', False, (1, 31), 0),
        ('refractory_period_time', 9, (1, 34), 9),
        ('skip_events_every', 3, (1, 52), 3),
        ('polarity_suppress', True, (1, 62), 1),
        ('imu_acc_scale', 3, (3, 7), 3),
        ('usb_early_packet_delay', 125, (9, 1), 10_080),
        ('ONBn_fine', 1, (5, 11), 5 << 12 | 1 << 4 | 15),
        ('PrBp_coarse', 7, (5, 14), 7 << 12 | 58 << 4 | 13),
        ('ADC_RefHigh_voltage', 1, (5, 2), 1 | 7 << 6),
    ],
)
def test_parameters_reach_their_registers(identity, name, value, address, register):
    assert writes(identity, **{name: value})[address] == register


def test_only_exposure_interval_and_biases_change_while_running():
    changeable = {spec.name for spec in specs(DriverParameters) if not spec.read_only}
    biases = {name for name in changeable if '_coarse' in name or '_fine' in name or 'ADC' in name}
    assert len(biases) == 16
    assert changeable - biases == {'aps_exposure', 'aps_frame_interval'}


def test_contradicting_regions_are_refused():
    with pytest.raises(ConfigurationError, match='roi columns 9'):
        camera_configuration(build(DriverParameters, {'roi_start_col': 9, 'roi_end_col': 5}))


def test_values_out_of_range_are_refused():
    with pytest.raises(ParameterError, match='aps_exposure'):
        build(DriverParameters, {'aps_exposure': 0})


def test_stream_settings_follow():
    p = build(DriverParameters, {'usb_transfer_size': 4096, 'stream_timeout': 1.5})
    settings = stream_settings(p)
    assert (settings.transfer_size, settings.silence_s) == (4096, 1.5)
