# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""One least-squares fit of a lens to board views, with the uncertainty of what it found."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from mixtac_driver.calibration.lens import EQUIDISTANT, MODELS, Refusal, RefusedError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_driver.calibration.board import View


_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-9)
# OpenCV 4 keeps this flag in its fisheye module, with another value.
_RECOMPUTE = (
    getattr(cv2.fisheye, 'CALIB_RECOMPUTE_EXTRINSIC', None) or cv2.CALIB_RECOMPUTE_EXTRINSIC
)
_FIX_SKEW = getattr(cv2.fisheye, 'CALIB_FIX_SKEW', None) or cv2.CALIB_FIX_SKEW
_FOCAL_AND_CENTRE = 4
_POSE = 6
_RATIONAL = 'rational_polynomial'
_K3, _K6 = 4, 7
_CLEARLY_MORE = 1.03
_STEADIER = 'use more, steadier views'


@dataclass(frozen=True, slots=True, eq=False)
class LensFit:
    """A lens, and how well it explains the views.

    Attributes:
        camera_matrix: K [3, 3] [px].
        distortion: Coefficients of the model [n].
        turns: Rotation vector of the board in each view [views, 3] [rad].
        places: Position of its first corner in each view [views, 3] [m], camera frame.
        residuals: Seen minus fitted corners of each view [corners, 2] [px].
        deviations: Standard deviations of fx, fy, cx, cy [px] and the coefficients [4 + n]; 0 for
            a coefficient that was held at zero.
    """

    camera_matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    turns: NDArray[np.float64]
    places: NDArray[np.float64]
    residuals: list[NDArray[np.float64]]
    deviations: NDArray[np.float64]

    @property
    def view_rms_px(self) -> NDArray[np.float64]:
        """Return the root mean square distance of each view's corners [views] [px]."""
        return np.array([np.sqrt((each**2).sum(axis=1).mean()) for each in self.residuals])


def fit_lens(views: Sequence[View], model: str) -> LensFit:
    """Fit a lens with OpenCV; every view counts alike.

    Args:
        views: Views of one camera.
        model: One of `distortion.MODELS`.

    Raises:
        RefusedError: OpenCV finds no lens (`NO_FIT`).
    """
    try:
        found = _solve(views, model)
    except cv2.error as error:
        raise RefusedError(
            Refusal.NO_FIT,
            f'no {model} lens explains these {len(views)} views ({_cause(error)}); hold the board '
            'flat and tilted in different ways',
        ) from error
    fixed = [_FOCAL_AND_CENTRE + index for index in found.fixed]
    residuals, inner, outer = [], [], []
    for view, turn, place in zip(views, found.turns, found.places, strict=True):
        seen, by_lens, by_pose = project(
            view.board.points(), turn, place, found.matrix, found.coefficients, model
        )
        residuals.append(view.corners - seen)
        inner.append(np.delete(by_lens, fixed, axis=1))
        outer.append(by_pose)
    if not all(np.isfinite(each).all() for each in residuals):
        raise RefusedError(Refusal.NO_FIT, f'the {model} fit ran away; {_STEADIER}')
    deviations = np.zeros(_FOCAL_AND_CENTRE + MODELS[model])
    free = np.delete(np.arange(len(deviations)), fixed)
    try:
        deviations[free] = _deviations(residuals, inner, outer)
    except np.linalg.LinAlgError as error:
        raise RefusedError(Refusal.NO_FIT, f'the {model} fit ran away; {_STEADIER}') from error
    return LensFit(
        found.matrix, found.coefficients, found.turns, found.places, residuals, deviations
    )


