# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is known of the camera behind a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_driver.identity import Clocks, Features, Geometry, Identity

if TYPE_CHECKING:
    from mixtac_driver.recordings.pieces import RecordingInfo

MICROSECONDS = Clocks(logic=1.0, adc=1.0, usb=1.0)
"""Recorded exposures are in microseconds already."""


def replayed_identity(info: RecordingInfo) -> Identity:
    """Return an identity with the size and colours of the camera; versions are zero.

    Args:
        info: The recording. Its format stands for the chip, which no recording tells, and the name
            of its camera, or else its own, for the serial number.
    """
    return Identity(
        serial=info.camera or info.path.name,
        firmware=(0, 0),
        logic=(0, 0),
        chip=info.kind,
        is_master=True,
        clocks=MICROSECONDS,
        geometry=Geometry(
            dvs_columns=info.width,
            dvs_rows=info.height,
            dvs_inverted=False,
            aps_columns=info.width,
            aps_rows=info.height,
            aps_inverted=False,
        ),
        imu_type=0,
        imu_flips=(False, False, False),
        features=Features(color_filter=info.color_filter),
    )
