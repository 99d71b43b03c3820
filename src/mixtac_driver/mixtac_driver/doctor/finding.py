# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a check found."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

Value = str | int | float | bool | None


class Level(IntEnum):
    """How bad it is, ordered."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that was looked at.

    Attributes:
        name: What was looked at, a few words.
        level: How bad it is.
        found: What was found.
        remedy: What to do about it, empty where there is nothing to do.
        values: The figures behind it, by name with unit.
    """

    name: str
    level: Level
    found: str
    remedy: str = ''
    values: Mapping[str, Value] = field(default_factory=dict)


def ok(name: str, found: str, **values: Value) -> Finding:
    """Return a finding that needs no action."""
    return Finding(name, Level.OK, found, values=values)


def worst(findings: Iterable[Finding]) -> Level:
    """Return the highest level of all, OK where there are none."""
    return max((finding.level for finding in findings), default=Level.OK)


def first_to_do(findings: Iterable[Finding]) -> Finding | None:
    """Return the first of the worst findings, or None where all is well.

    Checks come in the order in which one depends on another, so the first is the one to mend.
    """
    found = list(findings)
    level = worst(found)
    return next((f for f in found if f.level is level), None) if level > Level.OK else None
