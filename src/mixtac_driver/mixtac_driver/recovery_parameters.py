# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of what the driver does when the camera fails."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.recovery_settings import RecoveryPolicy, RecoverySettings
from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class RecoveryParameters:
    """Reconnect or end, and how patiently."""

    recovery_policy: str = parameter(
        RecoveryPolicy.RECONNECT.value,
        'What a failure of the camera leads to: reconnect opens it again until it is back; '
        'fail_stop ends the driver with the reason and exit status 1',
        choices=tuple(policy.value for policy in RecoveryPolicy),
        read_only=True,
    )
    recovery_first_pause: float = parameter(
        0.05,
        'Pause before the first attempt to reconnect',
        unit='s',
        minimum=0.01,
        maximum=60.0,
        read_only=True,
    )
    recovery_longest_pause: float = parameter(
        0.5,
        'Longest pause between attempts; each is twice as long as the one before. A camera that is '
        'plugged in ends the pause',
        unit='s',
        minimum=0.01,
        maximum=600.0,
        read_only=True,
    )
    recovery_give_up_after: float = parameter(
        0.0,
        'Time without a stream after which the driver ends as under fail_stop; 0 never',
        unit='s',
        minimum=0.0,
        maximum=86_400.0,
        read_only=True,
    )


def recovery_settings(p: RecoveryParameters) -> RecoverySettings:
    """Return what the parameters ask for."""
    return RecoverySettings(
        policy=RecoveryPolicy(p.recovery_policy),
        first_pause_s=p.recovery_first_pause,
        longest_pause_s=p.recovery_longest_pause,
        give_up_after_s=p.recovery_give_up_after,
    )
