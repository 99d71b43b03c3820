# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Biases of the DAVIS346 chip: values, register encoding, defaults and node parameters.

Three kinds of bias share one register file (module CHIP, parameters 0 .. 36), each with its own
packing into the low 16 bits of the value. Defaults are those of libcaer 3.3. Parameters are named
as in libcaer_driver, one per field of each bias.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from mixtac_driver.errors import ConfigurationError
from mixtac_node.parameters import parameter


def switch(default: bool, description: str) -> bool:
    """Return a field that is on or off and may change while the node runs."""
    return parameter(default, description)


def number(
    default: int,
    description: str,
    maximum: int,
    unit: str = '',
    minimum: int = 0,
    *,
    read_only: bool = False,
) -> int:
    """Return a field for a whole number within bounds; may change while the node runs."""
    return parameter(
        default, description, unit=unit, minimum=minimum, maximum=maximum, read_only=read_only
    )


COARSE_CURRENT_PA = (11, 94, 756, 6054, 48437, 387500, 3100000, 24800000)
"""Full-scale current [pA] of each coarse step."""


def _field(name: str, value: int, maximum: int) -> int:
    if not 0 <= value <= maximum:
        raise ConfigurationError(f'bias {name} = {value}: outside 0 .. {maximum}')
    return value


@dataclass(frozen=True, slots=True)
class VoltageBias:
    """A voltage made by a digital-to-analogue converter (VDAC).

    Attributes:
        voltage: Voltage step, 0 .. 63.
        current: Output current step, 0 .. 7.
    """

    voltage: int
    current: int

    def encode(self) -> int:
        """Return the register value.

        Raises:
            ConfigurationError: A field is out of range.
        """
        return _field('voltage', self.voltage, 63) | _field('current', self.current, 7) << 6

    @classmethod
    def decode(cls, value: int) -> VoltageBias:
        """Return the bias that a register value stands for."""
        return cls(value & 63, value >> 6 & 7)


@dataclass(frozen=True, slots=True)
class CurrentBias:
    """A coarse-fine current source.

    Attributes:
        coarse: Decade, 0 .. 7.
        fine: Fraction of it, 0 .. 255.
        n_type: True for an N transistor (sinks), False for P.
        enabled: False switches the source off.
        normal: False for a cascode transistor.
        normal_level: False for the low current range.
    """

    coarse: int
    fine: int
    n_type: bool
    enabled: bool = True
    normal: bool = True
    normal_level: bool = True

    def encode(self) -> int:
        """Return the register value.

        Raises:
            ConfigurationError: A field is out of range.
        """
        flags = self.enabled | self.n_type << 1 | self.normal << 2 | self.normal_level << 3
        return flags | _field('fine', self.fine, 255) << 4 | _field('coarse', self.coarse, 7) << 12

    @classmethod
    def decode(cls, value: int) -> CurrentBias:
        """Return the bias that a register value stands for."""
        return cls(
            coarse=value >> 12 & 7,
            fine=value >> 4 & 255,
            n_type=bool(value & 2),
            enabled=bool(value & 1),
            normal=bool(value & 4),
            normal_level=bool(value & 8),
        )

    def current_pa(self) -> float:
        """Return the approximate current [pA]."""
        return COARSE_CURRENT_PA[self.coarse] * self.fine / 255 if self.enabled else 0.0


@dataclass(frozen=True, slots=True)
class ShiftedSourceBias:
    """A regulated supply of the bias generator itself.

    Attributes:
        reference: Reference step, 0 .. 63.
        regulator: Regulator step, 0 .. 63.
        mode: 0 shifted source, 1 high impedance, 2 tied to the rail.
        level: 0 split gate, 1 single diode, 2 double diode.
    """

    reference: int
    regulator: int
    mode: int = 0
    level: int = 0

    def encode(self) -> int:
        """Return the register value.

        Raises:
            ConfigurationError: A field is out of range.
        """
        return (
            _field('mode', self.mode, 2)
            | _field('level', self.level, 2) << 2
            | _field('reference', self.reference, 63) << 4
            | _field('regulator', self.regulator, 63) << 10
        )

    @classmethod
    def decode(cls, value: int) -> ShiftedSourceBias:
        """Return the bias that a register value stands for."""
        return cls(value >> 4 & 63, value >> 10 & 63, value & 3, value >> 2 & 3)


