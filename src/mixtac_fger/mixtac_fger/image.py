# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading pixels out of a sensor_msgs/Image, whatever its rows are padded with."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import ImageError

if TYPE_CHECKING:
    from array import array

    from numpy.typing import NDArray

    Buffer = bytes | bytearray | memoryview | array[int]

_TYPES = {'mono8': np.uint8, '8UC1': np.uint8, 'mono16': np.uint16, '16UC1': np.uint16}


def pixels(
    data: Buffer, encoding: str, height: int, width: int, step: int, *, big_endian: bool
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the pixels of an image, [height, width] in native byte order.

    Args:
        data: Bytes of the image, `step` per row.
        encoding: mono8, mono16, 8UC1 or 16UC1.
        height: Rows.
        width: Columns.
        step: Bytes from one row to the next.
        big_endian: Byte order of 16-bit pixels.

    Returns:
        A view of `data` where its layout allows that, else a copy.

    Raises:
        ImageError: Another encoding, or sizes that contradict each other.
    """
    if encoding not in _TYPES:
        raise ImageError(f'image encoding {encoding!r}: publish mono8 or mono16')
    kind = np.dtype(_TYPES[encoding])
    raw = np.frombuffer(data, np.uint8)
    if step < width * kind.itemsize or raw.size < height * step:
        raise ImageError(
            f'image of {width} x {height} {encoding} with step {step} holds {raw.size} bytes: the'
            f' publisher must fill {kind.itemsize} bytes per pixel'
        )
    rows = raw[: height * step].reshape(height, step)[:, : width * kind.itemsize]
    image = np.ascontiguousarray(rows).view(kind)
    swap = kind.itemsize > 1 and big_endian != (sys.byteorder == 'big')
    return image.byteswap() if swap else image
