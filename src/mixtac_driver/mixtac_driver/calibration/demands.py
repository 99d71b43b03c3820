# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What views and a fit must meet before a calibration is trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.calibration.distortion import EQUIDISTANT, MAX_ANGLE_RAD, fold_radius, undistort
from mixtac_driver.calibration.errors import Refusal, RefusedError
from mixtac_driver.calibration.view_selection import (
    MIN_DISTANCE,
    ViewMeasures,
    coverage,
    measure,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_driver.calibration.checkerboard import View
    from mixtac_driver.calibration.lens_fit import LensFit

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
