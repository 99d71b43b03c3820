# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual Mixtac sensor, from the elastomer to the USB device."""

from __future__ import annotations

from mixtac_core.events.errors import MixtacError


class SimulationError(MixtacError):
    """A request that the simulator cannot fulfil."""
