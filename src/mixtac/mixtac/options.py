# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share: type, name and help text of each."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Optional

import typer

from mixtac_core.node.files import writable

OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
JsonFile = Annotated[
    OptionalPath,
    typer.Option('--json', help='Also write the result to this JSON file.', callback=writable),
]
# At most 200 characters.
_NAME = re.compile(r'(?!.{201})/*([A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*)?/*')


def check_name(parameter: typer.CallbackParam, value: str) -> str:
    """Return the name of a ROS topic or namespace, checked; only a namespace may be empty.

    Raises:
        BadParameter: The name is empty, too long, or contains other characters.
    """
    empty = parameter.name != 'namespace' and not value.strip('/')
    if empty or _NAME.fullmatch(value) is None:
        raise typer.BadParameter(f'{value[:200]!r}: a ROS name has <= 200 letters, digits, _, /')
    return value


Namespace = Annotated[
    str,
    typer.Option('--namespace', help='ROS namespace of the sensor.', callback=check_name),
]
ParamsFile = Annotated[
    OptionalPath,
    typer.Option('--params-file', exists=True, help='Parameter file that overrides the defaults.'),
]
Profile = Annotated[str, typer.Option(help='Kind of motion in dataset.yaml, as static.')]
Split = Annotated[Literal['', 'train', 'test'], typer.Option(help='Split in dataset.yaml.')]
RunTime = Annotated[
    float, typer.Option('--seconds', min=0, help='Run time (s); 0 runs until Ctrl-C.')
]
Preset = Annotated[
    Literal['easy', 'paper_like', 'hard', 'varied'],
    typer.Option('--preset', help='Difficulty of the simulated sensor.'),
]
_REFERENCE = 'Topic of the reference force (WrenchStamped).'
ReferenceTopic = Annotated[
    str, typer.Option('--reference-topic', help=_REFERENCE, callback=check_name)
]
