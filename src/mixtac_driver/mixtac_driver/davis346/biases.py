# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Biases of the DAVIS346 chip: register encoding, defaults and node parameters.

Three kinds of bias share one register file (module CHIP, parameters 0 .. 36), each with its own
packing into the low 16 bits of the value. `biases.csv` lists them with their defaults. Parameters
are named as in libcaer_driver, one per field of each bias.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from mixtac_core.node.parameters import parameter

T = TypeVar('T')


class Field(NamedTuple):
    """A part of a bias.

    Attributes:
        suffix: End of the name of its parameter.
        description: What it sets.
        maximum: Largest value.
        bit: Lowest bit in the register.
    """

    suffix: str
    description: str
    maximum: int
    bit: int


VOLTAGE = (
    Field('voltage', 'voltage step', 63, 0),
    Field('current', 'output current step', 7, 6),
)
"""A voltage made by a digital-to-analogue converter (VDAC)."""
CURRENT = (
    Field('coarse', 'coarse step', 7, 12),
    Field('fine', 'fine step', 255, 4),
    Field('enabled', 'enable the current', 1, 0),
)
"""A coarse-fine current source."""
SHIFTED_SOURCE = (
    Field('ref', 'reference step', 63, 4),
    Field('reg', 'regulator step', 63, 10),
    Field('mode', 'mode: 0 shifted source, 1 high impedance, 2 tied to the rail', 2, 0),
    Field('level', 'level: 0 split gate, 1 single diode, 2 double diode', 2, 2),
)
"""A regulated supply of the bias generator itself."""
P_TYPE = 0b1100
"""Bits of a current source with a P transistor, not a cascode, in the normal current range."""
N_TYPE = P_TYPE | 0b10
"""The same with an N transistor, which sinks."""
KINDS: Mapping[str, tuple[tuple[Field, ...], int, tuple[int, ...]]] = MappingProxyType(
    {
        'voltage': (VOLTAGE, 0, ()),
        'n': (CURRENT, N_TYPE, (True,)),
        'n off': (CURRENT, N_TYPE, (False,)),
        'p': (CURRENT, P_TYPE, (True,)),
        'shifted source': (SHIFTED_SOURCE, 0, (0, 0)),
    }
)
"""Fields, fixed bits, and defaults beyond those of `biases.csv`, by kind."""


@dataclass(frozen=True, slots=True)
class Bias:
    """A bias of the chip.

    Attributes:
        address: Register of module CHIP.
        parameter: Start of the names of its parameters.
        description: What it does.
        fields: Its fields.
        fixed: Bits that no field sets.
        defaults: Default of each field.
    """

    address: int
    parameter: str
    description: str
    fields: tuple[Field, ...]
    fixed: int
    defaults: tuple[int, ...]

    def encode(self, parameters: object) -> int:
        """Return the register value; fields without a parameter have their default."""
        value = self.fixed
        for field, default in zip(self.fields, self.defaults, strict=True):
            name = f'{self.parameter}_{field.suffix}'
            value |= int(getattr(parameters, name, default)) << field.bit
        return value


def _biases() -> dict[str, Bias]:
    lines = Path(__file__).with_suffix('.csv').read_text(encoding='utf-8').splitlines()
    found = {}
    for row in csv.DictReader(line for line in lines if not line.startswith('#')):
        fields, fixed, more = KINDS[row['kind']]
        found[row['name']] = Bias(
            address=int(row['address']),
            parameter=row['parameter'],
            description=row['description'],
            fields=fields,
            fixed=fixed,
            defaults=(int(row['first']), int(row['second']), *more),
        )
    return found


DEFAULT_BIASES: Mapping[str, Bias] = MappingProxyType(_biases())
"""Every bias of the DAVIS346 by name, in the order of writing."""


def _declare(schema: type[T]) -> type[T]:
    """Add the parameters of all biases to a class that becomes a dataclass."""
    for bias in DEFAULT_BIASES.values():
        for field, default in zip(bias.fields, bias.defaults, strict=True):
            within = (None, None) if isinstance(default, bool) else (0, field.maximum)
            text = f'{bias.description}, {field.description}'
            name = f'{bias.parameter}_{field.suffix}'
            schema.__annotations__[name] = type(default).__name__
            setattr(schema, name, parameter(default, description=text, within=within))
    return schema


@dataclass(frozen=True)
@_declare
class BiasParameters:
    """Biases, for example `ONBn_coarse`; every field may change while the node runs."""
