# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac calibrate`: from images of a checkerboard to a camera_info file."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from mixtac.figures import make_table
from mixtac.options import OptionalPath
from mixtac.up import start_nodes
from mixtac_core.node.graph import sensor_graph
from mixtac_core.node.images import grey
from mixtac_core.node.process import GraphError, ProcessGroup
from mixtac_core.node.topics import DEFAULT_NAMESPACE, IMAGE_RAW
from mixtac_core.recordings.bag import BagFile
from mixtac_core.recordings.recording import RecordingError
from mixtac_driver.camera_info import check_model, resolve, write_camera_info

if TYPE_CHECKING:
    from mixtac_driver.calibration import Solution

Images = Generator[tuple[str, Any], None, None]

IMAGE_TIMEOUT_S = 20.0
"""Longest time without an image [s]."""
BAG_PERIOD_NS = 200_000_000
"""Least time between two images of a bag that are searched for the board [ns]."""
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
    name: Annotated[
        str, typer.Option(help='Name of the camera, as in camera_name of the driver.')
    ] = 'davis346',
    out: Annotated[
        OptionalPath, typer.Option(help='File to write; by default the file that the driver reads.')
    ] = None,
) -> None:
    """Calibrate the camera with a checkerboard and write a camera_info file."""
    from mixtac_driver.calibration import Board, ViewSelection, find_board
    from mixtac_driver.calibration import calibrate as solve

    console = Console(markup=False)
    check_model(model)
    wanted, out = Board.parse(board, square), out or resolve('', name)
    selection, seen, found = ViewSelection(), 0, 0
    images = bag_images(bag, topic) if bag is not None else live_images(topic, device)
    try:
        for label, image in images:
            view = find_board(image, wanted, label)
            seen, found = seen + 1, found + (view is not None)
            if view is not None and selection.offer(view):
                shares = selection.progress().items()
                listed = ', '.join(f'{share:.0%} of {name}' for name, share in shares)
                console.print(f'view {len(selection.views):2d} ({label}): {listed}')
            if bag is None and selection.complete:
                break
    except KeyboardInterrupt:
        console.print('calibrating with the views collected so far')
    finally:
        # Ends the nodes that it started.
        images.close()
    console.print(f'board found in {found} of {seen} images')
    solution = solve(selection.views, model=model, name=name)
    print_solution(console, solution)
    comment = f'mixtac calibrate: {len(solution.views)} views, error {solution.rms_px:.3f} px'
    write_camera_info(out, solution.calibration, comment)
    console.print(f'written to {out}')


def bag_images(path: Path, topic: str) -> Images:
    """Yield label and grey levels of five images per second of a bag.

    Args:
        path: Folder of the bag.
        topic: Topic of the images.

    Raises:
        RecordingError: No bag, no such topic, no images on it, or damaged ones.
    """
    next_ns = 0
    with BagFile(path) as bag:
        kind = bag.types.get(topic)
        if kind not in (None, IMAGE_RAW.type_name):
            raise RecordingError(f'{path}: {topic} carries {kind}; name the topic of the images')
        for _, received_ns, message in bag.messages(topic):
            # Tolerate half a millisecond of jitter.
            if received_ns < next_ns - 500_000:
                continue
            next_ns = received_ns + BAG_PERIOD_NS
            yield labelled(message)


def live_images(topic: str, device: str) -> Images:
    """Yield label and grey levels of live images; ends the nodes that it started.

    Args:
        topic: Topic of the images.
        device: Device whose driver is started; empty for none.

    Raises:
        GraphError: A node ended, or no image came; a driver may start as slowly as it needs to.
    """
    from mixtac.monitor_node import CommandNode

    newest: deque[Any] = deque(maxlen=1)
    with ProcessGroup() as processes, CommandNode.opened('calibrate', DEFAULT_NAMESPACE) as node:
        latest = replace(IMAGE_RAW, depth=1)
        node.subscribe_topic(latest, newest.append, name=topic)
        if device:
            nodes = [each for each in sensor_graph(device) if each.name != 'fger']
            start_nodes(processes, nodes, topic.strip('/').rpartition('/')[0])
        last_s = math.inf if device else time.monotonic()
        while True:
            processes.check()
            node.spin_for(0.2, lambda: bool(newest))
            if newest:
                yield labelled(newest.pop())
                last_s = time.monotonic()
            elif time.monotonic() - last_s > IMAGE_TIMEOUT_S:
                raise GraphError(
                    f'no image on {topic} in {IMAGE_TIMEOUT_S:.0f} s',
                    remedy='run `mixtac up`, give --device, or name the --topic',
                )
            else:
                node.get_logger().info('waiting for images', throttle_duration_sec=10.0)


def labelled(message: Any) -> tuple[str, Any]:  # noqa: ANN401
    """Return the stamp of an image message as text [s], and its grey levels.

    Raises:
        ImageConversionError: Unknown encoding, or fewer data than the size requires.
    """
    stamp = message.header.stamp
    return f'{stamp.sec}.{stamp.nanosec // 1_000_000:03d}', grey(message)


def print_solution(console: Console, solution: Solution) -> None:
    """Print the parameters with their standard deviations, and the errors."""
    calibration = solution.calibration
    title = f'{calibration.name}, {calibration.width}x{calibration.height}, {calibration.model}'
    rows = []
    for name, (value, deviation) in solution.parameters().items():
        unit, digits = (' px', 2) if name in ('fx', 'fy', 'cx', 'cy') else ('', 5)
        rows.append((name, f'{value:.{digits}f}{unit}', f'{deviation:.{digits + 1}f}{unit}'))
    console.print(make_table(title, ('parameter', 'value', 'std. deviation'), rows))
    console.print(f'reprojection error {solution.rms_px:.3f} px, {len(solution.views)} views')
    for view, error in solution.removed:
        console.print(f'view {view.label} removed: error {error:.2f} px')
