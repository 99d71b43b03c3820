# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate`: from images of a checkerboard to a camera_info file."""

from __future__ import annotations

import time
from typing import Annotated, Any

import typer
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mixtac_cli.calibrate.figure import draw_calibration
from mixtac_cli.calibrate.session import CalibrationSession, bag_images, grey_image, image_label
from mixtac_cli.monitor_node import ImageReceiver
from mixtac_cli.options import JsonFile, OptionalPath
from mixtac_cli.up import start_nodes
from mixtac_driver.calibration.board import Board, Verdict, coverage_counts
from mixtac_driver.calibration.camera_info import resolve, write_camera_info
from mixtac_driver.calibration.lens import check_model
from mixtac_driver.calibration.solve import Solution
from mixtac_driver.calibration.solve import calibrate as solve
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
    console = Console()
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
    if json is not None:
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
