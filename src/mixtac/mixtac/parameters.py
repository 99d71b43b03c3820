# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes view and supervisor."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_core.node.parameters import fixed
from mixtac_core.node.topics import REFERENCE


@dataclass(frozen=True)
class ViewParameters:
    """Parameters of the live view node.

    Attributes:
        rate: Pictures per second; each shows all events since the previous one.
        history: Time span of the plot.
        port: TCP port of the page on 127.0.0.1; 0 selects any free one.
        data_port: TCP port on 127.0.0.1 from which the page reads its data; 0 selects any free one.
        memory: Memory of the server for data shown by pages opened later; the oldest are dropped.
        save: New .rrd file to write instead of serving a page; empty serves a page.
        reference_topic: Topic of the reference force (WrenchStamped).
    """

    rate: float = fixed(20.0, unit='Hz', within=(1.0, 60.0))
    history: float = fixed(10.0, unit='s', within=(1.0, 600.0))
    port: int = fixed(9090, within=(0, 65535))
    data_port: int = fixed(0, within=(0, 65535))
    memory: int = fixed(300, unit='MB', within=(50, 16000))
    save: str = fixed('')
    reference_topic: str = fixed(REFERENCE)


@dataclass(frozen=True)
class SupervisorParameters:
    """Parameters of the supervisor of a simulated grasp (`mixtac up slip`).

    Attributes:
        knock_every: Simulation only: smallest time between impacts on the object while slip control
            is enabled; 0 for no impacts.
        figure: File for a figure of the latest impact; empty for none.
    """

    knock_every: float = fixed(1.0, unit='s', within=(0.0, 3600.0))
    figure: str = fixed('')
