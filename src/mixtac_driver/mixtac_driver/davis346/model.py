# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera model: chips, firmware and logic versions, pixel arrays, limits of its settings."""

from __future__ import annotations

from dataclasses import dataclass

CHIP_NAMES = {
    0: 'DAVIS240A',
    1: 'DAVIS240B',
    2: 'DAVIS240C',
    3: 'DAVIS128',
    4: 'DAVIS346A',
    5: 'DAVIS346B',
    6: 'DAVIS640',
    7: 'DAVIS640H',
    8: 'DAVIS208',
    9: 'DAVIS346C',
}
SUPPORTED_CHIPS = (4, 5, 9)
LOGIC_VERSION = 18
MINIMUM_LOGIC_PATCH = 1
MINIMUM_FIRMWARE = 6


@dataclass(frozen=True, slots=True)
class Geometry:
    """Sizes and orientations of the two pixel arrays, as the stream decoder needs them.

    Attributes:
        dvs_columns: Limit of column addresses on the wire.
        dvs_rows: Limit of row addresses on the wire.
        dvs_inverted: True where row addresses are x and column addresses y.
        aps_columns: Columns read out per frame.
        aps_rows: Samples per column.
        aps_inverted: True where columns are read out along y.
        aps_flip_x: True where the first column is the last one of the image.
        aps_flip_y: True where the first sample is the last one of a column.
    """

    dvs_columns: int = 260
    dvs_rows: int = 346
    dvs_inverted: bool = True
    aps_columns: int = 260
    aps_rows: int = 346
    aps_inverted: bool = True
    aps_flip_x: bool = False
    aps_flip_y: bool = False

    @property
    def width(self) -> int:
        """Width of the image [pixels]."""
        return self.aps_rows if self.aps_inverted else self.aps_columns

    @property
    def height(self) -> int:
        """Height of the image [pixels]."""
        return self.aps_columns if self.aps_inverted else self.aps_rows

    @property
    def event_size(self) -> tuple[int, int]:
        """Width and height of the event array [pixels]."""
        size = (self.dvs_columns, self.dvs_rows)
        return (size[1], size[0]) if self.dvs_inverted else size


WIDTH, HEIGHT = 346, 260
PIXEL_FILTERS = 8
MAXIMUM_EXPOSURE_US = 4_194_303
MAXIMUM_FRAME_INTERVAL_US = 8_388_607
MAXIMUM_PULSE_US = 1_048_575
