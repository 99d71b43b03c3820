# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What slip control refuses."""

from mixtac_events.errors import MixtacError


class SlipControlError(MixtacError):
    """A setting or a request that slip control cannot follow."""
