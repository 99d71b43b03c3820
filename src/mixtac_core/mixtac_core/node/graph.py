# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The nodes of a sensor, and the command that starts each of them.

`mixtac up`, the launch files and the benchmarks read this description. As a program, this module
runs the node of the module that its argument names, as its executable does.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mixtac_core.node.files import share
from mixtac_core.node.parameters import yaml_scalar
from mixtac_core.node.process import GraphError


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One node process.

    Attributes:
        module: Module whose `main` runs the node; its last name ends in `_node`.
        name: Node name.
        required: True if a launch file ends the graph when this process ends.
        overrides: Parameter values that take precedence over the parameter files.
    """

    module: str
    name: str
    required: bool = False
    overrides: Mapping[str, object] = field(default_factory=dict)

    @property
    def package(self) -> str:
        """Package that installs the executable."""
        return self.module.partition('.')[0]

    @property
    def executable(self) -> str:
        """Name of the executable."""
        return self.module.rpartition('.')[2]

    def ros_arguments(self, params_file: Path | None = None, log_level: str = 'info') -> list[str]:
        """Return the ROS arguments of this process except for its name and namespace.

        Overrides are `-p` arguments, which reach every node of the process.

        Args:
            params_file: File that overrides the shipped ones.
            log_level: Lowest severity that the node logs.

        Raises:
            GraphError: The parameter file does not exist.
        """
        if params_file is not None and not params_file.is_file():
            raise GraphError(f'no parameter file {params_file}')
        arguments = ['--ros-args', '--log-level', log_level]
        for file in filter(None, (config_file(f'{self.name}.yaml'), params_file)):
            arguments += ['--params-file', str(file)]
        for name, value in self.overrides.items():
            arguments += ['-p', f'{name}:={yaml_scalar(value)}']
        return arguments

    def command(
        self, namespace: str, params_file: Path | None = None, log_level: str = 'info'
    ) -> list[str]:
        """Return the command line of this node.

        Args:
            namespace: ROS namespace.
            params_file: File that overrides the shipped ones.
            log_level: Lowest severity that the node logs.

        Raises:
            GraphError: A parameter file does not exist.
        """
        names = ['-r', f'__ns:=/{namespace.strip("/")}', '-r', f'__node:={self.name}']
        return [
            *(sys.executable, '-m', 'mixtac_core.node.graph', self.module),
            *self.ros_arguments(params_file, log_level),
            *names,
        ]


def config_file(name: str) -> Path:
    """Return the path of a shipped configuration file.

    Raises:
        GraphError: mixtac_bringup, which has these files, is not installed.
    """
    # Not in package.xml: mixtac_bringup depends on this package, colcon refuses circles.
    return share('mixtac_bringup') / 'config' / name


NO_DRIVER = 'none'
"""Device of a graph without a driver."""
PATIENCE_S = 600.0
"""Time without data after which the driver opens a simulated camera again [s]."""


def is_virtual(device: str) -> bool:
    """Return whether a device is the virtual sensor."""
    return device.partition(':')[0] == 'virtual'


def sensor_graph(
    device: str,
    *,
    driver: Mapping[str, object] | None = None,
    estimator: Mapping[str, object] | None = None,
    virtual_sensor: Mapping[str, object] | None = None,
    slip: Mapping[str, object] | None = None,
    align: bool = False,
    view: bool = False,
    simulated_time: bool = False,
    reference_topic: str = '',
) -> list[NodeSpec]:
    """Return the nodes from the camera to the force, in the order in which they are started.

    Args:
        device: `davis346`, `virtual`, `virtual:SOCKET`, the path of a recording, or `none`: other
            programs publish the driver's topics, as `ros2 bag play` does.
        driver: Overrides of the driver's parameters.
        estimator: Overrides of the force estimator's parameters.
        virtual_sensor: Overrides of the virtual sensor's parameters.
        slip: Parameters of slip control; None leaves it out.
        align: Add the nodes that align the reference force and publish the error against it.
        view: Add the live view.
        simulated_time: All nodes but the driver follow `/clock`. The driver publishes it from a
            recording, the virtual sensor from its simulation, a bag player without a driver.
        reference_topic: Topic of the reference force; empty keeps the topic of the parameter files.
    """
    reference = {'reference_topic': reference_topic} if reference_topic else {}
    follow = {'use_sim_time': True} if simulated_time else {}
    nodes = []
    if is_virtual(device):
        path = device.partition(':')[2]
        socket = {'socket': path} if path else {}
        # A slow host slows the clock of all nodes down.
        clock = {'publish_clock': True} if simulated_time else {}
        own = {**socket, **reference, **clock, **(virtual_sensor or {})}
        nodes.append(node('mixtac_sim', 'virtual_sensor', required=True, overrides=own))
    if view:
        nodes.append(node('mixtac', 'view', overrides=follow))
    if align:
        nodes += [
            node('mixtac_fger.alignment', 'alignment', overrides={**reference, **follow}),
            node('mixtac_fger.alignment', 'force_error', overrides=follow),
        ]
    if device != NO_DRIVER:
        clock = {'playback_clock': True} if simulated_time and not is_virtual(device) else {}
        # While a slow host is behind, a simulated camera sends nothing.
        patient = {'stream_timeout': PATIENCE_S} if is_virtual(device) else {}
        own = {'device': device, **patient, **clock, **(driver or {})}
        nodes.append(node('mixtac_driver.node', 'driver', required=True, overrides=own))
    if slip is not None:
        nodes.append(slip_control({**follow, **slip}))
    # Nothing touches the virtual sensor before it is asked to, nor a sensor that is being recorded.
    recorded = simulated_time or is_virtual(device) or Path(device).exists() or '/' in device
    own = {'assume_free': True} if recorded else {}
    own |= {'autostart': True, **follow, **(estimator or {})}
    nodes.append(node('mixtac_fger', 'fger', required=True, overrides=own))
    return nodes


def node(where: str, name: str, **options: Any) -> NodeSpec:  # noqa: ANN401
    """Return the node of the module `<name>_node` of a package; options as in `NodeSpec`."""
    return NodeSpec(f'{where}.{name}_node', name, **options)


def slip_control(overrides: Mapping[str, object]) -> NodeSpec:
    """Return the slip control node.

    Args:
        overrides: Parameters, such as `arm` and `law`.
    """
    return node('mixtac_slip_control', 'slip_control', required=True, overrides=overrides)


if __name__ == '__main__':
    del sys.argv[0]
    sys.exit(importlib.import_module(sys.argv[0]).main())
