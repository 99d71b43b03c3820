# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac view`: the live view of a graph that runs already."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from mixtac_bringup.graph import NodeSpec
from mixtac_bringup.processes import ProcessGroup
from mixtac_bringup.view.viewer_server import require_rerun

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


def view_node(port: int = 9090, save: Path | None = None) -> NodeSpec:
    """Return the node of the live view.

    Args:
        port: Of the page on 127.0.0.1; 0 for any free one.
        save: New .rrd file to write instead of serving a page.

    Raises:
        ViewError: rerun-sdk is not installed.
    """
    require_rerun()
    overrides: dict[str, object] = {'port': port}
    if save is not None:
        overrides['save'] = str(save)
    return NodeSpec('mixtac_bringup', 'view_node', 'view', overrides=overrides)


def view(
    namespace: Annotated[str, typer.Option(help='ROS namespace of the sensor.')] = 'mixtac',
    port: Annotated[
        int, typer.Option(min=0, max=65535, help='Port of the page on 127.0.0.1; 0: any free one.')
    ] = 9090,
    save: Annotated[OptionalPath, typer.Option(help='Write to this .rrd file, no page.')] = None,
    seconds: Annotated[float, typer.Option(min=0, help='How long; 0 until Ctrl-C.')] = 0,
    params_file: Annotated[
        OptionalPath, typer.Option(exists=True, help='Parameters that win over the shipped ones.')
    ] = None,
) -> None:
    """Show a running sensor in the browser: events, frame, force, slip, rates."""
    node = view_node(port, save)
    with ProcessGroup() as processes:
        processes.start(node.name, node.command(namespace, params_file))
        where = save or 'the page whose address the node says'
        Console().print(f'showing /{namespace.strip("/")} in {where}; Ctrl-C ends it')
        end = time.monotonic() + seconds
        while not seconds or time.monotonic() < end:
            time.sleep(0.2)
            processes.check()
