# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration from views of a board: least-squares fit with uncertainty, rejection, acceptance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from mixtac_driver.calibration.board import MIN_DISTANCE, View, ViewMeasures, coverage, measure
from mixtac_driver.calibration.lens import (
    EQUIDISTANT,
    FOCAL_AND_CENTRE,
    MAX_ANGLE_RAD,
    MODELS,
    POSE,
    CalibrationError,
    CameraCalibration,
    Refusal,
    RefusedError,
    check_model,
    fold_radius,
    project,
    undistort,
)
from mixtac_events.arrays import Floats

_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-9)
# OpenCV 4 keeps this flag in its fisheye module, with another value.
_RECOMPUTE = (
    getattr(cv2.fisheye, 'CALIB_RECOMPUTE_EXTRINSIC', None) or cv2.CALIB_RECOMPUTE_EXTRINSIC
)
_FIX_SKEW = getattr(cv2.fisheye, 'CALIB_FIX_SKEW', None) or cv2.CALIB_FIX_SKEW
_RATIONAL = 'rational_polynomial'
_K3, _K6 = 4, 7
_CLEARLY_MORE = 1.03
_STEADIER = 'use more, steadier views'


@dataclass(frozen=True, slots=True, eq=False)
class LensFit:
    """A lens, and how well it fits the views.

    Attributes:
        camera_matrix: K [3, 3] [px].
        distortion: Coefficients of the model [n].
        turns: Rotation vector of the board in each view [views, 3] [rad].
        places: Position of its first corner in each view [views, 3] [m], camera frame.
        residuals: Seen minus fitted corners of each view [corners, 2] [px].
        deviations: Standard deviations of fx, fy, cx, cy [px] and the coefficients [4 + n]; 0 for
            a coefficient that was held at zero.
    """

    camera_matrix: Floats
    distortion: Floats
    turns: Floats
    places: Floats
    residuals: list[Floats]
    deviations: Floats

    @property
    def view_rms_px(self) -> Floats:
        """Return the root mean square distance of each view's corners [views] [px]."""
        return np.array([np.sqrt((each**2).sum(axis=1).mean()) for each in self.residuals])


def fit_lens(views: Sequence[View], model: str) -> LensFit:
    """Fit a lens with OpenCV; all views have the same weight.

    Args:
        views: Views of one camera.
        model: One of `lens.MODELS`.

    Raises:
        RefusedError: OpenCV finds no lens (`NO_FIT`).
    """
    try:
        (matrix, distortion, turns, places), held = _solve(views, model)
    except cv2.error as error:
        cause = ' '.join(str(getattr(error, 'err', '') or error).split())[:120]
        raise RefusedError(
            Refusal.NO_FIT,
            f'no {model} lens fits these {len(views)} views ({cause})',
            'hold the board flat, and tilt it in different ways',
        ) from error
    fixed = [FOCAL_AND_CENTRE + index for index in held]
    residuals, inner, outer = [], [], []
    for view, turn, place in zip(views, turns, places, strict=True):
        points = view.board.points()
        seen, by_lens, by_pose = project(points, turn, place, matrix, distortion, model)
        residuals.append(view.corners - seen)
        inner.append(np.delete(by_lens, fixed, axis=1))
        outer.append(by_pose)
    if not all(np.isfinite(each).all() for each in residuals):
        raise RefusedError(Refusal.NO_FIT, f'the {model} fit diverged', _STEADIER)
    deviations = np.zeros(FOCAL_AND_CENTRE + len(MODELS[model]))
    free = np.delete(np.arange(len(deviations)), fixed)
    try:
        deviations[free] = _deviations(residuals, inner, outer)
    except np.linalg.LinAlgError as error:
        raise RefusedError(Refusal.NO_FIT, f'the {model} fit diverged', _STEADIER) from error
    return LensFit(matrix, distortion, turns, places, residuals, deviations)


_Lens = tuple[Floats, Floats, Floats, Floats]
"""Camera matrix, distortion, turns and places, as in `LensFit`."""


