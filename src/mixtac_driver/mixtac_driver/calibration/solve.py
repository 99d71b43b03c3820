# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration from views of a board: fit, rejection of bad views, acceptance, rectification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.calibration.board import MIN_DISTANCE, ViewMeasures, coverage, measure
from mixtac_driver.calibration.fit import LensFit, fit_lens
from mixtac_driver.calibration.lens import (
    EQUIDISTANT,
    MAX_ANGLE_RAD,
    MODELS,
    CalibrationError,
    CameraCalibration,
    Refusal,
    RefusedError,
    fold_radius,
    undistort,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_driver.calibration.board import View


_STEP_PX = 4


@dataclass(frozen=True, slots=True)
class Demands:
    """What views and fit must meet.

    Attributes:
        views: Least number of views.
        distinct_views: Least number of views that differ in place, size or skew.
        coverage: Least share of the image's cells that hold a corner.
        removed: Largest share of views that may be thrown out.
        outlier: A view with this many times the median error is thrown out.
        outlier_px: But none with an error below this [px].
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
    """Refuse views from which no fit can be trusted.

    Raises:
        RefusedError: Too few, too alike, or much of the image is left out.
    """
    if len(views) < demands.views:
        raise RefusedError(
            Refusal.TOO_FEW_VIEWS,
            f'{len(views)} views show the whole board, {demands.views} are needed; show it longer, '
            'or check that --board counts the inner corners',
        )
    distinct = _distinct(views)
    if distinct < demands.distinct_views:
        raise RefusedError(
            Refusal.TOO_ALIKE,
            f'{distinct} of {len(views)} views differ, {demands.distinct_views} are needed; move, '
            'tilt and turn the board',
        )
    share = coverage(list(views))
    if share < demands.coverage:
        raise RefusedError(
            Refusal.POOR_COVERAGE,
            f'corners lie in {100 * share:.0f} % of the image, {100 * demands.coverage:.0f} % is '
            'needed; hold the board towards every edge',
        )


def _distinct(views: Sequence[View]) -> int:
    found: list[ViewMeasures] = []
    for each in map(measure, views):
        if all(each.distance(other) > MIN_DISTANCE / 2.0 for other in found):
            found.append(each)
    return len(found)


def check_fit(fit: LensFit, views: list[View], model: str, demands: Demands) -> None:
    """Refuse a fit that cannot be trusted.

    Args:
        fit: The fit.
        views: The views it explains.
        model: Its model.
        demands: What it must meet.

    Raises:
        RefusedError: Large errors, an open focal length, or a camera that is none.
    """
    rms = float(np.sqrt(np.mean(fit.view_rms_px**2)))
    if rms > demands.rms_px:
        raise RefusedError(
            Refusal.LARGE_RESIDUAL,
            f'{rms:.2f} px, at most {demands.rms_px:g}; check --board, use a flat board, more '
            f'light, or another --model than {model}',
        )
    focal = fit.camera_matrix[[0, 1], [0, 1]]
    uncertain = float((fit.deviations[:2] / focal).max())
    if not 0.0 <= uncertain <= demands.focal_deviation:
        raise RefusedError(
            Refusal.TOO_ALIKE,
            f'the focal length is known to {100 * uncertain:.1f} % only, '
            f'{100 * demands.focal_deviation:g} % is needed; tilt the board more',
        )
    _check_camera(fit, views[0], demands)


def _check_camera(fit: LensFit, view: View, demands: Demands) -> None:
    fx, fy = fit.camera_matrix[[0, 1], [0, 1]]
    if min(fx, fy) <= 0.0 or not 1.0 / (1.0 + demands.aspect) <= fx / fy <= 1.0 + demands.aspect:
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'focal lengths {fx:.1f} and {fy:.1f} px of square pixels; check the board, tilt it '
            'more',
        )
    size = np.array([view.width, view.height])
    centre = fit.camera_matrix[:2, 2]
    if (np.abs(centre - (size - 1) / 2.0) > demands.centre * size).any():
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'optical axis at ({centre[0]:.0f}, {centre[1]:.0f}) of {size[0]}x{size[1]} px; '
            'hold the board towards every edge, and tilt it',
        )


def folded_share(fit: LensFit, view: View, model: str) -> float:
    """Return the share of the image in which the model shows two directions at one pixel."""
    if fold_radius(model, fit.distortion) >= 0.999 * np.tan(MAX_ANGLE_RAD):
        return 0.0
    x, y = np.meshgrid(np.arange(0, view.width, _STEP_PX), np.arange(0, view.height, _STEP_PX))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    focal, centre = fit.camera_matrix[[0, 1], [0, 1]], fit.camera_matrix[:2, 2]
    ideal = undistort(model, fit.distortion, (pixels - centre) / focal)
    return float(np.isnan(ideal[:, 0]).mean())


def check_folded(share: float, model: str, demands: Demands) -> None:
    """Refuse a model that folds back in too much of the image.

    Raises:
        RefusedError: The share is above what is allowed.
    """
    if share > demands.folded:
        raise RefusedError(
            Refusal.IMPLAUSIBLE,
            f'the {model} model folds back in {100 * share:.0f} % of the image, at most '
            f'{100 * demands.folded:g} %; hold the board into every corner, or use --model '
            f'{EQUIDISTANT}',
        )


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


DEFAULT_MODEL = EQUIDISTANT
"""The lens of the sensor sees some 130 degrees; Brown's polynomials need twice the coefficients."""
COEFFICIENT_NAMES = {
    'plumb_bob': ('k1', 'k2', 'p1', 'p2', 'k3'),
    'rational_polynomial': ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6'),
    EQUIDISTANT: ('k1', 'k2', 'k3', 'k4'),
}


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A calibration and what it rests on.

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
        names = ('fx', 'fy', 'cx', 'cy', *COEFFICIENT_NAMES[self.calibration.model])
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
        model: One of `distortion.MODELS`.
        name: Name of the camera.
        alpha: How much of the image rectified images keep, see `rectified_camera`.
        demands: What views and fit must meet; None for the defaults.

    Raises:
        CalibrationError: Unknown model, or views of different image sizes.
        RefusedError: The views or the fit cannot be trusted; `reason` names the demand.
    """
    demands = demands or Demands()
    _check_question(views, model, alpha)
    check_views(views, demands)
    fit, kept, removed = _without_bad_views(list(views), model, demands)
    check_views(kept, demands)
    check_fit(fit, kept, model, demands)
    folded = folded_share(fit, kept[0], model)
    check_folded(folded, model, demands)
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


def check_model(model: str) -> None:
    """Refuse a name that is no lens model.

    Raises:
        CalibrationError: It is none of `distortion.MODELS`.
    """
    if model not in MODELS:
        raise CalibrationError(f'model {model!r} is unknown: use {", ".join(MODELS)}')


def _check_question(views: Sequence[View], model: str, alpha: float) -> None:
    check_model(model)
    if not 0.0 <= alpha <= 1.0:
        raise CalibrationError(f'alpha {alpha}: give a number from 0 to 1')
    sizes = {(view.width, view.height) for view in views}
    if len(sizes) > 1:
        raise CalibrationError(
            f'views have different sizes {sorted(sizes)}: use one camera, full frames'
        )


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
                f'{removed[0][1]:.2f} px); hold the board still and flat',
            )
        fit = fit_lens(kept, model)


def _first_fit(views: list[View], model: str) -> LensFit:
    """Fit all views; where one of them keeps OpenCV from it, all but that one."""
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
