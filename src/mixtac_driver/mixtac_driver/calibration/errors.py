# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a calibration."""

from __future__ import annotations

from enum import Enum

from mixtac_driver.errors import DriverError


class CalibrationError(DriverError):
    """A calibration that is missing, damaged, or of another camera."""


class Refusal(Enum):
    """Why views give no calibration; the value says it in words."""

    TOO_FEW_VIEWS = 'too few views'
    TOO_ALIKE = 'views too alike'
    POOR_COVERAGE = 'views do not cover the image'
    NO_FIT = 'no fit'
    LARGE_RESIDUAL = 'large reprojection error'
    IMPLAUSIBLE = 'implausible camera'


class RefusedError(CalibrationError):
    """Views from which no calibration can be trusted.

    Args:
        reason: Which demand they fail.
        detail: The value found, and the remedy.

    Attributes:
        reason: Which demand they fail.
    """

    def __init__(self, reason: Refusal, detail: str) -> None:
        super().__init__(f'{reason.value}: {detail}')
        self.reason = reason
