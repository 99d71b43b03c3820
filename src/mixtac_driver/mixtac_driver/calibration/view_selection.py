# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which views to keep: sharp, and unlike those already held.

Position, size and skew are measured as ROS camera_calibration does, so its users know the bars.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_driver.calibration.checkerboard import View

CELLS = (8, 6)
"""Columns and rows of the grid over the image in which coverage is counted."""
WANTED_SPREAD = (0.6, 0.6, 0.25, 0.4)
"""Range of each measure that counts as complete."""
WANTED_COVERAGE = 0.75
WANTED_VIEWS = 20
MAX_VIEWS = 60
"""More make the fit slow and add nothing."""
MIN_DISTANCE = 0.2
MIN_NEW_CELLS = 2
MAX_EDGE_PX = 6.0
MAX_EDGE_SHARE = 0.5
"""Of a square: edges wider than that touch the next corner."""


@dataclass(frozen=True, slots=True)
class ViewMeasures:
    """Where and how a board is held, each 0 .. 1.

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
        return float(sum(abs(a - b) for a, b in zip(astuple(self), astuple(other), strict=True)))


class Verdict(Enum):
    """What became of a view; the value says it in words."""

    KEPT = 'kept'
    BLURRED = 'blurred'
    ALIKE = 'like one already kept'
    FULL = 'enough views kept'


def measure(view: View) -> ViewMeasures:
    """Return where and how the board is held in a view."""
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
    x, y, size, skew = np.ptp([astuple(measure(view)) for view in views], axis=0).tolist()
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
        """Tell whether more views would hardly improve a fit."""
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
        return Verdict.KEPT if nearest > MIN_DISTANCE or self._adds(view) else Verdict.ALIKE

    def _adds(self, view: View) -> bool:
        held, new = coverage_counts(self.views), coverage_counts([view])
        return int(((held == 0) & (new > 0)).sum()) >= MIN_NEW_CELLS
