# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of slip control and of the arm that it moves; each text names the remedy."""

from __future__ import annotations

from mixtac_core.events.errors import MixtacError


class SlipControlError(MixtacError):
    """A setting or a request that slip control cannot follow."""


class ArmError(SlipControlError):
    """An arm, a state or a request that cannot be followed."""


class UnreachableError(ArmError):
    """A pose or an advance that the arm cannot reach from where it stands."""


class BackendError(ArmError):
    """A robot, or the library that talks to it, that is missing or reports a fault."""
