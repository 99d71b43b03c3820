# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command `adapt`; torch is imported only once it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, List, Optional  # noqa: UP035  (as below)

import typer

from mixtac_fger.model_files import DEFAULT_MODEL, find_model

# typer evaluates these under Python 3.10.
OptionalPath = Optional[Path]  # noqa: UP045
OptionalStrings = Optional[List[str]]  # noqa: UP006, UP045
Paths = List[Path]  # noqa: UP006


def adapt(
    bags: Annotated[Paths, typer.Argument(help='Recordings of presses with the new sensor.')],
    out: Annotated[Path, typer.Option(help='Weight file to write.')],
    model: Annotated[str, typer.Option(help='Weight file, or name of a shipped one.')] = (
        DEFAULT_MODEL
    ),
    load: Annotated[
        OptionalStrings,
        typer.Option(
            help='A known load instead of a reference sensor, such as 0.5:3.0-6.0: newtons, and'
            ' seconds since the recording began; may be given more than once.'
        ),
    ] = None,
    reference: Annotated[
        str, typer.Option(help='Topic of the reference force in the bags.')
    ] = '/ft_sensor/wrench',
    serial: Annotated[
        str, typer.Option(help="Serial number of the sensor's camera; the node refuses others.")
    ] = '',
    json: Annotated[OptionalPath, typer.Option(help='Write the figures there as well.')] = None,
) -> None:
    """Calibrate a model to another sensor by at most a minute of presses with known forces."""
    from mixtac_fger.adapt.command import AdaptRequest, run_adaptation

    run_adaptation(AdaptRequest(bags, find_model(model), out, load or (), reference, json, serial))
