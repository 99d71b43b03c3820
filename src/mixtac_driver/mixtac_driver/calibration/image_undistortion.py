# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Undistortion of frames by maps that are made once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from mixtac_driver.calibration.lens import CalibrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_driver.calibration.lens import CameraCalibration


_OUTSIDE_PX = -1e6
_BAYER = 'bayer_'
_INTERPOLATIONS = {
    'rggb': cv2.COLOR_BayerRGGB2BGR,
    'grbg': cv2.COLOR_BayerGRBG2BGR,
    'gbrg': cv2.COLOR_BayerGBRG2BGR,
    'bggr': cv2.COLOR_BayerBGGR2BGR,
}


class ImageUndistortion:
    """Frames as the rectified camera would see them (bilinear interpolation, black outside).

    Args:
        calibration: The camera; its R and P say what to rectify to.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        self._size = calibration.size
        width, height = self._size
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
        raw = calibration.distort(np.stack([columns.ravel(), rows.ravel()], axis=1))
        maps = np.nan_to_num(raw.T, nan=_OUTSIDE_PX).astype(np.float32).reshape(2, height, width)
        self._full = (maps[0], maps[1])
        self._offset, self._shifted = (0, 0), self._full

    def undistort(
        self, image: NDArray[np.uint8 | np.uint16], x: int = 0, y: int = 0
    ) -> NDArray[np.uint8 | np.uint16]:
        """Return the rectified image, always of the camera's full size.

        Args:
            image: `uint8` or `uint16` [height, width] or [height, width, channels]; no Bayer
                mosaic, whose pattern would be torn.
            x: Column of the image's first column in the full image, where only a region was read.
            y: Row of its first row.

        Raises:
            CalibrationError: The image does not fit into the calibrated size.
        """
        height, width = image.shape[:2]
        if min(x, y) < 0 or x + width > self._size[0] or y + height > self._size[1]:
            raise CalibrationError(
                f'image {width}x{height} at ({x}, {y}) is not inside the calibrated '
                f'{self._size[0]}x{self._size[1]}: calibrate this camera'
            )
        if (x, y) != self._offset:
            self._offset = (x, y)
            self._shifted = (self._full[0] - np.float32(x), self._full[1] - np.float32(y))
        return np.asarray(
            cv2.remap(
                image,
                *self._shifted,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=0,
            ),
            image.dtype,
        )


def without_mosaic(
    image: NDArray[np.uint8 | np.uint16], encoding: str
) -> tuple[NDArray[np.uint8 | np.uint16], str]:
    """Return a frame whose pixels may be moved, and its encoding.

    A Bayer mosaic is interpolated to `bgr8` or `bgr16`; everything else is returned as it is.

    Args:
        image: `uint8` or `uint16` [height, width].
        encoding: ROS encoding of the image.

    Raises:
        CalibrationError: A mosaic of an unknown pattern.
    """
    if not encoding.startswith(_BAYER):
        return image, encoding
    pattern, bits = encoding[len(_BAYER) :][:4], encoding[len(_BAYER) :][4:]
    if pattern not in _INTERPOLATIONS:
        raise CalibrationError(f'encoding {encoding!r}: mosaics are {", ".join(_INTERPOLATIONS)}')
    colour = cv2.cvtColor(image, _INTERPOLATIONS[pattern])
    return np.asarray(colour, image.dtype), f'bgr{bits}'
