# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lens calibration from views of a checkerboard: detection, choice of views, fit, checks.

OpenCV finds the corners and fits the lens. This module selects the views for the fit, rejects views
that contradict the others, and checks whether the result can be trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Floats
from mixtac_driver.camera_info import (
    EQUIDISTANT,
    MODELS,
    RATIONAL,
    CalibrationError,
    CameraCalibration,
    check_model,
)

Grey = NDArray[np.uint8 | np.uint16]


class RefusedError(CalibrationError):
    """Views that give no trustworthy calibration.

    Args:
        reason: The demand that is not met.
        found: The value found.
        remedy: What the user can do about it.

    Attributes:
        reason: As given.
    """

    def __init__(self, reason: str, found: str, remedy: str) -> None:
        super().__init__(f'{reason}: {found}', remedy=remedy)
        self.reason = reason


MIN_INNER_CORNERS = 3
"""Least number of inner corners along a side of a board."""
MIN_CONTRAST = 8.0
"""Least difference of dark and bright grey levels in a frame with a board."""
REFINE = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
SB_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
QUAD_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
WINDOW_SHARE = 0.42
"""Half-width of the search window of a corner, as a share of the corner spacing."""
MAX_WINDOW_PX = 7
"""Largest half-width of the search window of a corner [px]."""


