# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Node parameters and the camera settings they stand for."""

from __future__ import annotations

import pytest
from davis_fake import FakeBackend, FakeCamera

from mixtac_core.node.files import FileError
from mixtac_core.node.parameters import build, specs
from mixtac_driver.camera import Davis346
from mixtac_driver.davis346.biases import BiasParameters
from mixtac_driver.davis346.writes import register_writes, run_writes
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.parameters import DriverParameters

VOLTAGES = {
    'ApsOverflowLevel': 0, 'ApsCas': 1, 'ADC_RefHigh': 2, 'ADC_RefLow': 3, 'ADC_TestVoltage': 4,
}  # fmt: skip
CURRENTS = {
    'LocalBufBn': 8, 'PadFollBn': 9, 'DiffBn': 10, 'ONBn': 11, 'OFFBn': 12, 'PixInvBn': 13,
    'PrBp': 14, 'PrSFBp': 15, 'RefrBp': 16, 'ReadoutBufBp': 17, 'ApsROSFBn': 18, 'AdcCompBp': 19,
    'ColSelLowBn': 20, 'DACBufBp': 21, 'LcolTimeoutBn': 22, 'AEPdBn': 23, 'AEPuXBp': 24,
    'AEPuYBp': 25, 'IFRefrBn': 26, 'IFThrBn': 27, 'BiasBuffer': 34,
}  # fmt: skip
SHIFTED_SOURCES = {'SSP': 35, 'SSN': 36}
FIELDS = {
    **{f'{name}_voltage': (address, 0, 6) for name, address in VOLTAGES.items()},
    **{f'{name}_current': (address, 6, 3) for name, address in VOLTAGES.items()},
    **{f'{name}_enabled': (address, 0, 1) for name, address in CURRENTS.items()},
    **{f'{name}_fine': (address, 4, 8) for name, address in CURRENTS.items()},
    **{f'{name}_coarse': (address, 12, 3) for name, address in CURRENTS.items()},
    **{f'{name}_mode': (address, 0, 2) for name, address in SHIFTED_SOURCES.items()},
    **{f'{name}_level': (address, 2, 2) for name, address in SHIFTED_SOURCES.items()},
    **{f'{name}_ref': (address, 4, 6) for name, address in SHIFTED_SOURCES.items()},
    **{f'{name}_reg': (address, 10, 6) for name, address in SHIFTED_SOURCES.items()},
}
"""Parameter: register, lowest bit, number of bits."""


@pytest.fixture(scope='module')
def identity():
    with Davis346(backend=FakeBackend(FakeCamera())) as camera:
        return camera.identity


def writes(identity, **values):
    p = build(DriverParameters, values)
    every = register_writes(p, identity) + run_writes(p, identity.model)
    return {write[:2]: int(write.value) for write in every}