def _solve(views: Sequence[View], model: str) -> tuple[_Lens, tuple[int, ...]]:
    """Return the lens, and the coefficients that were held at zero."""
    if model == EQUIDISTANT:
        _, *found = cv2.fisheye.calibrate(
            [view.board.points()[None] for view in views],
            [view.corners[None] for view in views],
            (views[0].width, views[0].height),
            np.zeros((3, 3)),
            np.zeros((4, 1)),
            flags=_RECOMPUTE | _FIX_SKEW,
            criteria=_STOP,
        )
        return _arrays(found, model), ()
    _, brown = _solve_brown(views, 'plumb_bob', np.zeros((3, 3)), np.zeros(5), 0)
    if model == 'plumb_bob':
        return brown, ()
    # Six coefficients, or all eight if they fit clearly better. All eight at once, from nothing,
    # may end far from the lens, and two that are not needed make the model fold back where there
    # are no corners to hold it.
    matrix, guess = brown[0], np.append(brown[1], (0.0, 0.0, 0.0))
    flags = cv2.CALIB_USE_INTRINSIC_GUESS
    rms_eight, eight = _solve_brown(views, model, matrix, guess, flags)
    guess[[_K3, _K6]] = 0.0
    flags |= cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K6
    rms_six, six = _solve_brown(views, model, matrix, guess, flags)
    return (six, (_K3, _K6)) if rms_six <= _CLEARLY_MORE * rms_eight else (eight, ())


def _solve_brown(
    views: Sequence[View], model: str, matrix: Floats, coefficients: Floats, flags: int
) -> tuple[float, _Lens]:
    rms, *found = cv2.calibrateCamera(
        [view.board.points().astype(np.float32) for view in views],
        [view.corners.astype(np.float32) for view in views],
        (views[0].width, views[0].height),
        matrix.copy(),
        coefficients.copy(),
        flags=flags | (cv2.CALIB_RATIONAL_MODEL if model == _RATIONAL else 0),
        criteria=_STOP,
    )
    return float(rms), _arrays(found, model)


def _arrays(found: Sequence[Any], model: str) -> _Lens:
    matrix, coefficients, turns, places = (np.asarray(each, np.float64) for each in found)
    # OpenCV 5 appends zeros for models that were not requested.
    coefficients = coefficients.ravel()[: len(MODELS[model])]
    return matrix, coefficients, turns.reshape(-1, 3), places.reshape(-1, 3)


def _deviations(residuals: list[Floats], by_lens: list[Floats], by_pose: list[Floats]) -> Floats:
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
    freedom = max(1, len(errors) - unknowns - POSE * len(residuals))
    variance = float(errors @ errors) / freedom
    return np.asarray(scale * np.sqrt(np.maximum(inverse.diagonal(), 0.0) * variance))


_STEP_PX = 4


@dataclass(frozen=True, slots=True)
class Demands:
    """Demands on views and fit.

    Attributes:
        views: Least number of views.
        distinct_views: Least number of views that differ in place, size or skew.
        coverage: Least share of the image's cells that hold a corner.
        removed: Largest share of views that may be rejected.
        outlier: A view with this many times the median error is rejected.
        outlier_px: Views with an error below this are never rejected [px].
        rms_px: Largest reprojection error over all corners [px].
        focal_deviation: Largest standard deviation of a focal length, relative.
        aspect: Largest ratio of the focal lengths, minus one; the pixels are square.
        centre: Largest distance of the principal point from the middle, of the image's size.
        folded: Largest share of the image in which the model folds back.
    """

    views: int = 8
    distinct_views: int = 6
    coverage: float = 0.5
    removed: float = 0.34
    outlier: float = 2.5
    outlier_px: float = 0.25
    rms_px: float = 1.0
    focal_deviation: float = 0.01
    aspect: float = 0.1
    centre: float = 0.2
    folded: float = 0.1


def check_views(views: Sequence[View], demands: Demands) -> None:
    """Raise unless views can give a trustworthy fit.

    Raises:
        RefusedError: Too few, too similar, or much of the image is not covered.
    """
    if len(views) < demands.views:
        raise RefusedError(
            Refusal.TOO_FEW_VIEWS,
            f'{len(views)} views show the whole board, {demands.views} are needed',
            'show it longer, or check that --board counts the inner corners',
        )
    distinct: list[ViewMeasures] = []
    for each in map(measure, views):
        if all(each.distance(other) > MIN_DISTANCE / 2.0 for other in distinct):
            distinct.append(each)
    if len(distinct) < demands.distinct_views:
        raise RefusedError(
            Refusal.TOO_ALIKE,
            f'{len(distinct)} of {len(views)} views differ, {demands.distinct_views} are needed',
            'move, tilt and turn the board',
        )
    share = coverage(list(views))
    if share < demands.coverage:
        raise RefusedError(
            Refusal.POOR_COVERAGE,
            f'corners cover {100 * share:.0f} % of the image, {100 * demands.coverage:.0f} % is '
            'needed',
            'hold the board towards every edge',
        )


