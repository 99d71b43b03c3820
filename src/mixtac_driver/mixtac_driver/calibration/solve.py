# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From board views to a calibration that can be trusted, or a refusal that says why not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixtac_driver.calibration.camera_calibration import CameraCalibration
from mixtac_driver.calibration.demands import (
    Demands,
    check_fit,
    check_folded,
    check_views,
    folded_share,
)
from mixtac_driver.calibration.distortion import EQUIDISTANT, MODELS
from mixtac_driver.calibration.errors import CalibrationError, Refusal, RefusedError
from mixtac_driver.calibration.lens_fit import LensFit, fit_lens
from mixtac_driver.calibration.rectified_camera import rectified_camera
from mixtac_driver.calibration.view_selection import coverage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mixtac_driver.calibration.checkerboard import View

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
