# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One calibrated camera: what `sensor_msgs/CameraInfo` says of it, checked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.calibration.distortion import EQUIDISTANT, MODELS, distort, undistort
from mixtac_driver.calibration.errors import CalibrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ROTATION_TOLERANCE = 1e-3
"""Files carry as few as five digits."""
_EXACT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """The lens and geometry of one camera, and the camera that rectified images seem to come from.

    Attributes:
        name: Name of the camera.
        width: Columns of the full image.
        height: Rows of the full image.
        model: Distortion model, one of `distortion.MODELS`.
        distortion: Coefficients of the model [n].
        camera_matrix: K [3, 3], focal lengths and principal point [px].
        rectification: R [3, 3], rotation from the camera to the rectified camera.
        projection: P [3, 4], the rectified camera [px].

    Raises:
        CalibrationError: Values that describe no camera.
    """

    name: str
    width: int
    height: int
    model: str
    distortion: NDArray[np.float64]
    camera_matrix: NDArray[np.float64]
    rectification: NDArray[np.float64]
    projection: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Refuse values that describe no camera."""
        self._check_model()
        _check_camera('camera_matrix', self.camera_matrix)
        _check_camera('projection_matrix', self.projection)
        turned = self.rectification @ self.rectification.T - np.eye(3)
        if np.abs(turned).max() > _ROTATION_TOLERANCE or np.linalg.det(self.rectification) < 0.0:
            raise CalibrationError(
                f'rectification_matrix {self.rectification.ravel().tolist()} is no rotation: '
                'give the identity for a single camera'
            )

    def _check_model(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise CalibrationError(
                f'image size {self.width}x{self.height}: give the columns and rows of the camera'
            )
        if self.model not in MODELS:
            raise CalibrationError(
                f'distortion_model {self.model!r} is unknown: use {", ".join(MODELS)}'
            )
        if self.distortion.shape != (MODELS[self.model],):
            raise CalibrationError(
                f'distortion_coefficients: {self.distortion.size} given, '
                f'{self.model} has {MODELS[self.model]}'
            )
        for field in ('distortion', 'camera_matrix', 'rectification', 'projection'):
            if not np.isfinite(getattr(self, field)).all():
                raise CalibrationError(f'{field} holds a number that is not finite: calibrate anew')

    @property
    def size(self) -> tuple[int, int]:
        """Return columns and rows."""
        return self.width, self.height

    def undistort(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rectified pixels of raw pixels [n, 2], NaN where there is none."""
        focal, centre = _focal(self.camera_matrix)
        ideal = undistort(self.model, self.distortion, (points - centre) / focal)
        rays = _turned(ideal, self.rectification)
        return rays @ self.projection[:2, :2].T + self.projection[:2, 2]

    def distort(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the raw pixels of rectified pixels [n, 2], NaN where there is none."""
        focal, centre = _focal(self.projection)
        ideal = _turned((points - centre) / focal, self.rectification.T)
        focal, centre = _focal(self.camera_matrix)
        return distort(self.model, self.distortion, ideal) * focal + centre

    def rectified(self) -> CameraCalibration:
        """Return the camera that rectified images seem to come from: no distortion, K from P."""
        return replace(
            self,
            distortion=np.zeros_like(self.distortion) if self.model != EQUIDISTANT else np.zeros(5),
            # Zeros of the equidistant model are a lens of its own; zeros of Brown's are none.
            model=self.model if self.model != EQUIDISTANT else 'plumb_bob',
            camera_matrix=self.projection[:, :3].copy(),
            rectification=np.eye(3),
        )


def _focal(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.array([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2]


def _turned(points: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    rays = points @ rotation[:, :2].T + rotation[:, 2]
    with np.errstate(invalid='ignore', divide='ignore'):
        ahead = np.where(rays[:, 2:] > 0.0, rays[:, 2:], np.nan)
        return np.asarray(rays[:, :2] / ahead)


def _check_camera(field: str, matrix: NDArray[np.float64]) -> None:
    fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
    if fx <= 0.0 or fy <= 0.0:
        raise CalibrationError(f'{field}: focal lengths {fx:g}, {fy:g} px must be positive')
    if abs(matrix[0, 1]) > _EXACT or abs(matrix[1, 0]) > _EXACT:
        raise CalibrationError(f'{field}: skew {matrix[0, 1]:g} is not supported: calibrate anew')
    last = np.zeros(matrix.shape[1])
    last[2] = 1.0
    if np.abs(matrix[2] - last).max() > _EXACT:
        raise CalibrationError(f'{field}: last row {matrix[2].tolist()} must be {last.tolist()}')
