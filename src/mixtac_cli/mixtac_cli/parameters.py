# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes recorder, view and supervisor."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import fixed, parameter
from mixtac_node.topics import REFERENCE


@dataclass(frozen=True)
class RecorderParameters:
    """Parameters of the recorder node."""

    output: str = fixed('', 'Folder of the new bag; it must not exist.')
    reference_topic: str = fixed(REFERENCE, 'Topic of the reference force (WrenchStamped).')
    profile: str = fixed('', 'Kind of motion, for dataset.yaml, for example static.')
    split: str = fixed(
        '',
        'Split of the recording, for dataset.yaml.',
        choices=('', 'train', 'test'),
    )


@dataclass(frozen=True)
class ViewParameters:
    """Parameters of the live view node."""

    rate: float = fixed(
        20.0,
        'Pictures per second. Samples between two pictures are thinned; peaks are kept.',
        unit='Hz',
        within=(1.0, 60.0),
    )
    history: float = fixed(10.0, 'Time span of the plots.', unit='s', within=(1.0, 600.0))
    port: int = fixed(
        9090,
        'TCP port of the page on 127.0.0.1; 0 selects any free one.',
        within=(0, 65535),
    )
    data_port: int = fixed(
        0,
        'TCP port on 127.0.0.1 from which the page reads its data; 0 selects any free one.',
        within=(0, 65535),
    )
    memory: int = fixed(
        300,
        'Memory of the server for data shown by pages opened later; the oldest are dropped.',
        unit='MB',
        within=(50, 16000),
    )
    save: str = fixed('', 'New .rrd file to write instead of serving a page; empty serves a page.')
    reference_topic: str = fixed(REFERENCE, 'Topic of the reference force (WrenchStamped).')


@dataclass(frozen=True)
class SupervisorParameters:
    """Parameters of the supervisor of a simulated grasp (`mixtac up slip`)."""

    knock_every: float = parameter(
        8.0,
        'Simulation only: smallest time between impacts on the object while slip control is '
        'enabled; 0 for no impacts.',
        unit='s',
        within=(0.0, 3600.0),
    )
