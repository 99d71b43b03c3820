# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the clock alignment; each text names the remedy."""

from __future__ import annotations

from mixtac_core.events.errors import MixtacError


class AlignmentError(MixtacError):
    """Two recordings whose clocks cannot be aligned."""


class NoImpulseError(AlignmentError):
    """Fewer than two impulses in one of the recordings, or none that match."""


class AmbiguousImpulsesError(AlignmentError):
    """Impulses that match in more than one way."""


class SaturatedImpulseError(AlignmentError):
    """An impulse cut off by the range of the force sensor: its peak has no time."""


class ShortBaselineError(AlignmentError):
    """Anchors too close to each other for their uncertainty."""


class DriftError(AlignmentError):
    """A clock drift that no pair of working clocks has."""


class GapError(AlignmentError):
    """Data missing where they are needed, or a clock that jumped."""