Bias = VoltageBias | CurrentBias | ShiftedSourceBias


def _n(coarse: int, fine: int, *, enabled: bool = True) -> CurrentBias:
    return CurrentBias(coarse, fine, n_type=True, enabled=enabled)


def _p(coarse: int, fine: int) -> CurrentBias:
    return CurrentBias(coarse, fine, n_type=False)


DEFAULT_BIASES: Mapping[str, tuple[int, Bias]] = MappingProxyType(
    {
        'ApsOverflowLevel': (0, VoltageBias(27, 6)),
        'ApsCas': (1, VoltageBias(21, 6)),
        'AdcRefHigh': (2, VoltageBias(32, 7)),
        'AdcRefLow': (3, VoltageBias(1, 7)),
        'AdcTestVoltage': (4, VoltageBias(21, 7)),
        'LocalBufBn': (8, _n(5, 164)),
        'PadFollBn': (9, _n(7, 215, enabled=False)),
        'DiffBn': (10, _n(4, 39)),
        'OnBn': (11, _n(5, 255)),
        'OffBn': (12, _n(4, 1)),
        'PixInvBn': (13, _n(6, 144)),
        'PrBp': (14, _p(2, 58)),
        'PrSFBp': (15, _p(1, 16)),
        'RefrBp': (16, _p(4, 25)),
        'ReadoutBufBp': (17, _p(6, 20)),
        'ApsROSFBn': (18, _n(6, 219)),
        'AdcCompBp': (19, _p(5, 20)),
        'ColSelLowBn': (20, _n(0, 1)),
        'DACBufBp': (21, _p(6, 60)),
        'LcolTimeoutBn': (22, _n(5, 49)),
        'AEPdBn': (23, _n(6, 91)),
        'AEPuXBp': (24, _p(4, 80)),
        'AEPuYBp': (25, _p(7, 152)),
        'IFRefrBn': (26, _n(5, 255)),
        'IFThrBn': (27, _n(5, 255)),
        'BiasBuffer': (34, _n(5, 254)),
        'SSP': (35, ShiftedSourceBias(1, 33)),
        'SSN': (36, ShiftedSourceBias(1, 33)),
    }
)
"""Every bias of the DAVIS346 by name: register address and default, in the order of writing."""
PARAMETER_NAMES = {
    'OnBn': 'ONBn',
    'OffBn': 'OFFBn',
    'AdcRefHigh': 'ADC_RefHigh',
    'AdcRefLow': 'ADC_RefLow',
    'AdcTestVoltage': 'ADC_TestVoltage',
}
"""Biases whose parameters have another name than DEFAULT_BIASES gives them."""
DESCRIPTIONS = {
    'ApsOverflowLevel': 'Level at which a frame pixel overflows',
    'ApsCas': 'Cascode of the frame pixels',
    'AdcRefHigh': 'White level of frames',
    'AdcRefLow': 'Black level of frames',
    'AdcTestVoltage': 'Voltage the ADC measures in its test',
    'LocalBufBn': 'Local bias buffers',
    'PadFollBn': 'Follower of the analogue test pads',
    'DiffBn': 'Gain of the change detector',
    'OnBn': 'Threshold of ON events',
    'OffBn': 'Threshold of OFF events',
    'PixInvBn': 'Inverter in the event pixels',
    'PrBp': 'Bandwidth of the photoreceptor',
    'PrSFBp': 'Bandwidth of the source follower',
    'RefrBp': 'Refractory period of the pixels',
    'ReadoutBufBp': 'Read-out buffer of the frames',
    'ApsROSFBn': 'Source follower of the frame read-out',
    'AdcCompBp': 'Comparator of the ADC',
    'ColSelLowBn': 'Column selection of the frame read-out',
    'DACBufBp': 'Buffer of the voltage references',
    'LcolTimeoutBn': 'Time-out of the event column read-out',
    'AEPdBn': 'Pull-down of the event requests',
    'AEPuXBp': 'Pull-up of the event columns',
    'AEPuYBp': 'Pull-up of the event rows',
    'IFRefrBn': 'Refractory period of the calibration neuron',
    'IFThrBn': 'Threshold of the calibration neuron',
    'BiasBuffer': 'Buffer of the bias generator',
    'SSP': 'Shifted source of the P biases',
    'SSN': 'Shifted source of the N biases',
}


