# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate`: from images of a checkerboard to a camera_info file."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mixtac_driver.calibration.board import Verdict, coverage_counts

if TYPE_CHECKING:
    from types import TracebackType

    from mixtac_cli.calibrate.session import CalibrationSession
    from mixtac_driver.calibration.solve import Solution


_BAR = 24
_SHADES = ' ░▒▓█'


class CollectionDisplay:
    """A live panel in a terminal; elsewhere a line for each view that is kept.

    Args:
        console: Where to show it.
        session: What to show.
    """

    def __init__(self, console: Console, session: CalibrationSession) -> None:
        self._console = console
        self._session = session
        self._live: Live | None = None

    def __enter__(self) -> CollectionDisplay:
        """Start the live panel."""
        if self._console.is_terminal:
            self._live = Live(self._panel(), console=self._console, refresh_per_second=5)
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the last panel on the screen."""
        if self._live is not None:
            self._live.update(self._panel())
            self._live.stop()

    def update(self) -> None:
        """Show the session as it is now."""
        if self._live is not None:
            self._live.update(self._panel())
        elif self._session.last.verdict is Verdict.KEPT:
            self._console.print(self._line())

    def _line(self) -> str:
        session = self._session
        shares = ' '.join(f'{name} {100 * share:.0f}%' for name, share in session.progress())
        label = session.last.view.label if session.last.view else ''
        return f'view {len(session.images):2d} ({label})  {shares}  {_fit(session.rms_px)}'

    def _panel(self) -> Group:
        session, verdicts = self._session, self._session.selection.verdicts
        table = Table(title='Camera calibration', title_justify='left', show_header=False)
        table.add_row('images', f'{session.seen}, board found in {session.found}')
        table.add_row('views kept', '  '.join(f'{each.value} {verdicts[each]}' for each in Verdict))
        table.add_row('last image', str(session.last))
        for name, share in session.progress():
            filled = round(share * _BAR)
            table.add_row(name, f'{"█" * filled}{"·" * (_BAR - filled)} {100 * share:3.0f} %')
        table.add_row('corners', _coverage_map(session))
        table.add_row('fit', _fit(session.rms_px))
        table.add_row('next', session.hint())
        return Group(table, Text('Ctrl-C ends collecting and calibrates with what is there'))


def print_solution(console: Console, solution: Solution) -> None:
    """Print the parameters with their standard deviations, and the errors."""
    calibration = solution.calibration
    table = Table(
        title=f'{calibration.name}, {calibration.width}x{calibration.height}, {calibration.model}',
        title_justify='left',
    )
    for heading in ('parameter', 'value', 'std. deviation'):
        table.add_column(heading, justify='left' if heading == 'parameter' else 'right')
    for name, (value, deviation) in solution.parameters().items():
        pixels = name in ('fx', 'fy', 'cx', 'cy')
        unit, digits = (' px', 2) if pixels else ('', 5)
        table.add_row(name, f'{value:.{digits}f}{unit}', f'{deviation:.{digits + 1}f}{unit}')
    console.print(table)
    console.print(
        f'reprojection error {solution.rms_px:.3f} px, largest {solution.max_px:.2f} px, '
        f'{len(solution.views)} views, corners in {100 * solution.coverage:.0f} % of the image'
    )
    for view, error in solution.removed:
        console.print(f'view {view.label} left out: its error was {error:.2f} px')
    if solution.folded:
        console.print(
            f'{100 * solution.folded:.1f} % of the image have no rectified place: no corner was '
            'seen there and the model folds back'
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


IMAGE_TIMEOUT_S = 20.0
START_TIMEOUT_S = 60.0
OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


@dataclass(frozen=True)
class CalibrateOptions:
    """What `mixtac calibrate` was asked for.

    Attributes:
        board: Inner corners, as in `9x6`.
        square_m: Side of a square [m].
        bag: Recording to take images from; None for live images.
        device: Device to start a driver for; None where one runs already.
        topic: Topic of the images.
        model: Lens model.
        alpha: How much of the image rectified images keep.
        name: Name of the camera.
        out: File to write; None for where the driver looks.
        figure: Picture of the result, or None.
        views: Folder for pictures of the kept views, or None.
        summary: JSON file of the result, or None.
        seconds: Longest time to collect live [s]; 0 for no limit.
        rate_hz: Most images per second of a recording to look at; 0 for all.
        thorough: Search each image more thoroughly for small squares.
    """

    board: str = '9x6'
    square_m: float = 0.004
    bag: Path | None = None
    device: str | None = None
    topic: str = '/mixtac/image_raw'
    model: str = 'equidistant'
    alpha: float = 0.0
    name: str = 'davis346'
    out: Path | None = None
    figure: Path | None = None
    views: Path | None = None
    summary: Path | None = None
    seconds: float = 0.0
    rate_hz: float = 5.0
    thorough: bool = False


def calibrate(
    bag: Annotated[OptionalPath, typer.Argument(help='Recording with the images.')] = None,
    device: Annotated[
        str, typer.Option(help='Start a driver for davis346 or virtual; else one must run.')
    ] = '',
    topic: Annotated[str, typer.Option(help='Topic of the images.')] = '/mixtac/image_raw',
    board: Annotated[str, typer.Option(help='Inner corners of the checkerboard.')] = '9x6',
    square: Annotated[float, typer.Option(help='Side of a square (m).')] = 0.004,
    model: Annotated[
        str, typer.Option(help='equidistant (wide angle), plumb_bob or rational_polynomial.')
    ] = 'equidistant',
    alpha: Annotated[
        float, typer.Option(min=0, max=1, help='Rectified image: 0 filled, 1 all is shown.')
    ] = 0.0,
    name: Annotated[str, typer.Option(help='camera_name of the driver.')] = 'davis346',
    out: Annotated[
        OptionalPath, typer.Option(help='File to write; else where the driver looks for it.')
    ] = None,
    figure: Annotated[OptionalPath, typer.Option(help='Draw the result there (PNG, PDF).')] = None,
    views: Annotated[
        OptionalPath, typer.Option(help='Folder for pictures of the views with their corners.')
    ] = None,
    json: Annotated[OptionalPath, typer.Option(help='Write the result there as well.')] = None,
    seconds: Annotated[
        float, typer.Option(min=0, help='Longest time to collect live; 0 until enough or Ctrl-C.')
    ] = 0.0,
    rate: Annotated[
        float, typer.Option(min=0, help='Images per second of a recording; 0 for all.')
    ] = 5.0,
    thorough: Annotated[bool, typer.Option(help='Search longer for small squares.')] = False,
) -> None:
    """Calibrate the camera with a checkerboard and write a camera_info file."""
    options = CalibrateOptions(
        board=board,
        square_m=square,
        bag=bag,
        device=device or None,
        topic=topic,
        model=model,
        alpha=alpha,
        name=name,
        out=out,
        figure=figure,
        views=views,
        summary=json,
        seconds=seconds,
        rate_hz=rate,
        thorough=thorough,
    )
    run_calibration(Console(), options)


def run_calibration(console: Console, options: CalibrateOptions) -> Solution:
    """Collect views, fit, and write what was asked for.

    Raises:
        CalibrationError: An option is wrong, or the views give no calibration.
        BagError: The recording has no such images.
        GraphError: No image came, or a node ended.
    """
    from mixtac_cli.calibrate.session import CalibrationSession
    from mixtac_driver.calibration.board import Board
    from mixtac_driver.calibration.camera_info import resolve, write_camera_info
    from mixtac_driver.calibration.solve import calibrate as solve
    from mixtac_driver.calibration.solve import check_model

    check_model(options.model)
    out = options.out or resolve('', options.name)
    board = Board.parse(options.board, options.square_m)
    session = CalibrationSession(board, options.model, thorough=options.thorough)
    _collect(console, options, session)
    console.print(f'board found in {session.found} of {session.seen} images')
    if options.views is not None and session.images:
        session.save_pictures(options.views)
    solution = solve(
        session.selection.views, model=options.model, name=options.name, alpha=options.alpha
    )
    print_solution(console, solution)
    write_camera_info(out, solution.calibration, _comment(solution))
    console.print(f'written to {out}')
    if options.figure is not None:
        from mixtac_cli.calibrate.figure import draw_calibration

        draw_calibration(options.figure, solution, session)
    if options.summary is not None:
        options.summary.write_text(json.dumps(_summary(solution, session), indent=1) + '\n')
    return solution


def _collect(console: Console, options: CalibrateOptions, session: CalibrationSession) -> None:

    with CollectionDisplay(console, session) as display:
        if options.bag is not None:
            from mixtac_cli.calibrate.session import bag_images

            for label, image in bag_images(options.bag, options.topic, options.rate_hz):
                session.offer(image, label)
                display.update()
        else:
            try:
                _collect_live(options, session, display)
            except KeyboardInterrupt:
                console.print('calibrating with what is there')


def _collect_live(options: CalibrateOptions, session: CalibrationSession, display: Any) -> None:  # noqa: ANN401
    from mixtac_cli.calibrate.session import grey_image, image_label
    from mixtac_cli.monitor_node import ImageReceiver
    from mixtac_node.graph import sensor_graph
    from mixtac_node.process import GraphError, ProcessGroup

    with ProcessGroup() as processes, ImageReceiver(options.topic) as receiver:
        if options.device is not None:
            namespace = options.topic.strip('/').rpartition('/')[0]
            for node in sensor_graph(options.device):
                if not node.lifecycle:
                    processes.start(node.name, node.command(namespace))
        patience_s = START_TIMEOUT_S if options.device else IMAGE_TIMEOUT_S
        start = last = time.monotonic()
        while not session.selection.complete:
            now = time.monotonic()
            if options.seconds and now - start > options.seconds:
                return
            processes.check()
            message = receiver.take(0.2)
            if message is not None:
                last, patience_s = now, IMAGE_TIMEOUT_S
                session.offer(grey_image(message), image_label(message))
                display.update()
            elif now - last > patience_s:
                raise GraphError(
                    f'no image on {options.topic} in {patience_s:.0f} s: run `mixtac up`, give '
                    '--device, or name the --topic'
                )


def _comment(solution: Solution) -> str:
    return (
        f'mixtac calibrate: {len(solution.views)} views, reprojection error '
        f'{solution.rms_px:.3f} px, largest {solution.max_px:.2f} px'
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
