# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share: type, name and help text of each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
JsonFile = Annotated[
    OptionalPath, typer.Option('--json', help='Also write the result to this JSON file.')
]
Namespace = Annotated[str, typer.Option('--namespace', help='ROS namespace of the sensor.')]
ParamsFile = Annotated[
    OptionalPath,
    typer.Option('--params-file', exists=True, help='Parameter file that overrides the defaults.'),
]
RunTime = Annotated[
    float, typer.Option('--seconds', min=0, help='Run time (s); 0 runs until Ctrl-C.')
]
Preset = Annotated[
    str,
    typer.Option('--preset', help='Difficulty of the simulated sensor: easy, paper_like or hard.'),
]
ReferenceTopic = Annotated[
    str, typer.Option('--reference', help='Topic of the reference force (WrenchStamped).')
]