def _number(name: str, part: str, description: str, maximum: int) -> int:
    default: int = getattr(DEFAULT_BIASES[name][1], part)
    return number(default, f'{DESCRIPTIONS[name]}, {description}', maximum)


def _voltage(name: str) -> int:
    return _number(name, 'voltage', 'voltage step', 63)


def _current(name: str) -> int:
    return _number(name, 'current', 'output current step', 7)


def _coarse(name: str) -> int:
    return _number(name, 'coarse', 'coarse step', 7)


def _fine(name: str) -> int:
    return _number(name, 'fine', 'fine step', 255)


def _enabled(name: str) -> bool:
    bias = DEFAULT_BIASES[name][1]
    default = isinstance(bias, CurrentBias) and bias.enabled
    return switch(default, f'{DESCRIPTIONS[name]}, enable the current')


def _reference(name: str) -> int:
    return _number(name, 'reference', 'reference step', 63)


def _regulator(name: str) -> int:
    return _number(name, 'regulator', 'regulator step', 63)


def _mode(name: str) -> int:
    text = 'mode: 0 shifted source, 1 high impedance, 2 tied to the rail'
    return _number(name, 'mode', text, 2)


def _level(name: str) -> int:
    text = 'level: 0 split gate, 1 single diode, 2 double diode'
    return _number(name, 'level', text, 2)


