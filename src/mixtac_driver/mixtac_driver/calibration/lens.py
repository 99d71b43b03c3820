# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lens distortion models and the calibration of one camera as in `sensor_msgs/CameraInfo`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from mixtac_driver.errors import DriverError
from mixtac_events.arrays import Floats


class CalibrationError(DriverError):
    """A calibration that is missing, damaged, or of another camera."""


class Refusal(Enum):
    """Reason to refuse a calibration; values are shown to users."""

    TOO_FEW_VIEWS = 'too few views'
    TOO_ALIKE = 'views too alike'
    POOR_COVERAGE = 'views do not cover the image'
    NO_FIT = 'no fit'
    LARGE_RESIDUAL = 'large reprojection error'
    IMPLAUSIBLE = 'implausible camera'


class RefusedError(CalibrationError):
    """Views that give no trustworthy calibration.

    Args:
        reason: The demand that is not met.
        found: The value found.
        remedy: What the user can do about it.

    Attributes:
        reason: As given.
    """

    def __init__(self, reason: Refusal, found: str, remedy: str) -> None:
        super().__init__(f'{reason.value}: {found}', remedy=remedy)
        self.reason = reason


EQUIDISTANT = 'equidistant'
MODELS = {
    'plumb_bob': ('k1', 'k2', 'p1', 'p2', 'k3'),
    'rational_polynomial': ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6'),
    EQUIDISTANT: ('k1', 'k2', 'k3', 'k4'),
}
"""Names of the coefficients by model."""
MAX_ANGLE_RAD = np.deg2rad(85.0)
"""Largest angle off the axis; a plane cannot show 90 degrees."""
FOCAL_AND_CENTRE, POSE = 4, 6
"""Unknowns of a camera beside its distortion, and of the place of a board."""
_STEPS = 4000
_NEWTON_STEPS = 8
_TOLERANCE, _STILL = 1e-8, 1e-12


def check_model(model: str) -> None:
    """Raise if a name is not a lens model.

    Raises:
        CalibrationError: It is not in MODELS.
    """
    if model not in MODELS:
        raise CalibrationError(f'distortion model {model!r} is unknown: use {", ".join(MODELS)}')


def distort(model: str, coefficients: Floats, points: Floats) -> Floats:
    """Return the distorted places of ideal points.

    Args:
        model: One of MODELS.
        coefficients: Of that model.
        points: Ideal pinhole points x/z, y/z [n, 2].

    Returns:
        Distorted points [n, 2], NaN beyond the angle at which the model folds back.
    """
    radius = np.hypot(points[:, 0], points[:, 1])
    inside = np.where(radius <= fold_radius(model, coefficients), 1.0, np.nan)[:, None]
    return inside * _forward(model, coefficients, points)[0]


def undistort(model: str, coefficients: Floats, points: Floats) -> Floats:
    """Return the ideal points of distorted ones.

    Args:
        model: One of MODELS.
        coefficients: Of that model.
        points: Distorted points on the normalised plane [n, 2].

    Returns:
        Ideal pinhole points [n, 2], NaN where there is none.
    """
    bent = np.hypot(points[:, 0], points[:, 1])
    radii = np.linspace(0.0, fold_radius(model, coefficients), _STEPS)
    guess = np.interp(bent, _radial(model, coefficients, radii), radii, right=np.nan)
    ideal = points * (guess / np.maximum(bent, 1e-12))[:, None]
    for _ in range(_NEWTON_STEPS):
        shown, jacobian = _forward(model, coefficients, ideal)
        step = _solve(jacobian, shown - points)
        ideal = ideal - step
        if np.abs(np.nan_to_num(step)).max(initial=0.0) < _STILL:
            break
    error = np.abs(_forward(model, coefficients, ideal)[0] - points).max(axis=1, initial=0.0)
    with np.errstate(invalid='ignore'):
        good = (error < _TOLERANCE) & (np.hypot(ideal[:, 0], ideal[:, 1]) <= 1.001 * radii[-1])
    return np.where(good[:, None], ideal, np.nan)


def fold_radius(model: str, coefficients: Floats) -> float:
    """Return the ideal radius up to which the distorted radius grows."""
    angles = np.linspace(0.0, MAX_ANGLE_RAD, _STEPS)
    shown = _radial(model, coefficients, np.tan(angles))
    rising = np.diff(shown) > 0.0
    last = len(angles) - 1 if rising.all() else int(np.argmin(rising))
    return float(np.tan(angles[last]))


def _radial(model: str, coefficients: Floats, radius: Floats) -> Floats:
    """Return the distorted radius along an axis, without Brown's tangential terms."""
    even = coefficients.copy()
    if model != EQUIDISTANT:
        even[2:4] = 0.0
    return _forward(model, even, np.stack([radius, np.zeros_like(radius)], axis=1))[0][:, 0]


