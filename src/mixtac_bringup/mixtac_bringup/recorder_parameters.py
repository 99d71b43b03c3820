# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the recorder node."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_bringup.topics import REFERENCE
from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class RecorderParameters:
    """What to record and where to."""

    output: str = parameter('', 'Folder of the new bag; it must not exist yet.', read_only=True)
    reference_topic: str = parameter(
        REFERENCE, 'Topic of the reference force sensor.', read_only=True
    )
    profile: str = parameter(
        '', 'What is done while recording, for dataset.yaml, for example static.', read_only=True
    )
    split: str = parameter(
        '',
        'What the recording is for, in dataset.yaml.',
        choices=('', 'train', 'test'),
        read_only=True,
    )
