# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes recorder, view and supervisor."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter
from mixtac_node.topics import REFERENCE


@dataclass(frozen=True)
class RecorderParameters:
    """Parameters of the recorder node."""

    output: str = parameter('', 'Folder of the new bag; it must not exist.', read_only=True)
    reference_topic: str = parameter(
        REFERENCE, 'Topic of the reference force (WrenchStamped).', read_only=True
    )
    profile: str = parameter(
        '', 'Kind of motion, for dataset.yaml, for example static.', read_only=True
    )
    split: str = parameter(
        '',
        'Split of the recording, for dataset.yaml.',
        choices=('', 'train', 'test'),
        read_only=True,
    )


@dataclass(frozen=True)
class ViewParameters:
    """Parameters of the live view node."""

    rate: float = parameter(
        20.0,
        'Pictures per second. Samples between two pictures are thinned; peaks are kept.',
        unit='Hz',
        minimum=1.0,
        maximum=60.0,
        read_only=True,
    )
    history: float = parameter(
        10.0, 'Time span of the plots.', unit='s', minimum=1.0, maximum=600.0, read_only=True
    )
    port: int = parameter(
        9090,
        'TCP port of the page on 127.0.0.1; 0 selects any free one.',
        minimum=0,
        maximum=65535,
        read_only=True,
    )
    data_port: int = parameter(
        0,
        'TCP port on 127.0.0.1 from which the page reads its data; 0 selects any free one.',
        minimum=0,
        maximum=65535,
        read_only=True,
    )
    memory: int = parameter(
        300,
        'Memory of the server for data shown by pages opened later; the oldest are dropped.',
        unit='MB',
        minimum=50,
        maximum=16000,
        read_only=True,
    )
    save: str = parameter(
        '', 'New .rrd file to write instead of serving a page; empty serves a page.', read_only=True
    )
    reference_topic: str = parameter(
        REFERENCE, 'Topic of the reference force (WrenchStamped).', read_only=True
    )


@dataclass(frozen=True)
class SupervisorParameters:
    """Parameters of the supervisor of a simulated grasp (`mixtac up slip`)."""

    knock_every: float = parameter(
        8.0,
        'Simulation only: smallest time between impacts on the object while slip control is '
        'enabled; 0 for no impacts.',
        unit='s',
        minimum=0.0,
        maximum=3600.0,
    )
