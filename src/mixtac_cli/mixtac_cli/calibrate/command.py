# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate`: from images of a checkerboard to a camera_info file and a figure."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mixtac_cli.calibrate.session import CalibrationSession, bag_images, grey_image, image_label
from mixtac_cli.figures import FORCE, REFERENCE, make_table, new_figure, save_figure
from mixtac_cli.monitor_node import ImageReceiver
from mixtac_cli.options import JsonFile, OptionalPath
from mixtac_cli.up import start_nodes
from mixtac_driver.calibration.board import (
    CELLS,
    Board,
    Verdict,
    coverage_counts,
    measure,
    stretched,
)
from mixtac_driver.calibration.camera_info import resolve, write_camera_info
from mixtac_driver.calibration.lens import check_model, undistort
from mixtac_driver.calibration.solve import Solution
from mixtac_driver.calibration.solve import calibrate as solve
from mixtac_driver.calibration.undistortion import ImageUndistortion
from mixtac_node.files import write_json
from mixtac_node.graph import sensor_graph
from mixtac_node.process import GraphError, ProcessGroup
from mixtac_node.topics import DEFAULT_NAMESPACE, IMAGE_RAW

IMAGE_TIMEOUT_S = 20.0
START_TIMEOUT_S = 60.0
CAMERA_NAME = 'davis346'
TOPIC = IMAGE_RAW.resolved(DEFAULT_NAMESPACE)


def calibrate(
    bag: Annotated[OptionalPath, typer.Argument(help='Recording with the images.')] = None,
    device: Annotated[
        str,
        typer.Option(
            help='Start a driver for this device (davis346 or virtual); empty uses the running one.'
        ),
    ] = '',
    topic: Annotated[str, typer.Option(help='Topic of the images.')] = TOPIC,
    board: Annotated[str, typer.Option(help='Inner corners of the checkerboard.')] = '9x6',
    square: Annotated[float, typer.Option(help='Side of a square (m).')] = 0.004,
    model: Annotated[
        str, typer.Option(help='equidistant (wide angle), plumb_bob or rational_polynomial.')
    ] = 'equidistant',
    alpha: Annotated[
        float,
        typer.Option(
            min=0,
            max=1,
            help='Free scaling parameter: 0 crops to valid pixels, 1 keeps all pixels.',
        ),
    ] = 0.0,
    name: Annotated[
        str, typer.Option(help='Name of the camera, as camera_name of the driver.')
    ] = CAMERA_NAME,
    out: Annotated[
        OptionalPath, typer.Option(help='File to write; by default where the driver reads it.')
    ] = None,
    figure: Annotated[
        OptionalPath, typer.Option(help='Draw the result to this PNG or PDF file.')
    ] = None,
    views: Annotated[
        OptionalPath, typer.Option(help='Folder for images of the views with their corners.')
    ] = None,
    json: JsonFile = None,
    seconds: Annotated[
        float,
        typer.Option(
            min=0, help='Longest time to collect live images (s); 0 until enough or Ctrl-C.'
        ),
    ] = 0.0,
    rate: Annotated[
        float, typer.Option(min=0, help='Images per second of a recording to use; 0 for all.')
    ] = 5.0,
    thorough: Annotated[
        bool, typer.Option(help='Search each image longer, to find small squares.')
    ] = False,
) -> None:
    """Calibrate the camera with a checkerboard and write a camera_info file."""
    console = Console(markup=False)
    check_model(model)
    out = out or resolve('', name)
    session = CalibrationSession(Board.parse(board, square), model, thorough=thorough)
    with CollectionDisplay(console, session) as display:
        if bag is not None:
            for label, image in bag_images(bag, topic, rate):
                session.offer(image, label)
                display.update()
        else:
            _collect_live(session, display, topic, device, seconds)
    console.print(f'board found in {session.found} of {session.seen} images')
    if views is not None and session.images:
        session.save_pictures(views)
    solution = solve(session.selection.views, model=model, name=name, alpha=alpha)
    print_solution(console, solution)
    comment = (
        f'mixtac calibrate: {len(solution.views)} views, reprojection error '
        f'{solution.rms_px:.3f} px, largest {solution.max_px:.2f} px'
    )
    write_camera_info(out, solution.calibration, comment)
    console.print(f'written to {out}')
    if figure is not None:
        draw_calibration(figure, solution, session)
    write_json(json, _summary(solution, session))


