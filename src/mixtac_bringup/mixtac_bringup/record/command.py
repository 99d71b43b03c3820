# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record`: record the running sensor to a bag."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console

from mixtac_bringup.record.options import RecordOptions
from mixtac_bringup.topics import REFERENCE

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)


def record(
    out: Annotated[Path, typer.Argument(help='Folder of the new bag.')],
    seconds: Annotated[float, typer.Option(min=0, help='Length (s); 0 until Ctrl-C.')] = 0,
    namespace: Annotated[str, typer.Option(help='Namespace of the sensor.')] = 'mixtac',
    reference_topic: Annotated[str, typer.Option(help='Reference force sensor.')] = REFERENCE,
    profile: Annotated[str, typer.Option(help='What is done, for dataset.yaml.')] = '',
    split: Annotated[str, typer.Option(help='train or test, for dataset.yaml.')] = '',
    check: Annotated[bool, typer.Option('--check', help='Check only, record nothing.')] = False,
    check_seconds: Annotated[float, typer.Option(min=0.5, help='How long to listen (s).')] = 2,
    force: Annotated[bool, typer.Option('--force', help='Record in spite of errors.')] = False,
    json: Annotated[OptionalPath, typer.Option(help='Write the summary there as well.')] = None,
) -> None:
    """Check disk, topics and clocks, record the running sensor, and say what was lost."""
    from mixtac_bringup.record.session_node import Session

    if split not in {'', 'train', 'test'}:
        raise typer.BadParameter(f'{split!r}: choose train or test', param_hint='--split')
    options = RecordOptions(
        out,
        namespace,
        seconds,
        reference_topic,
        profile,
        split,
        check_seconds,
        check_only=check,
        force=force,
    )
    summary = Session(Console(), options).run()
    if json is not None and summary is not None:
        json.write_text(json_format.dumps(summary.as_dict(), indent=2) + '\n')