def project(
    points: NDArray[np.float64],
    turn: NDArray[np.float64],
    place: NDArray[np.float64],
    matrix: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    model: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return where a lens shows board points, and the derivatives.

    Args:
        points: Board points [n, 3] [m].
        turn: Rotation vector of the board [3] [rad].
        place: Position of the board [3] [m].
        matrix: K [3, 3].
        coefficients: Distortion.
        model: One of `distortion.MODELS`.

    Returns:
        Pixels [n, 2]; derivatives by fx, fy, cx, cy and coefficients [2 n, 4 + k]; derivatives by
        the pose [2 n, 6].
    """
    shaped = points.reshape(-1, 1, 3)
    if model == EQUIDISTANT:
        pixels, jacobian = cv2.fisheye.projectPoints(shaped, turn, place, matrix, coefficients)
        lens = _FOCAL_AND_CENTRE + MODELS[model]
        by_lens, by_pose = jacobian[:, :lens], jacobian[:, lens : lens + _POSE]
    else:
        pixels, jacobian = cv2.projectPoints(shaped, turn, place, matrix, coefficients)
        by_lens, by_pose = jacobian[:, _POSE:], jacobian[:, :_POSE]
    return (
        np.asarray(pixels, np.float64).reshape(-1, 2),
        np.asarray(by_lens, np.float64),
        np.asarray(by_pose, np.float64),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What OpenCV returns: see LensFit; `fixed` are coefficients that were held at zero."""

    rms_px: float
    matrix: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    turns: NDArray[np.float64]
    places: NDArray[np.float64]
    fixed: tuple[int, ...] = ()


def _solve(views: Sequence[View], model: str) -> _Found:
    if model == EQUIDISTANT:
        return _solve_equidistant(views)
    brown = _solve_brown(views, 'plumb_bob', np.zeros((3, 3)), np.zeros(5), 0)
    return brown if model == 'plumb_bob' else _solve_rational(views, brown)


def _solve_rational(views: Sequence[View], start: _Found) -> _Found:
    """Fit six coefficients, or all eight where they explain clearly more.

    All eight at once, from nothing, may end far from the lens, and two that are not needed make
    the model fold back where there are no corners to hold it.
    """
    guess = np.append(start.coefficients, (0.0, 0.0, 0.0))
    eight = _solve_brown(views, _RATIONAL, start.matrix, guess, cv2.CALIB_USE_INTRINSIC_GUESS)
    guess[[_K3, _K6]] = 0.0
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K6
    six = _solve_brown(views, _RATIONAL, start.matrix, guess, flags)
    if not six.rms_px <= _CLEARLY_MORE * eight.rms_px:
        return eight
    return replace(six, fixed=(_K3, _K6))


def _solve_brown(
    views: Sequence[View],
    model: str,
    matrix: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    flags: int,
) -> _Found:
    rms, *found = cv2.calibrateCamera(
        [view.board.points().astype(np.float32) for view in views],
        [view.corners.astype(np.float32) for view in views],
        (views[0].width, views[0].height),
        matrix.copy(),
        coefficients.copy(),
        flags=flags | (cv2.CALIB_RATIONAL_MODEL if model == _RATIONAL else 0),
        criteria=_STOP,
    )
    return _found(rms, found, MODELS[model])


def _solve_equidistant(views: Sequence[View]) -> _Found:
    rms, *found = cv2.fisheye.calibrate(
        [view.board.points()[None] for view in views],
        [view.corners[None] for view in views],
        (views[0].width, views[0].height),
        np.zeros((3, 3)),
        np.zeros((4, 1)),
        flags=_RECOMPUTE | _FIX_SKEW,
        criteria=_STOP,
    )
    return _found(rms, found, MODELS[EQUIDISTANT])


def _found(rms: float, found: Sequence[Any], count: int) -> _Found:
    matrix, coefficients, turns, places = found
    return _Found(
        float(rms),
        np.asarray(matrix, np.float64),
        # OpenCV 5 appends zeros for models that are not asked for.
        np.asarray(coefficients, np.float64).ravel()[:count],
        np.asarray(turns, np.float64).reshape(-1, 3),
        np.asarray(places, np.float64).reshape(-1, 3),
    )


def _deviations(
    residuals: list[NDArray[np.float64]],
    by_lens: list[NDArray[np.float64]],
    by_pose: list[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return standard deviations of the lens with the poses eliminated (Schur complement)."""
    unknowns = by_lens[0].shape[1]
    information = np.zeros((unknowns, unknowns))
    for lens, pose in zip(by_lens, by_pose, strict=True):
        explained = np.linalg.lstsq(pose, lens, rcond=None)[0]
        information += lens.T @ (lens - pose @ explained)
    scale = 1.0 / np.sqrt(np.maximum(information.diagonal(), 1e-30))
    inverse = np.linalg.pinv(
        information * scale[:, None] * scale[None, :], rcond=1e-13, hermitian=True
    )
    errors = np.concatenate([each.ravel() for each in residuals])
    freedom = max(1, len(errors) - unknowns - _POSE * len(residuals))
    variance = float(errors @ errors) / freedom
    return np.asarray(scale * np.sqrt(np.maximum(inverse.diagonal(), 0.0) * variance))


def _cause(error: cv2.error) -> str:
    return ' '.join(str(getattr(error, 'err', '') or error).split())[:120]
