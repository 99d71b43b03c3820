# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The process that holds several nodes, and the command that starts it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_bringup.errors import GraphError
from mixtac_bringup.graph import NodeSpec, config_file, executable, yaml_value

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

MEMBERS = ('driver', 'fger')


@dataclass(frozen=True)
class SensorProcess(NodeSpec):
    """Driver and estimator in one process.

    Attributes:
        members: Its nodes as they would be in processes of their own.
    """

    members: tuple[NodeSpec, ...] = ()

    def command(
        self, namespace: str, params_file: Path | None = None, log_level: str = 'info'
    ) -> list[str]:
        """Return the command line of the process; see `NodeSpec.command`.

        Raises:
            GraphError: See there, or two nodes have an override of the same name.
        """
        arguments = ['--ros-args', '-r', f'__ns:=/{namespace.strip("/")}']
        arguments += ['--log-level', log_level]
        files = [config_file(f'{member.name}.yaml') for member in self.members]
        for file in [*files, params_file] if params_file is not None else files:
            arguments += ['--params-file', str(file)]
        for name, value in self._overrides().items():
            arguments += ['-p', f'{name}:={yaml_value(value)}']
        return [str(executable(self.package, self.executable)), *arguments]

    def _overrides(self) -> dict[str, object]:
        """Return what all nodes of the process are told; each takes what it declares."""
        every: dict[str, object] = {}
        for member in self.members:
            twice = sorted(set(every) & set(member.overrides))
            if twice:
                raise GraphError(
                    f'parameter {twice[0]} is set for two nodes of one process: set it in a '
                    'parameter file, under the name of its node'
                )
            every |= member.overrides
        return every


def in_one_process(nodes: Sequence[NodeSpec]) -> list[NodeSpec]:
    """Return a graph with driver and estimator in one process.

    The virtual sensor stays a process of its own: it stands for a device, and its computations
    would take the interpreter's lock from the nodes.

    Args:
        nodes: Graph of separate processes, see `mixtac_bringup.graph.sensor_graph`.
    """
    members = tuple(node for node in nodes if node.name in MEMBERS)
    together = SensorProcess(
        'mixtac_bringup', 'sensor_node', 'fger', lifecycle=True, members=members
    )
    return [*(node for node in nodes if node not in members), together]
