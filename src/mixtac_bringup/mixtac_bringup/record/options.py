# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac record` was asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_bringup.topics import REFERENCE

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class RecordOptions:
    """One recording.

    Attributes:
        output: Folder of the new bag.
        namespace: Namespace of the sensor.
        seconds: Planned length [s]; 0 until stopped.
        reference_topic: Topic of the reference force sensor.
        profile: What is done meanwhile, for `dataset.yaml`.
        split: `train`, `test` or empty, for `dataset.yaml`.
        check_seconds: For how long the checks listen [s].
        check_only: End after the checks.
        force: Record also where they found an error.
    """

    output: Path
    namespace: str = 'mixtac'
    seconds: float = 0.0
    reference_topic: str = REFERENCE
    profile: str = ''
    split: str = ''
    check_seconds: float = 2.0
    check_only: bool = False
    force: bool = False