def _forward(model: str, coefficients: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return distorted points [n, 2] and their derivatives by the ideal ones [n, 2, 2]."""
    rays = np.column_stack([points, np.ones(len(points))])
    shown, _, by_pose = project(rays, np.zeros(3), np.zeros(3), np.eye(3), coefficients, model)
    return shown, by_pose.reshape(-1, 2, POSE)[:, :, 3:5]


def project(
    points: Floats, turn: Floats, place: Floats, matrix: Floats, coefficients: Floats, model: str
) -> tuple[Floats, Floats, Floats]:
    """Return the image of board points, and its derivatives.

    Args:
        points: Board points [n, 3] [m].
        turn: Rotation vector of the board [3] [rad].
        place: Position of the board [3] [m].
        matrix: K [3, 3].
        coefficients: Distortion.
        model: One of MODELS.

    Returns:
        Pixels [n, 2]; derivatives by fx, fy, cx, cy and coefficients [2 n, 4 + k]; derivatives by
        the pose [2 n, 6].
    """
    import cv2

    shaped = points.reshape(-1, 1, 3)
    if model == EQUIDISTANT:
        pixels, jacobian = cv2.fisheye.projectPoints(shaped, turn, place, matrix, coefficients)
        lens = FOCAL_AND_CENTRE + len(MODELS[model])
        by_lens, by_pose = jacobian[:, :lens], jacobian[:, lens : lens + POSE]
    else:
        pixels, jacobian = cv2.projectPoints(shaped, turn, place, matrix, coefficients)
        by_lens, by_pose = jacobian[:, POSE:], jacobian[:, :POSE]
    return (
        np.asarray(pixels, np.float64).reshape(-1, 2),
        np.asarray(by_lens, np.float64),
        np.asarray(by_pose, np.float64),
    )


def _solve(jacobian: Floats, error: Floats) -> Floats:
    """Return the solutions of n linear systems of two unknowns; NaN stays NaN."""
    a, b, c, d = (jacobian[:, i, j] for i in (0, 1) for j in (0, 1))
    scale = 1.0 / np.where(np.abs(a * d - b * c) > 1e-12, a * d - b * c, np.nan)
    return np.stack(
        [scale * (d * error[:, 0] - b * error[:, 1]), scale * (a * error[:, 1] - c * error[:, 0])],
        axis=1,
    )


_ROTATION_TOLERANCE = 1e-3
"""Files have as few as five digits."""
_EXACT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """The lens and geometry of one camera, and the virtual camera of rectified images.

    Attributes:
        name: Name of the camera.
        width: Columns of the full image.
        height: Rows of the full image.
        model: Distortion model, one of `MODELS`.
        distortion: Coefficients of the model [n].
        camera_matrix: K [3, 3], focal lengths and principal point [px].
        rectification: R [3, 3], rotation from the camera to the rectified camera.
        projection: P [3, 4], the rectified camera [px].

    Raises:
        CalibrationError: The values are implausible.
    """

    name: str
    width: int
    height: int
    model: str
    distortion: Floats
    camera_matrix: Floats
    rectification: Floats
    projection: Floats

    def __post_init__(self) -> None:
        """Raise if the values are implausible."""
        self._check_model()
        _check_camera('camera_matrix', self.camera_matrix)
        _check_camera('projection_matrix', self.projection)
        turned = self.rectification @ self.rectification.T - np.eye(3)
        if np.abs(turned).max() > _ROTATION_TOLERANCE or np.linalg.det(self.rectification) < 0.0:
            raise CalibrationError(
                f'rectification_matrix {self.rectification.ravel().tolist()} is not a rotation',
                remedy='give the identity for a single camera',
            )

    def _check_model(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise CalibrationError(
                f'image size {self.width}x{self.height}: give the columns and rows of the camera'
            )
        check_model(self.model)
        if self.distortion.shape != (len(MODELS[self.model]),):
            raise CalibrationError(
                f'distortion_coefficients: {self.distortion.size} given, '
                f'{self.model} has {len(MODELS[self.model])}'
            )
        for field in ('distortion', 'camera_matrix', 'rectification', 'projection'):
            if not np.isfinite(getattr(self, field)).all():
                raise CalibrationError(
                    f'{field} holds a number that is not finite', remedy='recalibrate'
                )

    @property
    def size(self) -> tuple[int, int]:
        """Return columns and rows."""
        return self.width, self.height

    def undistort(self, points: Floats) -> Floats:
        """Return the rectified pixels of raw pixels [n, 2], NaN where there is none."""
        focal, centre = _focal(self.camera_matrix)
        ideal = undistort(self.model, self.distortion, (points - centre) / focal)
        rays = _turned(ideal, self.rectification)
        return rays @ self.projection[:2, :2].T + self.projection[:2, 2]

    def distort(self, points: Floats) -> Floats:
        """Return the raw pixels of rectified pixels [n, 2], NaN where there is none."""
        focal, centre = _focal(self.projection)
        ideal = _turned((points - centre) / focal, self.rectification.T)
        focal, centre = _focal(self.camera_matrix)
        return distort(self.model, self.distortion, ideal) * focal + centre


def _focal(matrix: Floats) -> tuple[Floats, Floats]:
    return np.array([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2]


def _turned(points: Floats, rotation: Floats) -> Floats:
    rays = points @ rotation[:, :2].T + rotation[:, 2]
    with np.errstate(invalid='ignore', divide='ignore'):
        ahead = np.where(rays[:, 2:] > 0.0, rays[:, 2:], np.nan)
        return np.asarray(rays[:, :2] / ahead)


def _check_camera(field: str, matrix: Floats) -> None:
    fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
    if fx <= 0.0 or fy <= 0.0:
        raise CalibrationError(f'{field}: focal lengths {fx:g}, {fy:g} px must be positive')
    if abs(matrix[0, 1]) > _EXACT or abs(matrix[1, 0]) > _EXACT:
        raise CalibrationError(
            f'{field}: skew {matrix[0, 1]:g} is not supported', remedy='recalibrate'
        )
    last = np.zeros(matrix.shape[1])
    last[2] = 1.0
    if np.abs(matrix[2] - last).max() > _EXACT:
        raise CalibrationError(f'{field}: last row {matrix[2].tolist()} must be {last.tolist()}')
