# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figure of a calibration: coverage, residuals, an undistorted view, the lens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mixtac_cli.calibrate.session import CalibrationSession
from mixtac_cli.figures import FORCE, REFERENCE, new_figure, save_figure
from mixtac_driver.calibration.board import CELLS, coverage_counts, measure, stretched
from mixtac_driver.calibration.solve import Solution
from mixtac_driver.calibration.undistortion import ImageUndistortion

KEPT, REMOVED, IDEAL = REFERENCE, FORCE, '#8a8a8a'


def draw_calibration(path: Path, solution: Solution, session: CalibrationSession) -> None:
    """Save a figure of a calibration.

    Args:
        path: File to write; its suffix gives the format.
        solution: The calibration.
        session: The views, with their images.

    Raises:
        FileError: The file cannot be written, or its suffix names no format.
    """
    figure = new_figure(14, 7.6, _title(solution))
    axes = figure.subplots(2, 3, gridspec_kw={'width_ratios': [1.25, 1.25, 1.0]})
    _coverage(axes[0, 0], solution)
    _residuals(figure, axes[0, 1], solution)
    _view_errors(axes[0, 2], solution)
    _example(axes[1, 0], axes[1, 1], solution, session)
    _lens(axes[1, 2], solution)
    save_figure(figure, path)


def _title(solution: Solution) -> str:
    found = solution.parameters()
    text = ', '.join(f'{name} = {found[name][0]:.1f}' for name in ('fx', 'fy', 'cx', 'cy'))
    return (
        f'Calibration of {solution.calibration.name}: {solution.calibration.model}, {text} px; '
        f'reprojection error {solution.rms_px:.3f} px (largest {solution.max_px:.2f} px)'
    )


def _coverage(axes: Axes, solution: Solution) -> None:
    width, height = solution.calibration.size
    axes.imshow(
        coverage_counts(solution.views),
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        cmap='Blues',
        aspect='equal',
        vmin=0,
    )
    corners = np.concatenate([view.corners for view in solution.views])
    axes.plot(*corners.T, '.', color='k', ms=1.2, alpha=0.6)
    axes.plot(*solution.calibration.camera_matrix[:2, 2], '+', color=REMOVED, ms=12, mew=2)
    axes.set_xticks(np.linspace(0, width, CELLS[0] + 1, dtype=int))
    axes.set_yticks(np.linspace(0, height, CELLS[1] + 1, dtype=int))
    axes.set_title(
        f'corners on the sensor: {100 * solution.coverage:.0f} % of the cells (+ optical axis)',
        fontsize=10,
    )
    axes.set_xlabel('column [px]')
    axes.set_ylabel('row [px]')


def _residuals(figure: Figure, axes: Axes, solution: Solution) -> None:
    residuals = np.concatenate(solution.fit.residuals)
    corners = np.concatenate([view.corners for view in solution.views])
    radius = np.linalg.norm(corners - solution.calibration.camera_matrix[:2, 2], axis=1)
    shown = axes.scatter(residuals[:, 0], residuals[:, 1], c=radius, s=4, cmap='viridis', lw=0)
    turn = np.linspace(0, 2 * np.pi, 100)
    rms = solution.rms_px
    axes.plot(
        rms * np.cos(turn), rms * np.sin(turn), color=REMOVED, lw=1.2, label=f'{rms:.3f} px rms'
    )
    limit = 1.05 * max(solution.max_px, 2 * rms)
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-limit, limit)
    axes.set_aspect('equal')
    axes.axhline(0, color='k', lw=0.4)
    axes.axvline(0, color='k', lw=0.4)
    axes.legend(loc='upper right', frameon=False, fontsize=9)
    axes.set_title('residuals: detected minus fitted corners', fontsize=10)
    axes.set_xlabel('along columns [px]')
    axes.set_ylabel('along rows [px]')
    figure.colorbar(shown, ax=axes, label='distance from the axis [px]', pad=0.02)


