# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Node parameters as one frozen dataclass per node: the schema that declares and checks them.

A node's parameters are a frozen dataclass whose fields are made by `parameter`; the list
`Attributes:` of its docstring describes them. The class is the only source:
`mixtac_core.node.base_node.declare` declares ROS parameters from it, `config/*.yaml` and the tables
of the documentation are written from it, and `build` checks values against it.
"""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar, cast

import yaml

from mixtac_core.events.errors import MixtacError

Value = bool | int | float | str
T = TypeVar('T')


class ParameterError(MixtacError):
    """A parameter that does not exist or whose value is not allowed."""


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One parameter: declaration and documentation.

    Attributes:
        name: ROS parameter name.
        default: Default value; its type is the type of the parameter.
        description: One or more sentences.
        unit: Unit of the value, empty for none.
        minimum: Smallest allowed number, or None.
        maximum: Largest allowed number, or None.
        choices: Allowed values, empty for any.
        read_only: Whether the value is fixed while the node runs.
    """

    name: str
    default: Value
    description: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[Value, ...]
    read_only: bool

    def check(self, value: object) -> Value:
        """Return `value` as this parameter's type.

        Raises:
            ParameterError: Wrong type, not finite, out of range, or none of the choices.
        """
        given: Any = value
        if type(self.default) is float and type(value) is int:
            given = float(value)
        remedy = ''
        if type(given) is not type(self.default):
            remedy = f'give a value of type {type(self.default).__name__}'
        elif isinstance(given, float) and not math.isfinite(given):
            remedy = 'give a finite number'
        elif self.choices and given not in self.choices:
            remedy = f'choose one of {", ".join(map(str, self.choices))}'
        elif isinstance(given, int | float) and not self._within(given):
            remedy = f'outside {self.minimum} .. {self.maximum} {self.unit}'.rstrip()
        if remedy:
            raise ParameterError(f'parameter {self.name} = {given!r}: {remedy}')
        return cast('Value', given)

    def _within(self, value: float) -> bool:
        above = self.minimum is None or value >= self.minimum
        return above and (self.maximum is None or value <= self.maximum)


def parameter(
    default: T,
    *,
    description: str = '',
    unit: str = '',
    within: tuple[float | None, float | None] = (None, None),
    choices: tuple[Value, ...] = (),
    read_only: bool = False,
) -> T:
    """Describe a field of a parameter dataclass.

    Args:
        default: Default value (bool, int, float or str).
        description: Effect, for the descriptor, the configuration file and the docs; if empty, as
            the docstring of the class describes the attribute.
        unit: Unit of the value.
        within: Smallest and largest allowed number; None for no limit.
        choices: Allowed values.
        read_only: Whether the value is fixed while the node runs.

    Returns:
        A dataclass field, typed as its value so that the class type-checks.
    """
    limits = {'minimum': within[0], 'maximum': within[1]}
    rest = {'unit': unit, 'choices': choices, 'read_only': read_only}
    return dataclasses.field(default=default, metadata={'description': description} | limits | rest)


def fixed(default: T, **options: Any) -> T:  # noqa: ANN401
    """Describe a field that cannot change while the node runs; arguments as in `parameter`."""
    field: T = parameter(default, read_only=True, **options)
    return field


def specs(schema: type[Any]) -> tuple[ParameterSpec, ...]:
    """Return the parameters of a schema class, in the order of its fields."""
    described: dict[str, str] = {}
    for base in reversed(schema.__mro__):
        described |= _attributes(base)
    found = []
    for each in dataclasses.fields(schema):
        text = each.metadata['description'] or described.get(each.name, '')
        own: Any = {'name': each.name, 'default': each.default, 'description': text}
        found.append(ParameterSpec(**{**each.metadata, **own}))
    return tuple(found)


@cache
def _attributes(described: type[Any]) -> dict[str, str]:
    """Return the descriptions of the attributes in the docstring of a class."""
    _, _, section = inspect.cleandoc(described.__doc__ or '').partition('\nAttributes:\n')
    entries = section.partition('\n\n')[0]
    found = re.findall(r'^ {4}(\w+): (.+(?:\n {5,}.+)*)', entries, re.MULTILINE)
    return {name: ' '.join(text.split()) for name, text in found}


def build(schema: type[T], values: Mapping[str, object]) -> T:
    """Return a schema instance with the given values and defaults for the rest.

    Args:
        schema: A frozen dataclass made of `parameter` fields.
        values: Values by name.

    Raises:
        ParameterError: Unknown name or value not allowed.
    """
    known = {spec.name: spec for spec in specs(schema)}
    unknown = sorted(set(values) - set(known))
    if unknown:
        near = difflib.get_close_matches(unknown[0], known, 1) or [', '.join(known)]
        raise ParameterError(f'unknown parameter {unknown[0]}', remedy=f'did you mean {near[0]}?')
    return schema(**{name: known[name].check(value) for name, value in values.items()})


def parameter_file(node: str, settings: Any) -> str:  # noqa: ANN401
    """Return settings as a parameter file of ROS 2.

    Args:
        node: Name of the node, in any namespace.
        settings: An instance of a schema.
    """
    lines = [f'/**/{node}:', '  ros__parameters:']
    for name in (spec.name for spec in specs(type(settings))):
        lines += [f'    {name}: {yaml_scalar(getattr(settings, name))}']
    return '\n'.join(lines) + '\n'


def yaml_scalar(value: object) -> str:
    """Return the value of a parameter as YAML, for ROS 2 and for YAML 1.1."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        # Always quoted: ROS 2 reads a serial number such as 00000389 or 12345e67 as a number.
        if value.isascii() and value.isprintable():
            return "'" + value.replace("'", "''") + "'"
        return str(yaml.safe_dump(value, default_style='"', width=math.inf)).strip()
    text = repr(value)
    # YAML 1.1 reads 3e-08 as a string.
    return text.replace('e', '.0e') if 'e' in text and '.' not in text else text
