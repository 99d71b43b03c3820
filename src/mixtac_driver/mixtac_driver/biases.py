# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bias currents and voltages of the DAVIS346 chip: what they mean and how they are written.

Three kinds of bias share one register file (module CHIP, parameters 0 .. 36), each with its own
packing into the low 16 bits of the value. Defaults are those that libcaer 3.3 sends.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from mixtac_driver.errors import ConfigurationError

if TYPE_CHECKING:
    from collections.abc import Mapping

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
