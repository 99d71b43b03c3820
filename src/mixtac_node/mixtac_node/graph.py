# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The nodes of a sensor: which there are, and the command that starts each of them.

`mixtac up`, the launch files and the benchmarks read this description.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)

from mixtac_node.process import GraphError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One node process.

    Attributes:
        package: Package that installs the executable.
        executable: Name of the executable, which ends in `_node`.
        name: Node name.
        lifecycle: True where the node waits to be configured and activated.
        overrides: Parameter values that win over the parameter files.
    """

    package: str
    executable: str
    name: str
    lifecycle: bool = False
    overrides: Mapping[str, object] = field(default_factory=dict)

    def command(
        self, namespace: str, params_file: Path | None = None, log_level: str = 'info'
    ) -> list[str]:
        """Return the command line of this node.

        Args:
            namespace: ROS namespace.
            params_file: File whose values win over the shipped ones.
            log_level: Severity from which the node logs.

        Raises:
            GraphError: The package is not in the workspace.
        """
        files = [config_file(f'{self.name}.yaml')]
        if params_file is not None:
            files.append(params_file)
        arguments = ['--ros-args', '-r', f'__ns:=/{namespace.strip("/")}']
        arguments += ['-r', f'__node:={self.name}', '--log-level', log_level]
        for file in files:
            arguments += ['--params-file', str(file)]
        for name, value in self.overrides.items():
            arguments += ['-p', f'{name}:={yaml_value(value)}']
        return [str(executable(self.package, self.executable)), *arguments]


def executable(package: str, name: str) -> Path:
    """Return the path of an installed executable.

    Raises:
        GraphError: The package or executable is not installed.
    """
    try:
        path = Path(get_package_prefix(package)) / 'lib' / package / name
    except PackageNotFoundError as error:
        raise GraphError(f'package {package} is not built: run `make setup`') from error
    if not path.exists():
        raise GraphError(f'{package} installs no executable {name}: run `make setup`')
    return path


def config_file(name: str) -> Path:
    """Return the path of a shipped parameter file."""
    return Path(get_package_share_directory('mixtac_bringup')) / 'config' / name


def is_virtual(device: str) -> bool:
    """Tell whether a device is the virtual sensor."""
    return device.partition(':')[0] == 'virtual'


def sensor_graph(
    device: str,
    *,
    driver: Mapping[str, object] | None = None,
    estimator: Mapping[str, object] | None = None,
    virtual_sensor: Mapping[str, object] | None = None,
) -> list[NodeSpec]:
    """Return the nodes from the camera to the force.

    Args:
        device: `davis346` or `virtual`; the driver says what else it knows.
        driver: Overrides of the driver's parameters.
        estimator: Overrides of FGER-Net's parameters.
        virtual_sensor: Overrides of the virtual sensor's parameters.
    """
    nodes = []
    if is_virtual(device):
        nodes.append(
            NodeSpec(
                'mixtac_sim',
                'virtual_sensor_node',
                'virtual_sensor',
                overrides={**_socket(device), **(virtual_sensor or {})},
            )
        )
    nodes.append(
        NodeSpec(
            'mixtac_driver',
            'driver_node',
            'driver',
            overrides={'device': device, **(driver or {})},
        )
    )
    nodes.append(
        NodeSpec(
            'mixtac_fger', 'fger_node', 'fger', lifecycle=True, overrides=dict(estimator or {})
        )
    )
    return nodes


def _socket(device: str) -> dict[str, object]:
    path = device.partition(':')[2]
    return {'socket': path} if path else {}


def yaml_value(value: object) -> str:
    """Return a parameter value as YAML for the command line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("'", "''")
        return f"'{escaped}'"
    return repr(value)


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
        nodes: Graph of separate processes, see `mixtac_node.graph.sensor_graph`.
    """
    members = tuple(node for node in nodes if node.name in MEMBERS)
    together = SensorProcess('mixtac_cli', 'sensor_node', 'fger', lifecycle=True, members=members)
    return [*(node for node in nodes if node not in members), together]


def recorder(output: Path) -> NodeSpec:
    """Return the node that records the sensor's topics to a new bag."""
    return NodeSpec('mixtac_cli', 'recorder_node', 'recorder', overrides={'output': str(output)})