def check_fit(fit: LensFit, views: list[View], model: str, demands: Demands) -> None:
    """Raise unless a fit can be trusted.

    Args:
        fit: The fit.
        views: The fitted views.
        model: Its lens model.
        demands: The demands.

    Raises:
        RefusedError: Large errors, an uncertain focal length, or an implausible camera.
    """
    rms = float(np.sqrt(np.mean(fit.view_rms_px**2)))
    if rms > demands.rms_px:
        raise RefusedError(
            Refusal.LARGE_RESIDUAL,
            f'{rms:.2f} px, at most {demands.rms_px:g} px is allowed',
            f'check --board, use a flat board, more light, or another --model than {model}',
        )
    focal = fit.camera_matrix[[0, 1], [0, 1]]
    uncertain = float((fit.deviations[:2] / focal).max())
    if not 0.0 <= uncertain <= demands.focal_deviation:
        raise RefusedError(
            Refusal.TOO_ALIKE,
            f'the focal length is only known to {100 * uncertain:.1f} %, '
            f'{100 * demands.focal_deviation:g} % is needed',
            'tilt the board more',
        )
    fx, fy = focal
    if min(fx, fy) <= 0.0 or not 1.0 / (1.0 + demands.aspect) <= fx / fy <= 1.0 + demands.aspect:
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'focal lengths {fx:.1f} and {fy:.1f} px of square pixels',
            'check the board, and tilt it more',
        )
    size = np.array([views[0].width, views[0].height])
    centre = fit.camera_matrix[:2, 2]
    if (np.abs(centre - (size - 1) / 2.0) > demands.centre * size).any():
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'optical axis at ({centre[0]:.0f}, {centre[1]:.0f}) of {size[0]}x{size[1]} px',
            'hold the board towards every edge, and tilt it',
        )


def _folded_share(fit: LensFit, view: View, model: str, demands: Demands) -> float:
    """Return the share of the image in which the model shows two directions at one pixel.

    Raises:
        RefusedError: It is too large.
    """
    if fold_radius(model, fit.distortion) >= 0.999 * np.tan(MAX_ANGLE_RAD):
        return 0.0
    x, y = np.meshgrid(np.arange(0, view.width, _STEP_PX), np.arange(0, view.height, _STEP_PX))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    focal, centre = fit.camera_matrix[[0, 1], [0, 1]], fit.camera_matrix[:2, 2]
    ideal = undistort(model, fit.distortion, (pixels - centre) / focal)
    share = float(np.isnan(ideal[:, 0]).mean())
    if share > demands.folded:
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'the {model} model folds back in {100 * share:.0f} % of the image, at most '
            f'{100 * demands.folded:g} % is allowed',
            f'hold the board into every corner, or use --model {EQUIDISTANT}',
        )
    return share