def _view_errors(axes: Axes, solution: Solution) -> None:
    rms = solution.fit.view_rms_px
    worst = [float(np.hypot(*each.T).max()) for each in solution.fit.residuals]
    places = np.arange(len(rms))
    axes.bar(places, rms, color=KEPT, label='rms')
    axes.plot(places, worst, '_', color='k', ms=6, label='largest')
    if solution.removed:
        after = len(rms) + 0.5 + np.arange(len(solution.removed))
        errors = [error for _, error in solution.removed]
        axes.bar(after, errors, color=REMOVED, label='removed')
        axes.set_ylim(0, min(max(errors), 4 * max(worst)) * 1.1)
    axes.axhline(solution.rms_px, color=REMOVED, lw=1.0)
    axes.legend(frameon=False, fontsize=9, ncols=3, loc='upper right')
    axes.set_title(f'error of each of {len(rms)} views', fontsize=10)
    axes.set_xlabel('view')
    axes.set_ylabel('reprojection error [px]')
    axes.set_ylim(0, axes.get_ylim()[1] * 1.15)


def _example(before: Axes, after: Axes, solution: Solution, session: CalibrationSession) -> None:
    """Show the view that fills most of the image, distorted and undistorted."""
    pairs = dict(zip(map(id, session.selection.views), session.images, strict=True))
    view = max(solution.views, key=lambda each: measure(each).size)
    image = stretched(pairs[id(view)])
    if image is None:
        return
    calibration = solution.calibration
    flat = ImageUndistortion(calibration).undistort(image)
    straight = calibration.undistort(view.corners).reshape(view.grid().shape)
    for axes, picture, grid, title in (
        (before, image, view.grid(), 'a view'),
        (after, flat, straight, 'the same view, undistorted: rows are straight'),
    ):
        axes.imshow(picture, cmap='gray')
        for line in (grid[0], grid[-1], grid[:, 0], grid[:, -1]):
            # From end to end: a row that is not straight leaves this line.
            axes.plot(line[[0, -1], 0], line[[0, -1], 1], color=REMOVED, lw=1.0)
        axes.plot(grid[..., 0].ravel(), grid[..., 1].ravel(), '.', color='#4fd1ff', ms=3)
        axes.set_xlim(-0.5, calibration.width - 0.5)
        axes.set_ylim(calibration.height - 0.5, -0.5)
        axes.set_title(title, fontsize=10)
        axes.set_xticks([])
        axes.set_yticks([])


def _lens(axes: Axes, solution: Solution) -> None:
    calibration = solution.calibration
    matrix = calibration.camera_matrix
    centre, focal = matrix[:2, 2], float(np.sqrt(matrix[0, 0] * matrix[1, 1]))
    corners = np.concatenate([view.corners for view in solution.views])
    seen = float(np.linalg.norm(corners - centre, axis=1).max())
    size = np.array(calibration.size, np.float64)
    rim = float(np.linalg.norm(np.maximum(centre, size - centre)))
    radius = np.linspace(0.0, rim, 200)
    angle = _angles_deg(solution, radius)
    axes.plot(angle, radius, color=KEPT, lw=1.8, label=f'this lens ({calibration.model})')
    flat = np.rad2deg(np.arctan(radius / focal))
    axes.plot(flat, radius, '--', color=IDEAL, label='pinhole of the same focal length')
    axes.axhspan(seen, rim, color=REMOVED, alpha=0.15, lw=0, label='no corner seen there')
    axes.set_xlim(0, None)
    axes.set_ylim(0, rim)
    axes.grid(visible=True, alpha=0.25)
    axes.legend(frameon=False, fontsize=9, loc='lower right')
    axes.set_title('lens', fontsize=10)
    axes.set_xlabel('angle off the axis [deg]')
    axes.set_ylabel('distance from the axis [px]')


def _angles_deg(solution: Solution, radius: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle off the axis shown at distances from it, along the diagonal."""
    from mixtac_driver.calibration.lens import undistort

    matrix = solution.calibration.camera_matrix
    points = radius[:, None] * np.array([1.0, 1.0]) / np.sqrt(2.0) / (matrix[0, 0], matrix[1, 1])
    ideal = undistort(solution.calibration.model, solution.calibration.distortion, points)
    return np.asarray(np.rad2deg(np.arctan(np.hypot(ideal[:, 0], ideal[:, 1]))))