@dataclass(frozen=True)
class BiasParameters:
    """Biases; every field may change while the node runs."""

    ApsOverflowLevel_voltage: int = _voltage('ApsOverflowLevel')
    ApsOverflowLevel_current: int = _current('ApsOverflowLevel')
    ApsCas_voltage: int = _voltage('ApsCas')
    ApsCas_current: int = _current('ApsCas')
    ADC_RefHigh_voltage: int = _voltage('AdcRefHigh')
    ADC_RefHigh_current: int = _current('AdcRefHigh')
    ADC_RefLow_voltage: int = _voltage('AdcRefLow')
    ADC_RefLow_current: int = _current('AdcRefLow')
    ADC_TestVoltage_voltage: int = _voltage('AdcTestVoltage')
    ADC_TestVoltage_current: int = _current('AdcTestVoltage')
    LocalBufBn_coarse: int = _coarse('LocalBufBn')
    LocalBufBn_fine: int = _fine('LocalBufBn')
    LocalBufBn_enabled: bool = _enabled('LocalBufBn')
    PadFollBn_coarse: int = _coarse('PadFollBn')
    PadFollBn_fine: int = _fine('PadFollBn')
    PadFollBn_enabled: bool = _enabled('PadFollBn')
    DiffBn_coarse: int = _coarse('DiffBn')
    DiffBn_fine: int = _fine('DiffBn')
    DiffBn_enabled: bool = _enabled('DiffBn')
    ONBn_coarse: int = _coarse('OnBn')
    ONBn_fine: int = _fine('OnBn')
    ONBn_enabled: bool = _enabled('OnBn')
    OFFBn_coarse: int = _coarse('OffBn')
    OFFBn_fine: int = _fine('OffBn')
    OFFBn_enabled: bool = _enabled('OffBn')
    PixInvBn_coarse: int = _coarse('PixInvBn')
    PixInvBn_fine: int = _fine('PixInvBn')
    PixInvBn_enabled: bool = _enabled('PixInvBn')
    PrBp_coarse: int = _coarse('PrBp')
    PrBp_fine: int = _fine('PrBp')
    PrBp_enabled: bool = _enabled('PrBp')
    PrSFBp_coarse: int = _coarse('PrSFBp')
    PrSFBp_fine: int = _fine('PrSFBp')
    PrSFBp_enabled: bool = _enabled('PrSFBp')
    RefrBp_coarse: int = _coarse('RefrBp')
    RefrBp_fine: int = _fine('RefrBp')
    RefrBp_enabled: bool = _enabled('RefrBp')
    ReadoutBufBp_coarse: int = _coarse('ReadoutBufBp')
    ReadoutBufBp_fine: int = _fine('ReadoutBufBp')
    ReadoutBufBp_enabled: bool = _enabled('ReadoutBufBp')
    ApsROSFBn_coarse: int = _coarse('ApsROSFBn')
    ApsROSFBn_fine: int = _fine('ApsROSFBn')
    ApsROSFBn_enabled: bool = _enabled('ApsROSFBn')
    AdcCompBp_coarse: int = _coarse('AdcCompBp')
    AdcCompBp_fine: int = _fine('AdcCompBp')
    AdcCompBp_enabled: bool = _enabled('AdcCompBp')
    ColSelLowBn_coarse: int = _coarse('ColSelLowBn')
    ColSelLowBn_fine: int = _fine('ColSelLowBn')
    ColSelLowBn_enabled: bool = _enabled('ColSelLowBn')
    DACBufBp_coarse: int = _coarse('DACBufBp')
    DACBufBp_fine: int = _fine('DACBufBp')
    DACBufBp_enabled: bool = _enabled('DACBufBp')
    LcolTimeoutBn_coarse: int = _coarse('LcolTimeoutBn')
    LcolTimeoutBn_fine: int = _fine('LcolTimeoutBn')
    LcolTimeoutBn_enabled: bool = _enabled('LcolTimeoutBn')
    AEPdBn_coarse: int = _coarse('AEPdBn')
    AEPdBn_fine: int = _fine('AEPdBn')
    AEPdBn_enabled: bool = _enabled('AEPdBn')
    AEPuXBp_coarse: int = _coarse('AEPuXBp')
    AEPuXBp_fine: int = _fine('AEPuXBp')
    AEPuXBp_enabled: bool = _enabled('AEPuXBp')
    AEPuYBp_coarse: int = _coarse('AEPuYBp')
    AEPuYBp_fine: int = _fine('AEPuYBp')
    AEPuYBp_enabled: bool = _enabled('AEPuYBp')
    IFRefrBn_coarse: int = _coarse('IFRefrBn')
    IFRefrBn_fine: int = _fine('IFRefrBn')
    IFRefrBn_enabled: bool = _enabled('IFRefrBn')
    IFThrBn_coarse: int = _coarse('IFThrBn')
    IFThrBn_fine: int = _fine('IFThrBn')
    IFThrBn_enabled: bool = _enabled('IFThrBn')
    BiasBuffer_coarse: int = _coarse('BiasBuffer')
    BiasBuffer_fine: int = _fine('BiasBuffer')
    BiasBuffer_enabled: bool = _enabled('BiasBuffer')
    SSP_ref: int = _reference('SSP')
    SSP_reg: int = _regulator('SSP')
    SSP_mode: int = _mode('SSP')
    SSP_level: int = _level('SSP')
    SSN_ref: int = _reference('SSN')
    SSN_reg: int = _regulator('SSN')
    SSN_mode: int = _mode('SSN')
    SSN_level: int = _level('SSN')


def biases(p: BiasParameters) -> dict[str, Bias]:
    """Return the biases that parameters stand for, under the names of DEFAULT_BIASES."""
    return {name: _bias(p, name, default) for name, (_, default) in DEFAULT_BIASES.items()}


def _bias(p: BiasParameters, name: str, default: Bias) -> Bias:
    prefix = PARAMETER_NAMES.get(name, name)

    def value(part: str) -> int:
        return int(getattr(p, f'{prefix}_{part}'))

    if isinstance(default, VoltageBias):
        return VoltageBias(value('voltage'), value('current'))
    if isinstance(default, CurrentBias):
        enabled = bool(value('enabled'))
        return replace(default, coarse=value('coarse'), fine=value('fine'), enabled=enabled)
    return ShiftedSourceBias(value('ref'), value('reg'), value('mode'), value('level'))