@dataclass(frozen=True, slots=True)
class Board:
    """A flat checkerboard.

    Attributes:
        columns: Inner corners along a row, one less than squares.
        rows: Inner corners along a column.
        square_m: Side of a square [m].

    Raises:
        CalibrationError: Fewer than 3 x 3 corners, or a size that is not positive.
    """

    columns: int
    rows: int
    square_m: float

    def __post_init__(self) -> None:
        """Raise if this is not a board."""
        if min(self.columns, self.rows) < MIN_INNER_CORNERS:
            raise CalibrationError(
                f'board {self.columns}x{self.rows}: count the inner corners, at least 3x3'
            )
        if not 0.0 < self.square_m < float('inf'):
            raise CalibrationError(f'square {self.square_m} m: measure the side of one square')

    @classmethod
    def parse(cls, text: str, square_m: float) -> Board:
        """Return the board that, for example, `9x6` names.

        Raises:
            CalibrationError: The text does not describe a board.
        """
        columns, cross, rows = text.lower().partition('x')
        if not (cross and columns.isdecimal() and rows.isdecimal()):
            raise CalibrationError(f'board {text!r}: give inner corners as COLUMNSxROWS, as in 9x6')
        return cls(int(columns), int(rows), square_m)

    def points(self) -> Floats:
        """Return the corners on the board [columns * rows, 3] [m], row by row, z = 0."""
        rows, columns = np.mgrid[0 : self.rows, 0 : self.columns].astype(np.float64)
        flat = np.stack([columns, rows, np.zeros_like(rows)], axis=-1) * self.square_m
        return np.asarray(flat.reshape(-1, 3))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A board in one frame.

    Attributes:
        board: The board.
        corners: `float64` [columns * rows, 2], column and row [px], row by row along the board.
        width: Columns of the frame.
        height: Rows of the frame.
        label: Origin of the view, for messages.
    """

    board: Board
    corners: Floats
    width: int
    height: int
    label: str = ''


def find_board(image: Grey, board: Board, label: str = '') -> View | None:
    """Return the board in a frame, or None if it is incomplete or unclear.

    Args:
        image: `uint8` or `uint16` [height, width], grey.
        board: The board to find.
        label: Origin of the frame.
    """
    grey = stretched(image)
    if grey is None:
        return None
    size = (board.columns, board.rows)
    for scale in (1, 2):
        larger = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        found, seen = cv2.findChessboardCorners(larger, size, flags=QUAD_FLAGS)
        if not found and scale == 1:
            found, seen = cv2.findChessboardCornersSB(larger, size, flags=SB_FLAGS)
        if found:
            # Pixel centres are whole numbers at every scale.
            corners = (np.asarray(seen, np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
            rows, columns = grey.shape
            return View(board, _refined(grey, corners, board), columns, rows, label)
    return None


def stretched(image: Grey) -> NDArray[np.uint8] | None:
    """Return a frame with its contrast stretched to 8 bits, or None if it has none."""
    # Noise and hot pixels lie outside of these percentiles.
    dark, bright = np.percentile(image, (0.5, 99.5))
    if bright - dark < MIN_CONTRAST:
        return None
    spread = np.clip((image.astype(np.float32) - dark) * (255.0 / (bright - dark)), 0.0, 255.0)
    return np.asarray(spread, np.uint8)


def _refined(grey: NDArray[np.uint8], corners: Floats, board: Board) -> Floats:
    """Return corners at the saddle points of the image."""
    grid = corners.reshape(board.rows, board.columns, 2)
    spacing = min(np.linalg.norm(np.diff(grid, axis=k), axis=2).min() for k in (0, 1))
    # A window that reaches the next corner is drawn towards it.
    window = int(np.clip(WINDOW_SHARE * spacing, 2, MAX_WINDOW_PX))
    start = corners.astype(np.float32).reshape(-1, 1, 2).copy()
    cv2.cornerSubPix(grey, start, (window, window), (-1, -1), REFINE)
    return np.asarray(start.reshape(-1, 2), np.float64)


CELL_COLUMNS = 8
"""Columns of the grid on which coverage is counted."""
CELL_ROWS = 6
"""Rows of the grid on which coverage is counted."""
WANTED_COVERAGE = 0.75
"""Share of the cells with a corner that counts as complete."""
WANTED_VIEWS = 20
"""Views that count as complete."""
MAX_VIEWS = 60
"""More views make the fit slow and add nothing."""
LEAST_MOVE_PX = 15.0
"""Least mean distance between the corners of two views that are kept [px]."""


def coverage(views: Sequence[View]) -> float:
    """Return the share of the cells of the image that hold a corner, 0 .. 1."""
    filled = np.zeros((CELL_ROWS, CELL_COLUMNS), np.bool_)
    for view in views:
        cells = view.corners * (CELL_COLUMNS / view.width, CELL_ROWS / view.height)
        cells = np.floor(cells).astype(np.int64).clip(0, (CELL_COLUMNS - 1, CELL_ROWS - 1))
        filled[cells[:, 1], cells[:, 0]] = True
    return float(filled.mean())


class ViewSelection:
    """Keeps the views that add information to the fit.

    Attributes:
        views: Views kept, in order of arrival.
    """

    def __init__(self) -> None:
        self.views: list[View] = []

    def offer(self, view: View) -> bool:
        """Keep a view if it shows the board at another place or pose; return whether it is kept."""
        moves_px = [
            np.linalg.norm(view.corners - each.corners, axis=1).mean() for each in self.views
        ]
        adds = coverage([*self.views, view]) > coverage(self.views)
        if len(self.views) >= MAX_VIEWS or not (
            adds or min(moves_px, default=np.inf) > LEAST_MOVE_PX
        ):
            return False
        self.views.append(view)
        return True

    def progress(self) -> dict[str, float]:
        """Return to what degree each demand is met, 0 .. 1, by name."""
        return {
            'coverage': min(1.0, coverage(self.views) / WANTED_COVERAGE),
            'views': min(1.0, len(self.views) / WANTED_VIEWS),
        }

    @property
    def complete(self) -> bool:
        """Whether more views would hardly improve a fit."""
        return len(self.views) >= MAX_VIEWS or min(self.progress().values()) >= 1.0


LEAST_VIEWS = 8
LEAST_COVERAGE = 0.5
OUTLIER = 2.5
"""A view with this many times the median error is rejected."""
OUTLIER_PX = 0.25
"""A view with an error below this is never rejected [px]."""
MOST_RMS_PX = 1.0
"""Largest reprojection error over all corners [px]."""
MOST_FOCAL_DEVIATION = 0.01
"""Largest standard deviation of a focal length, relative."""
STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A calibration and its evidence.

    Attributes:
        calibration: The calibration.
        deviations: Standard deviations of fx, fy, cx, cy [px] and the coefficients.
        view_rms_px: Root mean square distance of seen and fitted corners of each view [px].
        views: Views that were fitted.
        removed: Views that were rejected, each with its error [px].
    """

    calibration: CameraCalibration
    deviations: Floats
    view_rms_px: Floats
    views: list[View]
    removed: list[tuple[View, float]]

    @property
    def rms_px(self) -> float:
        """Root mean square distance of seen and fitted corners [px]."""
        return float(np.sqrt(np.mean(self.view_rms_px**2)))

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard deviation by name: fx, fy, cx, cy [px], coefficients."""
        k = self.calibration.camera_matrix
        values = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *self.calibration.distortion]
        names = ('fx', 'fy', 'cx', 'cy', *MODELS[self.calibration.model])
        pairs = zip(values, self.deviations, strict=True)
        return {name: (float(v), float(s)) for name, (v, s) in zip(names, pairs, strict=True)}


def calibrate(
    views: Sequence[View], *, model: str = EQUIDISTANT, name: str = 'davis346'
) -> Solution:
    """Return the calibration of the camera that saw a board.

    Args:
        views: Views of one board by one camera.
        model: One of `camera_info.MODELS`.
        name: Name of the camera.

    Raises:
        CalibrationError: Unknown model.
        RefusedError: The views or the fit cannot be trusted; `reason` names the demand.
    """
    check_model(model)
    kept, removed = list(views), list[tuple[View, float]]()
    _check_views(kept)
    while True:
        matrix, distortion, deviations, errors = fit_lens(kept, model)
        worst = int(np.argmax(errors))
        if errors[worst] <= max(OUTLIER * float(np.median(errors)), OUTLIER_PX):
            break
        removed.append((kept.pop(worst), float(errors[worst])))
        _check_views(kept)
    _check_fit(matrix, deviations, errors, model)
    size = (kept[0].width, kept[0].height)
    projection = _projection(model, matrix, distortion, size)
    lens = CameraCalibration(name, *size, model, distortion, matrix, np.eye(3), projection)
    return Solution(lens, deviations, errors, kept, removed)


def _check_views(views: Sequence[View]) -> None:
    if len(views) < LEAST_VIEWS:
        raise RefusedError(
            'too few views',
            f'{len(views)} views show the whole board and agree, {LEAST_VIEWS} are needed',
            'show it longer and at other places, and check that --board counts the inner corners',
        )
    share = coverage(views)
    if share < LEAST_COVERAGE:
        raise RefusedError(
            'views do not cover the image',
            f'corners cover {share:.0%} of the image, {LEAST_COVERAGE:.0%} is needed',
            'hold the board towards every edge',
        )


def _check_fit(matrix: Floats, deviations: Floats, errors: Floats, model: str) -> None:
    rms = float(np.sqrt(np.mean(errors**2)))
    if rms > MOST_RMS_PX:
        raise RefusedError(
            'large reprojection error',
            f'{rms:.2f} px, at most {MOST_RMS_PX:g} px is allowed',
            f'check --board, use a flat board, more light, or another --model than {model}',
        )
    uncertain = float((deviations[:2] / matrix[[0, 1], [0, 1]]).max())
    if not 0.0 <= uncertain <= MOST_FOCAL_DEVIATION:
        raise RefusedError(
            'uncertain focal length',
            f'its relative deviation is {uncertain:.1%}, {MOST_FOCAL_DEVIATION:.0%} is allowed',
            'tilt the board more',
        )


def fit_lens(views: Sequence[View], model: str) -> tuple[Floats, Floats, Floats, Floats]:
    """Fit a lens with OpenCV.

    Args:
        views: Views of one camera.
        model: One of `camera_info.MODELS`.

    Returns:
        K [3, 3] [px]; the coefficients [n]; standard deviations of fx, fy, cx, cy and the
        coefficients [4 + n]; the root mean square error of each view [px].

    Raises:
        RefusedError: OpenCV finds no lens ('no fit').
    """
    size = (views[0].width, views[0].height)
    try:
        found = (
            _fit_fisheye(views, size) if model == EQUIDISTANT else _fit_brown(views, size, model)
        )
    except cv2.error as error:
        raise RefusedError(
            'no fit',
            f'no {model} lens fits these {len(views)} views',
            'hold the board flat, and tilt it in different ways',
        ) from error
    if not all(np.isfinite(each).all() for each in found):
        raise RefusedError('no fit', f'the {model} fit diverged', 'use more, steadier views')
    return found


def _fit_brown(
    views: Sequence[View], size: tuple[int, int], model: str
) -> tuple[Floats, Floats, Floats, Floats]:
    count = len(MODELS[model])
    found: Any = cv2.calibrateCameraExtended(
        [view.board.points().astype(np.float32) for view in views],
        [view.corners.astype(np.float32) for view in views],
        size,
        np.zeros((3, 3)),
        np.zeros(count),
        flags=cv2.CALIB_RATIONAL_MODEL if model == RATIONAL else 0,
        criteria=STOP,
    )
    _, matrix, distortion, _, _, deviations, _, errors = found
    # OpenCV appends zeros for models that were not requested.
    return matrix, distortion.ravel()[:count], deviations.ravel()[: 4 + count], errors.ravel()


def _fit_fisheye(
    views: Sequence[View], size: tuple[int, int]
) -> tuple[Floats, Floats, Floats, Floats]:
    # OpenCV 4 keeps these flags in its fisheye module, with other values.
    recompute = getattr(cv2.fisheye, 'CALIB_RECOMPUTE_EXTRINSIC', cv2.CALIB_RECOMPUTE_EXTRINSIC)
    fix_skew = getattr(cv2.fisheye, 'CALIB_FIX_SKEW', cv2.CALIB_FIX_SKEW)
    found: Any = cv2.fisheye.calibrate(
        [view.board.points()[None] for view in views],
        [view.corners[None] for view in views],
        size,
        np.zeros((3, 3)),
        np.zeros((4, 1)),
        flags=recompute | fix_skew,
        criteria=STOP,
    )
    _, matrix, distortion, turns, places = found
    # cv2.fisheye reports no deviations: those of the lens with the poses eliminated (Schur).
    information, residuals = np.zeros((8, 8)), []
    for view, turn, place in zip(views, turns, places, strict=True):
        seen, jacobian = cv2.fisheye.projectPoints(
            view.board.points()[None], turn, place, matrix, distortion
        )
        residuals.append(view.corners - seen.reshape(-1, 2))
        lens, pose = jacobian[:, :8], jacobian[:, 8:14]
        explained = np.linalg.lstsq(pose, lens, rcond=None)[0]
        information += lens.T @ (lens - pose @ explained)
    errors = np.concatenate([each.ravel() for each in residuals])
    variance = errors @ errors / max(1, len(errors) - 8 - 6 * len(views))
    deviations = np.sqrt(variance * np.linalg.pinv(information, hermitian=True).diagonal().clip(0))
    rms = np.array([np.sqrt((each**2).sum(axis=1).mean()) for each in residuals])
    return matrix, distortion.ravel(), deviations, rms


def _projection(model: str, matrix: Floats, distortion: Floats, size: tuple[int, int]) -> Floats:
    """Return P [3, 4] of the rectified camera, cropped to pixels that the camera sees."""
    if model == EQUIDISTANT:
        new = cv2.fisheye.estimateNewCameraMatrixForUndistortRectify(
            matrix, distortion, size, np.eye(3), balance=0.0
        )
    else:
        new = cv2.getOptimalNewCameraMatrix(matrix, distortion, size, 0.0)[0]
    return np.hstack([new, np.zeros((3, 1))])
