# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checkerboard corners in images, and the selection of views for a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mixtac_driver.calibration.lens import CalibrationError
from mixtac_events.arrays import Floats

MIN_INNER_CORNERS = 3
MIN_SPACING_PX = 4.0
"""Closer corners blur into each other."""
DARK_QUANTILE, BRIGHT_QUANTILE = 0.5, 99.5
"""Percentiles [%]; noise and hot pixels lie outside."""
_MIN_CONTRAST = 8.0
_SB_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
_QUAD_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SEARCHES: tuple[tuple[int, Any, int], ...] = (
    (1, cv2.findChessboardCorners, _QUAD_FLAGS),
    (1, cv2.findChessboardCornersSB, _SB_FLAGS),
    (2, cv2.findChessboardCorners, _QUAD_FLAGS),
    (2, cv2.findChessboardCornersSB, _SB_FLAGS),
)
"""Enlargement, function and flags; the last one only in a thorough search."""
_REFINE = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
_WINDOW_SHARE = 0.42
_MAX_WINDOW = 7
_MAX_BEND = 0.6


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
        edge_px: Width of the edges from 10 % to 90 % [px]; motion and defocus widen them.
        label: Where the view is from, for messages.
    """

    board: Board
    corners: Floats
    width: int
    height: int
    edge_px: float
    label: str = ''

    def grid(self) -> Floats:
        """Return the corners as [rows, columns, 2]."""
        return self.corners.reshape(self.board.rows, self.board.columns, 2)


def find_board(
    image: NDArray[np.uint8 | np.uint16], board: Board, label: str = '', *, thorough: bool = False
) -> View | None:
    """Return the board in a frame, or None if it is incomplete or unclear.

    Args:
        image: `uint8` or `uint16` [height, width], grey.
        board: The board to find.
        label: Where the frame is from.
        thorough: Search the enlarged frame once more, for small squares; takes several times as
            long where there is no board.
    """
    grey = stretched(image)
    if grey is None:
        return None
    for scale, find, flags in _SEARCHES if thorough else _SEARCHES[:-1]:
        # At scale 1 this is a copy.
        larger = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        found, seen = find(larger, (board.columns, board.rows), flags=flags)
        if not found:
            continue
        corners = np.asarray(seen, np.float64).reshape(-1, 2)
        # Pixel centres are whole numbers at every scale.
        refined = _refined(grey, (corners + 0.5) / scale - 0.5, board)
        if refined is not None:
            height, width = image.shape
            edge_px = _edge_px(grey, refined, board)
            return View(board, refined, width, height, edge_px, label)
    return None


def stretched(image: NDArray[np.uint8 | np.uint16]) -> NDArray[np.uint8] | None:
    """Return a frame with its contrast stretched to 8 bits, or None if it has none."""
    dark, bright = np.percentile(image, (DARK_QUANTILE, BRIGHT_QUANTILE))
    if bright - dark < _MIN_CONTRAST:
        return None
    scale = 255.0 / (bright - dark)
    spread = np.clip((image.astype(np.float32) - dark) * scale, 0.0, 255.0)
    return np.asarray(spread, np.uint8)


def _refined(grey: NDArray[np.uint8], corners: Floats, board: Board) -> Floats | None:
    """Return corners at the saddle points, or None if they do not form a board."""
    spacing = _spacing(corners, board)
    if spacing < MIN_SPACING_PX:
        return None
    # A window that reaches the next corner is drawn towards it.
    window = int(np.clip(_WINDOW_SHARE * spacing, 2, _MAX_WINDOW))
    start = corners.astype(np.float32).reshape(-1, 1, 2).copy()
    cv2.cornerSubPix(grey, start, (window, window), (-1, -1), _REFINE)
    refined = start.reshape(-1, 2).astype(np.float64)
    return refined if _is_board(refined, board, grey.shape) else None


def _spacing(corners: Floats, board: Board) -> float:
    """Return the distance of the closest neighbours [px]."""
    grid = corners.reshape(board.rows, board.columns, 2)
    return float(min(np.linalg.norm(np.diff(grid, axis=k), axis=2).min() for k in (0, 1)))


def _is_board(corners: Floats, board: Board, shape: tuple[int, ...]) -> bool:
    """Return whether corners lie in the image, on a grid no more bent than lenses bend it."""
    height, width = shape
    if not np.isfinite(corners).all() or corners.min() < 0.0:
        return False
    if (corners >= (width, height)).any() or _spacing(corners, board) < MIN_SPACING_PX:
        return False
    grid = corners.reshape(board.rows, board.columns, 2)
    for axis in (0, 1):
        step = np.diff(grid, axis=axis)
        length = np.linalg.norm(step, axis=2)
        lengths = np.moveaxis(length, axis, 0)
        shorter = np.moveaxis(np.minimum(lengths[1:], lengths[:-1]), 0, axis)
        if (np.linalg.norm(np.diff(step, axis=axis), axis=2) > _MAX_BEND * shorter).any():
            return False
    return True


def _edge_px(grey: NDArray[np.uint8], corners: Floats, board: Board) -> float:
    start = corners.astype(np.float32).reshape(-1, 1, 2)
    size = (board.columns, board.rows)
    across = cv2.estimateChessboardSharpness(grey, size, start, 0.8, False)[0]
    along = cv2.estimateChessboardSharpness(grey, size, start, 0.8, True)[0]
    return float(max(np.atleast_1d(across)[0], np.atleast_1d(along)[0]))


CELLS = (8, 6)
"""Columns and rows of the grid for counting coverage."""
WANTED_SPREAD = (0.6, 0.6, 0.25, 0.4)
"""Range of each measure that counts as complete."""
WANTED_COVERAGE = 0.75
WANTED_VIEWS = 20
MAX_VIEWS = 60
"""More views make the fit slow and add nothing."""
MIN_DISTANCE = 0.2
MIN_NEW_CELLS = 2
MAX_EDGE_PX = 6.0
MAX_EDGE_SHARE = 0.5
"""Share of a square; wider edges touch the next corner."""


class ViewMeasures(NamedTuple):
    """Place and pose of a board in a view, each 0 .. 1.

    Attributes:
        x: From the left to the right of the image.
        y: From the top to the bottom.
        size: Square root of the share of the image that the board covers.
        skew: How far the board's corner is from a right angle.
    """

    x: float
    y: float
    size: float
    skew: float

    def distance(self, other: ViewMeasures) -> float:
        """Return the sum of absolute differences."""
        return float(sum(abs(a - b) for a, b in zip(self, other, strict=True)))


class Verdict(Enum):
    """Decision about a view; values are shown to users."""

    KEPT = 'kept'
    BLURRED = 'blurred'
    ALIKE = 'like one already kept'
    FULL = 'enough views kept'


def measure(view: View) -> ViewMeasures:
    """Return place and pose of the board in a view."""
    grid = view.grid()
    quad = np.array([grid[0, 0], grid[0, -1], grid[-1, -1], grid[-1, 0]])
    across, along = quad[2] - quad[0], quad[3] - quad[1]
    area = 0.5 * abs(float(across[0] * along[1] - across[1] * along[0]))
    border = np.sqrt(area)
    middle = view.corners.mean(axis=0)
    place = (middle - border / 2.0) / np.maximum((view.width - border, view.height - border), 1.0)
    a, b = quad[0] - quad[1], quad[2] - quad[1]
    angle = np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1.0, 1.0))
    return ViewMeasures(
        x=float(np.clip(place[0], 0.0, 1.0)),
        y=float(np.clip(place[1], 0.0, 1.0)),
        size=float(np.sqrt(area / (view.width * view.height))),
        skew=float(min(1.0, 2.0 * abs(np.pi / 2.0 - angle))),
    )


def coverage_counts(views: list[View]) -> NDArray[np.int64]:
    """Return the number of corners in each cell of the image [rows, columns] of CELLS."""
    columns, rows = CELLS
    counts = np.zeros((rows, columns), np.int64)
    for view in views:
        cells = np.floor(view.corners * (columns / view.width, rows / view.height)).astype(np.int64)
        cells = cells.clip(0, (columns - 1, rows - 1))
        np.add.at(counts, (cells[:, 1], cells[:, 0]), 1)
    return counts


def coverage(views: list[View]) -> float:
    """Return the share of cells that hold a corner, 0 .. 1."""
    return float((coverage_counts(views) > 0).mean())


def spread(views: list[View]) -> tuple[float, float, float, float]:
    """Return the range of x, y, size and skew over all views."""
    if not views:
        return 0.0, 0.0, 0.0, 0.0
    x, y, size, skew = np.ptp([measure(view) for view in views], axis=0).tolist()
    return x, y, size, skew


class ViewSelection:
    """Keeps views worth fitting.

    Attributes:
        views: Those kept, in order of arrival.
        measures: Their measures.
        verdicts: How often each verdict fell.
    """

    def __init__(self) -> None:
        self.views: list[View] = []
        self.measures: list[ViewMeasures] = []
        self.verdicts = dict.fromkeys(Verdict, 0)

    def offer(self, view: View) -> Verdict:
        """Keep a view if it is sharp and shows something new."""
        verdict = self._judge(view)
        self.verdicts[verdict] += 1
        if verdict is Verdict.KEPT:
            self.views.append(view)
            self.measures.append(measure(view))
        return verdict

    @property
    def complete(self) -> bool:
        """Return whether more views would hardly improve a fit."""
        reached = all(
            got >= wanted for got, wanted in zip(spread(self.views), WANTED_SPREAD, strict=True)
        )
        enough = len(self.views) >= WANTED_VIEWS and coverage(self.views) >= WANTED_COVERAGE
        return len(self.views) >= MAX_VIEWS or (reached and enough)

    def _judge(self, view: View) -> Verdict:
        if len(self.views) >= MAX_VIEWS:
            return Verdict.FULL
        square = np.linalg.norm(np.diff(view.grid(), axis=1), axis=2).mean()
        if view.edge_px > MAX_EDGE_PX or view.edge_px > MAX_EDGE_SHARE * square:
            return Verdict.BLURRED
        wanted = measure(view)
        nearest = min((wanted.distance(each) for each in self.measures), default=np.inf)
        if nearest > MIN_DISTANCE:
            return Verdict.KEPT
        held, new = coverage_counts(self.views), coverage_counts([view])
        added = int(((held == 0) & (new > 0)).sum())
        return Verdict.KEPT if added >= MIN_NEW_CELLS else Verdict.ALIKE