def _collect_live(
    session: CalibrationSession,
    display: CollectionDisplay,
    topic: str,
    device: str,
    seconds: float,
) -> None:
    """Offer live images until there are enough views, the time is over, or Ctrl-C."""
    namespace = topic.strip('/').rpartition('/')[0]
    try:
        with ProcessGroup() as processes, ImageReceiver(topic) as receiver:
            if device:
                nodes = [node for node in sensor_graph(device) if not node.lifecycle]
                start_nodes(processes, nodes, namespace)
            timeout_s = START_TIMEOUT_S if device else IMAGE_TIMEOUT_S
            start = last = time.monotonic()
            while not session.selection.complete:
                now = time.monotonic()
                if seconds and now - start > seconds:
                    return
                processes.check()
                message = receiver.take(0.2)
                if message is not None:
                    last, timeout_s = now, IMAGE_TIMEOUT_S
                    session.offer(grey_image(message), image_label(message))
                    display.update()
                elif now - last > timeout_s:
                    raise GraphError(
                        f'no image on {topic} in {timeout_s:.0f} s',
                        remedy='run `mixtac up`, give --device, or name the --topic',
                    )
    except KeyboardInterrupt:
        display.console.print('calibrating with the views collected so far')


_BAR = 24
_SHADES = ' ░▒▓█'


