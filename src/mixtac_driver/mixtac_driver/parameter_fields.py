# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Short forms of the parameter fields that the driver has many of."""

from __future__ import annotations

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
