# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes recorder, view and supervisor."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_node.topics import REFERENCE


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


@dataclass(frozen=True)
class ViewParameters:
    """What the live view shows, how often, and where."""

    rate: float = parameter(
        20.0,
        'Pictures per second; samples between two of them are thinned, peaks kept.',
        unit='Hz',
        minimum=1.0,
        maximum=60.0,
        read_only=True,
    )
    history: float = parameter(
        10.0, 'Width of the plots.', unit='s', minimum=1.0, maximum=600.0, read_only=True
    )
    port: int = parameter(
        9090,
        'TCP port of the page on 127.0.0.1; 0 takes any free one.',
        minimum=0,
        maximum=65535,
        read_only=True,
    )
    data_port: int = parameter(
        0,
        'TCP port on 127.0.0.1 from which the page gets its data; 0 takes any free one.',
        minimum=0,
        maximum=65535,
        read_only=True,
    )
    memory: int = parameter(
        300,
        'Data that the server keeps for pages opened later; the oldest leave first.',
        unit='MB',
        minimum=50,
        maximum=16000,
        read_only=True,
    )
    save: str = parameter(
        '', 'Write to this new .rrd file instead of serving a page.', read_only=True
    )
    reference_topic: str = parameter(
        REFERENCE, 'Topic of the reference force sensor.', read_only=True
    )


@dataclass(frozen=True)
class SupervisorParameters:
    """When the supervisor lets the object be struck."""

    knock_every: float = parameter(
        8.0,
        'Least time between blows, which come while slip control is enabled; 0 for none.',
        unit='s',
        minimum=0.0,
        maximum=3600.0,
    )