class CollectionDisplay:
    """A live panel in a terminal; elsewhere a line for each kept view.

    Args:
        console: Console to print to.
        session: The session to show.

    Attributes:
        console: As given.
    """

    def __init__(self, console: Console, session: CalibrationSession) -> None:
        self.console = console
        self._session = session
        self._live: Live | None = None

    def __enter__(self) -> CollectionDisplay:
        """Start the live panel."""
        if self.console.is_terminal:
            self._live = Live(self._panel(), console=self.console, refresh_per_second=5)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the last panel on the screen."""
        if self._live is not None:
            self._live.update(self._panel())
            self._live.stop()

    def update(self) -> None:
        """Show the session as it is now."""
        if self._live is not None:
            self._live.update(self._panel())
        elif self._session.last is Verdict.KEPT:
            self.console.print(self._line())

    def _line(self) -> str:
        session = self._session
        shares = ' '.join(f'{name} {100 * share:.0f}%' for name, share in session.progress())
        label = session.selection.views[-1].label
        return f'view {len(session.images):2d} ({label})  {shares}  {_fit(session.rms_px)}'

    def _panel(self) -> Group:
        session, verdicts = self._session, self._session.selection.verdicts
        table = Table(title='Camera calibration', title_justify='left', show_header=False)
        table.add_row('images', f'{session.seen}, board found in {session.found}')
        table.add_row('views', '  '.join(f'{each.value} {verdicts[each]}' for each in Verdict))
        table.add_row('last image', session.last.value if session.last else 'no board')
        for name, share in session.progress():
            filled = round(share * _BAR)
            table.add_row(name, f'{"█" * filled}{"·" * (_BAR - filled)} {100 * share:3.0f} %')
        table.add_row('corners', _coverage_map(session))
        table.add_row('fit', _fit(session.rms_px))
        table.add_row('next', session.hint())
        return Group(table, Text('Ctrl-C stops collecting and calibrates with these views'))


def print_solution(console: Console, solution: Solution) -> None:
    """Print the parameters with their standard deviations, and the errors."""
    calibration = solution.calibration
    title = f'{calibration.name}, {calibration.width}x{calibration.height}, {calibration.model}'
    rows = []
    for name, (value, deviation) in solution.parameters().items():
        pixels = name in ('fx', 'fy', 'cx', 'cy')
        unit, digits = (' px', 2) if pixels else ('', 5)
        rows.append((name, f'{value:.{digits}f}{unit}', f'{deviation:.{digits + 1}f}{unit}'))
    console.print(make_table(title, ('parameter', 'value', 'std. deviation'), rows))
    console.print(
        f'reprojection error {solution.rms_px:.3f} px, largest {solution.max_px:.2f} px, '
        f'{len(solution.views)} views, corners in {100 * solution.coverage:.0f} % of the image'
    )
    for view, error in solution.removed:
        console.print(f'view {view.label} removed: error {error:.2f} px')
    if solution.folded:
        console.print(
            f'{100 * solution.folded:.1f} % of the image cannot be rectified: no corner was seen '
            'there, and the lens model folds back'
        )


def _fit(rms_px: float) -> str:
    return f'reprojection error {rms_px:.3f} px' if rms_px == rms_px else 'not yet'  # noqa: PLR0124


def _coverage_map(session: CalibrationSession) -> str:
    counts = coverage_counts(session.selection.views)
    top = max(1, int(counts.max()))
    levels = len(_SHADES) - 1
    return '\n'.join(
        ''.join(_SHADES[-(-int(count) * levels // top)] * 2 for count in row) for row in counts
    )


def _summary(solution: Solution, session: CalibrationSession) -> dict[str, Any]:
    parameters = solution.parameters()
    return {
        'model': solution.calibration.model,
        'images': session.seen,
        'boards': session.found,
        'views': len(solution.views),
        'removed_views': [view.label for view, _ in solution.removed],
        'coverage': solution.coverage,
        'reprojection_error_px': {'rms': solution.rms_px, 'max': solution.max_px},
        'view_error_px': solution.fit.view_rms_px.tolist(),
        'parameters': {name: value for name, (value, _) in parameters.items()},
        'standard_deviations': {name: each for name, (_, each) in parameters.items()},
        'projection': solution.calibration.projection.ravel().tolist(),
    }


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
    _residuals(axes[0, 1], solution)
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
    axes.set(xlabel='column [px]', ylabel='row [px]')


def _residuals(axes: Axes, solution: Solution) -> None:
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
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect='equal')
    axes.axhline(0, color='k', lw=0.4)
    axes.axvline(0, color='k', lw=0.4)
    axes.legend(loc='upper right', frameon=False, fontsize=9)
    axes.set_title('residuals: detected minus fitted corners', fontsize=10)
    axes.set(xlabel='along columns [px]', ylabel='along rows [px]')
    axes.figure.colorbar(shown, ax=axes, label='distance from the axis [px]', pad=0.02)


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
    axes.set(xlabel='view', ylabel='reprojection error [px]')
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
        axes.set(xlim=(-0.5, calibration.width - 0.5), ylim=(calibration.height - 0.5, -0.5))
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=10)


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
    axes.set(xlim=(0, None), ylim=(0, rim))
    axes.grid(visible=True, alpha=0.25)
    axes.legend(frameon=False, fontsize=9, loc='lower right')
    axes.set_title('lens', fontsize=10)
    axes.set(xlabel='angle off the axis [deg]', ylabel='distance from the axis [px]')


def _angles_deg(solution: Solution, radius: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle off the axis shown at distances from it, along the diagonal."""
    matrix = solution.calibration.camera_matrix
    points = radius[:, None] * np.array([1.0, 1.0]) / np.sqrt(2.0) / (matrix[0, 0], matrix[1, 1])
    ideal = undistort(solution.calibration.model, solution.calibration.distortion, points)
    return np.asarray(np.rad2deg(np.arctan(np.hypot(ideal[:, 0], ideal[:, 1]))))