def rectified_camera(
    model: str,
    coefficients: Floats,
    camera_matrix: Floats,
    size: tuple[int, int],
    alpha: float = 0.0,
) -> Floats:
    """Return a projection matrix P with square pixels.

    Args:
        model: One of `lens.MODELS`.
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
    pixels = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float64) for n in size)), axis=-1)
    left, right, top, bottom = (
        undistort(model, coefficients, (edge - centre) / focal)
        for edge in (pixels[:, 0], pixels[:, -1], pixels[0], pixels[-1])
    )
    if any(np.isnan(each).all() for each in (left, right, top, bottom)):
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'the {model} model folds back along an edge of the image',
            f'use --model {EQUIDISTANT}',
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


DEFAULT_MODEL = EQUIDISTANT
"""The lens of the sensor sees some 130 degrees; Brown's polynomials need twice the coefficients."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A calibration and its evidence.

    Attributes:
        calibration: The calibration.
        fit: The fit to the views that were kept.
        views: Those views.
        removed: Views thrown out, with their error before they were [px].
        coverage: Share of the image's cells that hold a corner of a kept view.
        folded: Share of the image that has no rectified place, because the model folds back there.
    """

    calibration: CameraCalibration
    fit: LensFit
    views: list[View]
    removed: list[tuple[View, float]]
    coverage: float
    folded: float

    @property
    def rms_px(self) -> float:
        """Return the root mean square distance of seen from fitted corners [px]."""
        squares = np.concatenate([(each**2).sum(axis=1) for each in self.fit.residuals])
        return float(np.sqrt(squares.mean()))

    @property
    def max_px(self) -> float:
        """Return the largest distance of a seen from a fitted corner [px]."""
        return max(float(np.hypot(*each.T).max()) for each in self.fit.residuals)

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard deviation by name: fx, fy, cx, cy [px], coefficients."""
        k = self.fit.camera_matrix
        values = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *self.fit.distortion]
        names = ('fx', 'fy', 'cx', 'cy', *MODELS[self.calibration.model])
        pairs = zip(values, self.fit.deviations, strict=True)
        return {name: (float(v), float(s)) for name, (v, s) in zip(names, pairs, strict=True)}


def calibrate(
    views: Sequence[View],
    *,
    model: str = DEFAULT_MODEL,
    name: str = 'davis346',
    alpha: float = 0.0,
    demands: Demands | None = None,
) -> Solution:
    """Return the calibration of the camera that saw a board.

    Args:
        views: Views of one board by one camera.
        model: One of `lens.MODELS`.
        name: Name of the camera.
        alpha: How much of the image rectified images keep, see `rectified_camera`.
        demands: Demands on views and fit; None for the defaults.

    Raises:
        CalibrationError: Unknown model, or views of different image sizes.
        RefusedError: The views or the fit cannot be trusted; `reason` names the demand.
    """
    demands = demands or Demands()
    check_model(model)
    if not 0.0 <= alpha <= 1.0:
        raise CalibrationError(f'alpha {alpha}: give a number from 0 to 1')
    sizes = {(view.width, view.height) for view in views}
    if len(sizes) > 1:
        raise CalibrationError(
            f'views have different sizes {sorted(sizes)}', remedy='use one camera and full frames'
        )
    check_views(views, demands)
    fit, kept, removed = _without_bad_views(list(views), model, demands)
    check_views(kept, demands)
    check_fit(fit, kept, model, demands)
    folded = _folded_share(fit, kept[0], model, demands)
    size = (kept[0].width, kept[0].height)
    calibration = CameraCalibration(
        name=name,
        width=size[0],
        height=size[1],
        model=model,
        distortion=fit.distortion,
        camera_matrix=fit.camera_matrix,
        rectification=np.eye(3),
        projection=rectified_camera(model, fit.distortion, fit.camera_matrix, size, alpha),
    )
    return Solution(calibration, fit, kept, removed, coverage(kept), folded)


def _without_bad_views(
    views: list[View], model: str, demands: Demands
) -> tuple[LensFit, list[View], list[tuple[View, float]]]:
    kept = list(views)
    removed: list[tuple[View, float]] = []
    fit = _first_fit(kept, model)
    while True:
        errors = fit.view_rms_px
        worst = int(np.argmax(errors))
        limit = max(demands.outlier * float(np.median(errors)), demands.outlier_px)
        if errors[worst] <= limit:
            return fit, kept, removed
        removed.append((kept.pop(worst), float(errors[worst])))
        if len(removed) > demands.removed * len(views) or len(kept) < demands.views:
            raise RefusedError(
                Refusal.LARGE_RESIDUAL,
                f'more than {len(removed) - 1} of {len(views)} views contradict the others (worst '
                f'{removed[0][1]:.2f} px)',
                'hold the board still and flat',
            )
        fit = fit_lens(kept, model)


def _first_fit(views: list[View], model: str) -> LensFit:
    """Fit all views, or all but one where that one makes OpenCV fail."""
    try:
        return fit_lens(views, model)
    except RefusedError as error:
        failure = error
    for index in range(len(views)):
        try:
            fit_lens([view for i, view in enumerate(views) if i != index], model)
        except RefusedError:
            continue
        views.pop(index)
        return fit_lens(views, model)
    raise failure