@pytest.mark.parametrize(
    ('name', 'value', 'address', 'register'),
    [
        ('dvs_enabled', False, (1, 3), 0),
        ('roi_start_col', 7, (1, 41), 7),
        ('roi_start_row', 7, (1, 42), 7),
        ('roi_end_col', 7, (1, 43), 7),
        ('roi_end_row', 7, (1, 44), 7),
        ('background_activity_filter_enabled', True, (1, 31), 1),
        ('background_activity_filter_time', 4095, (1, 32), 4095),
        ('refractory_period_enabled', True, (1, 33), 1),
        ('refractory_period_time', 9, (1, 34), 9),
        ('skip_enabled', True, (1, 51), 1),
        ('skip_events_every', 3, (1, 52), 3),
        ('polarity_flatten', True, (1, 61), 1),
        ('polarity_suppress', True, (1, 62), 1),
        ('polarity_suppress_type', True, (1, 63), 1),
        ('aps_enabled', False, (2, 4), 0),
        ('aps_exposure', 1000, (2, 12), 30240),
        ('aps_exposure', 4_194_303, (2, 12), 126_835_723),
        ('aps_frame_interval', 20_000, (2, 13), 604_800),
        ('aps_global_shutter', False, (2, 7), 0),
        ('aps_global_shutter', False, (5, 142), 0),
        ('aps_roi_start_col', 3, (2, 8), 3),
        ('aps_roi_start_row', 3, (2, 9), 3),
        ('aps_roi_end_col', 3, (2, 10), 3),
        ('aps_roi_end_row', 100, (2, 11), 100),
        ('imu_acc_enabled', False, (3, 2), 0),
        ('imu_gyro_enabled', False, (3, 3), 0),
        ('imu_temp_enabled', False, (3, 4), 0),
        ('imu_sample_rate_divider', 7, (3, 5), 7),
        ('imu_low_pass_filter', 6, (3, 6), 6),
        ('imu_acc_scale', 3, (3, 7), 3),
        ('imu_gyro_low_pass_filter', 5, (3, 9), 5),
        ('imu_gyro_scale', 2, (3, 10), 2),
        ('external_input_enabled', False, (4, 0), 0),
        ('external_input_rising', True, (4, 1), 1),
        ('external_input_falling', True, (4, 2), 1),
        ('external_input_pulses', False, (4, 3), 0),
        ('external_input_pulse_polarity', False, (4, 4), 0),
        ('external_input_pulse_length', 1000, (4, 5), 120_960),
        ('generator_enabled', True, (4, 11), 1),
        ('generator_polarity', False, (4, 12), 0),
        ('generator_interval', 1000, (4, 13), 120_960),
        ('generator_length', 9, (4, 14), 1089),
        ('generator_inject_on_rising', True, (4, 15), 1),
        ('generator_inject_on_falling', True, (4, 16), 1),
        ('usb_early_packet_delay', 125, (9, 1), 10_080),
    ],
)
def test_parameters_reach_their_registers_and_no_others(identity, name, value, address, register):
    before, after = writes(identity), writes(identity, **{name: value})
    assert after[address] == register
    shutter = {(2, 7), (5, 142)}
    changed = {each for each in after if after[each] != before[each]}
    assert changed == (shutter if address in shutter else {address})


def test_every_field_of_every_bias_has_a_parameter():
    assert {spec.name for spec in specs(BiasParameters)} == set(FIELDS)


@pytest.mark.parametrize('name', FIELDS)
def test_bias_parameters_reach_their_bits_and_no_others(identity, name):
    address, lowest, bits = FIELDS[name]
    spec = next(spec for spec in specs(BiasParameters) if spec.name == name)
    value = not spec.default if isinstance(spec.default, bool) else int(spec.maximum)
    if value == spec.default:
        value = 0
    before, after = writes(identity), writes(identity, **{name: value})
    changed = {each for each in after if after[each] != before[each]}
    assert changed == {(5, address)}
    mask = (1 << bits) - 1 << lowest
    assert after[5, address] == before[5, address] & ~mask | int(value) << lowest


@pytest.mark.parametrize(
    ('values', 'name'),
    [
        ({'roi_start_col': 9, 'roi_end_col': 5}, 'roi columns 9'),
        ({'aps_roi_start_row': 9, 'aps_roi_end_row': 5}, 'aps_roi'),
        ({'generator_length': 10}, 'generator_interval'),
        ({'aps_auto_exposure_minimum': 40_000}, 'aps_auto_exposure_maximum'),
        ({'camera_frame_id': ''}, 'camera_frame_id'),
        ({'camera_frame_id': '/camera'}, 'camera_frame_id'),
        ({'imu_frame_id': 'left imu'}, 'imu_frame_id'),
        ({'hot_pixels_file': 'mask.jpg'}, 'hot_pixels_file'),
    ],
)
def test_contradicting_values_are_refused(values, name):
    with pytest.raises(ConfigurationError) as error:
        build(DriverParameters, values).check()
    assert name in str(error.value)


def test_a_file_to_write_lies_in_the_state_folder():
    build(DriverParameters, {'hot_pixels_file': 'mask.png', 'imu_frame_id': 'left/imu'}).check()
    with pytest.raises(FileError):
        build(DriverParameters, {'hot_pixels_file': '/none/mask.png'}).check()
