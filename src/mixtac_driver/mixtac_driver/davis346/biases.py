# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Biases of the DAVIS346 chip: values, register encoding, defaults and node parameters.

Three kinds of bias share one register file (module CHIP, parameters 0 .. 36), each with its own
packing into the low 16 bits of the value. `biases.csv` lists them with their defaults. Parameters
are named as in libcaer_driver, one per field of each bias.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from mixtac_driver.errors import ConfigurationError
from mixtac_node.parameters import parameter

T = TypeVar('T')


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


_KINDS: Mapping[str, Callable[[int, int], Bias]] = {
    'voltage': VoltageBias,
    'n': partial(CurrentBias, n_type=True),
    'n off': partial(CurrentBias, n_type=True, enabled=False),
    'p': partial(CurrentBias, n_type=False),
    'shifted source': ShiftedSourceBias,
}


def _table() -> dict[str, dict[str, str]]:
    """Return the rows of `biases.csv` by name."""
    lines = Path(__file__).with_suffix('.csv').read_text(encoding='utf-8').splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith('#'))
    return {row['name']: row for row in rows}


_TABLE = _table()
DEFAULT_BIASES: Mapping[str, tuple[int, Bias]] = MappingProxyType(
    {
        name: (int(row['address']), _KINDS[row['kind']](int(row['first']), int(row['second'])))
        for name, row in _TABLE.items()
    }
)
"""Every bias of the DAVIS346 by name: register address and default, in the order of writing."""
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
            default, text = getattr(bias, part), f'{_TABLE[name]["description"]}, {description}'
            within = (None, None) if isinstance(default, bool) else (0, maximum)
            field = parameter(default, description=text, within=within)
            parameter_name = f'{_TABLE[name]["parameter"]}_{suffix}'
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
        prefix, parts = _TABLE[name]['parameter'], _PARTS[type(default)]
        values = {part: getattr(p, f'{prefix}_{suffix}') for suffix, part, *_ in parts}
        wanted[name] = replace(default, **values)
    return wanted
