# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames reduced to what the refinement of a clock map needs: coarse log brightness and exposure.

A frame shows the deformation of the gel averaged over its exposure, whose times the camera gives
exactly; it has none of the latency of the event pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mixtac_alignment.errors import AlignmentError

if TYPE_CHECKING:
    from numpy.typing import NDArray

CELL_PX: Final = 10
"""Side of a cell: several beads wide at most, so that motion of a part of a pixel shows."""
DARK: Final = 0.008
"""Part of the full scale that is added before the logarithm, so that dark cells do not count."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameFeatures:
    """Frames of a recording, camera clock.

    Attributes:
        start_us: Begin of each exposure, camera clock [us], ``int64 [n]``, increasing.
        end_us: End of each exposure, camera clock [us], ``int64 [n]``.
        values: Log brightness of the cells, ``float32 [n, cells]``.
    """

    start_us: NDArray[np.int64]
    end_us: NDArray[np.int64]
    values: NDArray[np.float32]

    def __post_init__(self) -> None:
        """Refuse arrays that do not pair up.

        Raises:
            AlignmentError: As above, or exposures that end before they begin.
        """
        n = len(self.start_us)
        if self.end_us.shape != (n,) or self.values.ndim != 2 or len(self.values) != n:
            raise AlignmentError(
                f'{n} exposure starts, {len(self.end_us)} ends and {len(self.values)} frames: give '
                'one of each per frame'
            )
        if n and not (np.all(self.end_us > self.start_us) and np.all(np.diff(self.start_us) > 0)):
            raise AlignmentError('exposure times do not increase: sort the frames, drop repeats')


def reduce_frame(image: NDArray[Any], full_scale: float) -> NDArray[np.float32]:
    """Return the log brightness of the cells of an image, ``float32 [cells]``.

    Args:
        image: Intensity, any integer type, ``[rows, columns]``.
        full_scale: Value of white.
    """
    rows, columns = (size // CELL_PX for size in image.shape)
    cells = image[: rows * CELL_PX, : columns * CELL_PX].reshape(rows, CELL_PX, columns, CELL_PX)
    means = cells.mean(axis=(1, 3), dtype=np.float32).ravel()
    return np.asarray(np.log(means / np.float32(full_scale) + np.float32(DARK)), np.float32)
