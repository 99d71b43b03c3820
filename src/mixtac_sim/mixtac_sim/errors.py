# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the simulated sensor."""

from __future__ import annotations

from mixtac_events.errors import MixtacError


class SimulationError(MixtacError):
    """A request that the simulated sensor cannot honour."""
