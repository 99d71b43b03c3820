# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node that compares force and reference."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class ForceErrorParameters:
    """What the force error is taken from."""

    force_topic: str = parameter('force', 'WrenchStamped topic of the estimate.', read_only=True)
    reference_topic: str = parameter(
        'alignment/reference',
        'WrenchStamped topic of the reference on the camera clock.',
        read_only=True,
    )
    window: int = parameter(
        5000,
        'Pairs over which the errors run; 5000 are 10 s of estimates.',
        minimum=10,
        maximum=1_000_000,
        read_only=True,
    )
    sign: int = parameter(
        1,
        'Sign that makes pressing positive in the reference.',
        minimum=-1,
        maximum=1,
        read_only=True,
    )
