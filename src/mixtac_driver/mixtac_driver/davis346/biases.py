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
from typing import TypeVar

from mixtac_driver.errors import ConfigurationError
from mixtac_node.parameters import parameter

T = TypeVar('T')


def switch(default: bool, description: str) -> bool:
    """Return a field that is on or off and may change while the node runs."""
    return parameter(default, description)


def number(default: int, description: str, maximum: int, unit: str = '', minimum: int = 0) -> int:
    """Return a field for a whole number within bounds; may change while the node runs."""
    return parameter(default, description, unit=unit, within=(minimum, maximum))


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
_PARTS: Mapping[type, tuple[tuple[str, str, str, int], ...]] = {
    VoltageBias: (
        ('voltage', 'voltage', 'voltage step', 63),
        ('current', 'current', 'output current step', 7),
    ),
    CurrentBias: (
        ('coarse', 'coarse', 'coarse step', 7),
        ('fine', 'fine', 'fine step', 255),
        ('enabled', 'enabled', 'enable the current', 1),
    ),
    ShiftedSourceBias: (
        ('ref', 'reference', 'reference step', 63),
        ('reg', 'regulator', 'regulator step', 63),
        ('mode', 'mode', 'mode: 0 shifted source, 1 high impedance, 2 tied to the rail', 2),
        ('level', 'level', 'level: 0 split gate, 1 single diode, 2 double diode', 2),
    ),
}
"""Parameters of each kind of bias: suffix of the name, field, description and maximum."""


def _declare(schema: type[T]) -> type[T]:
    """Add the parameters of all biases to a class that becomes a dataclass."""
    for name, (_, bias) in DEFAULT_BIASES.items():
        for suffix, part, description, maximum in _PARTS[type(bias)]:
            default, text = getattr(bias, part), f'{DESCRIPTIONS[name]}, {description}'
            flag = isinstance(default, bool)
            field = switch(default, text) if flag else number(default, text, maximum)
            parameter_name = f'{PARAMETER_NAMES.get(name, name)}_{suffix}'
            schema.__annotations__[parameter_name] = type(default).__name__
            setattr(schema, parameter_name, field)
    return schema


@dataclass(frozen=True)
@_declare
class BiasParameters:
    """Biases, for example `ONBn_coarse`; every field may change while the node runs."""


def biases(p: BiasParameters) -> dict[str, Bias]:
    """Return the biases that parameters stand for, under the names of DEFAULT_BIASES."""
    wanted: dict[str, Bias] = {}
    for name, (_, default) in DEFAULT_BIASES.items():
        prefix = PARAMETER_NAMES.get(name, name)
        values = {
            part: getattr(p, f'{prefix}_{suffix}') for suffix, part, *_ in _PARTS[type(default)]
        }
        wanted[name] = replace(default, **values)
    return wanted
