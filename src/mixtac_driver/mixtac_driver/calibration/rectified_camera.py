# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The camera that rectified images seem to come from: how much of the wide image it keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.calibration.distortion import undistort
from mixtac_driver.calibration.errors import Refusal, RefusedError

if TYPE_CHECKING:
    from numpy.typing import NDArray


def rectified_camera(
    model: str,
    coefficients: NDArray[np.float64],
    camera_matrix: NDArray[np.float64],
    size: tuple[int, int],
    alpha: float = 0.0,
) -> NDArray[np.float64]:
    """Return a projection matrix P with square pixels.

    Args:
        model: One of `distortion.MODELS`.
        coefficients: Of that model.
        camera_matrix: K [3, 3].
        size: Columns and rows of the image.
        alpha: 0 shows only what fills the whole rectified image; 1 shows all that the camera sees,
            small and with black corners; values between change the focal length evenly.

    Returns:
        P [3, 4].

    Raises:
        RefusedError: The model shows nothing along a whole edge of the image.
    """
    focal, centre = camera_matrix[[0, 1], [0, 1]], camera_matrix[:2, 2]
    left, right, top, bottom = (
        undistort(model, coefficients, (edge - centre) / focal) for edge in _edges(*size)
    )
    if any(np.isnan(each).all() for each in (left, right, top, bottom)):
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'the {model} model folds back along an edge of the image; use --model equidistant',
        )
    inner_low = np.array([np.nanmax(left[:, 0]), np.nanmax(top[:, 1])])
    inner_high = np.array([np.nanmin(right[:, 0]), np.nanmin(bottom[:, 1])])
    rim = np.concatenate([left, right, top, bottom])
    outer_low, outer_high = np.nanmin(rim, axis=0), np.nanmax(rim, axis=0)
    last = np.array(size) - 1.0
    close = float((last / (inner_high - inner_low)).max())
    far = float((last / (outer_high - outer_low)).min())
    zoom = close ** (1.0 - alpha) * far**alpha
    middle = 0.5 * ((1.0 - alpha) * (inner_low + inner_high) + alpha * (outer_low + outer_high))
    projection = np.zeros((3, 4))
    projection[0, 0] = projection[1, 1] = zoom
    projection[:2, 2] = last / 2.0 - zoom * middle
    projection[2, 2] = 1.0
    return projection


def _edges(width: int, height: int) -> list[NDArray[np.float64]]:
    """Return the pixels of the left, right, top and bottom edge, each [n, 2]."""
    x, y = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
    return [
        np.stack([np.zeros_like(y), y], axis=1),
        np.stack([np.full_like(y, width - 1), y], axis=1),
        np.stack([x, np.zeros_like(x)], axis=1),
        np.stack([x, np.full_like(x, height - 1)], axis=1),
    ]
