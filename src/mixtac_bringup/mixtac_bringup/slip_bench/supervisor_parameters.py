# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the supervisor of a simulated grasp."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class SupervisorParameters:
    """When the supervisor lets the object be struck."""

    knock_every: float = parameter(
        8.0,
        'Least time between blows, which come while slip control is enabled; 0 for none.',
        unit='s',
        minimum=0.0,
        maximum=3600.0,
    )
