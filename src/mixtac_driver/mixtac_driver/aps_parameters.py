# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the frame pixels: exposure, shutter, region."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.configuration import MAXIMUM_EXPOSURE_US, MAXIMUM_FRAME_INTERVAL_US
from mixtac_driver.parameter_fields import number, switch
from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class ApsParameters:
    """Frames: all of it may change while the node runs."""

    aps_enabled: bool = switch(True, 'Frames on')
    aps_exposure: int = number(
        7000,
        'Exposure; the shipped force estimator was trained at the default',
        MAXIMUM_EXPOSURE_US,
        'us',
        minimum=1,
    )
    aps_frame_interval: int = number(
        40_000,
        'Time from frame to frame; 0 for as soon as can be',
        MAXIMUM_FRAME_INTERVAL_US,
        'us',
    )
    aps_global_shutter: bool = switch(True, 'All pixels are exposed at once')
    aps_roi_start_col: int = number(0, 'First column of the frames', 345)
    aps_roi_start_row: int = number(0, 'First row of the frames', 259)
    aps_roi_end_col: int = number(345, 'Last column of the frames', 345)
    aps_roi_end_row: int = number(259, 'Last row of the frames', 259)
    aps_auto_exposure: bool = switch(
        False, 'The driver sets the exposure by the brightness of the frames, from aps_exposure on'
    )
    aps_auto_exposure_target: float = parameter(
        0.35,
        'Mean brightness that auto-exposure aims at, as a fraction of full scale',
        minimum=0.05,
        maximum=0.9,
    )
    aps_auto_exposure_minimum: int = number(
        20, 'Shortest exposure that auto-exposure sets', MAXIMUM_EXPOSURE_US, 'us', minimum=1
    )
    aps_auto_exposure_maximum: int = number(
        30_000, 'Longest exposure that auto-exposure sets', MAXIMUM_EXPOSURE_US, 'us', minimum=1
    )
