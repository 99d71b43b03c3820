# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The nodes of a sensor: which there are, and the command that starts each of them.

`mixtac up`, the launch files and the benchmarks read this description.
"""

from __future__ import annotations

import difflib
import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)

from mixtac_node.files import read_data
from mixtac_node.process import GraphError
from mixtac_node.topics import DEFAULT_NAMESPACE, REFERENCE, TOPICS, Topic, absolute


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One node process.

    Attributes:
        package: Package that installs the executable.
        executable: Name of the executable, which ends in `_node`.
        name: Node name.
        lifecycle: True if the node waits to be configured and activated.
        required: True if a launch file ends the graph when this process ends.
        overrides: Parameter values that take precedence over the parameter files.
        files: Nodes whose shipped parameter files the process reads; empty for its own only.
    """

    package: str
    executable: str
    name: str
    lifecycle: bool = False
    required: bool = False
    overrides: Mapping[str, object] = field(default_factory=dict)
    files: tuple[str, ...] = ()

    def parameter_files(self, params_file: Path | None = None) -> list[Path]:
        """Return the parameter files of this process; later ones take precedence.

        Args:
            params_file: File that overrides the shipped ones.

        Raises:
            GraphError: A file does not exist, or sets an unknown parameter.
            FileError: The file is not YAML.
        """
        shipped = [config_file(f'{name}.yaml') for name in self.files or (self.name,)]
        if params_file is None:
            return shipped
        check_parameters(params_file)
        return [*shipped, params_file]

    def ros_arguments(self, params_file: Path | None = None, log_level: str = 'info') -> list[str]:
        """Return the ROS arguments of this process except for its name and namespace.

        Overrides are `-p` arguments, which reach every node of the process.

        Args:
            params_file: File that overrides the shipped ones.
            log_level: Lowest severity that the node logs.

        Raises:
            GraphError: A parameter file does not exist.
        """
        arguments = ['--ros-args', '--log-level', log_level]
        for file in self.parameter_files(params_file):
            arguments += ['--params-file', str(file)]
        for name, value in self.overrides.items():
            arguments += ['-p', f'{name}:={yaml_value(value)}']
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
            GraphError: The package is not built, or a parameter file does not exist.
        """
        names = ['-r', f'__ns:=/{namespace.strip("/")}', '-r', f'__node:={self.name}']
        return [
            str(executable(self.package, self.executable)),
            *self.ros_arguments(params_file, log_level),
            *names,
        ]


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
    """Return the path of a shipped configuration file.

    Raises:
        GraphError: mixtac_bringup, which installs these files, is not built.
    """
    # Not in package.xml: mixtac_bringup depends on this package, colcon refuses circles.
    try:
        share = get_package_share_directory('mixtac_bringup')
    except PackageNotFoundError as error:
        raise GraphError('package mixtac_bringup is not built: run `make setup`') from error
    return Path(share) / 'config' / name


def check_parameters(path: Path) -> None:
    """Check that a parameter file sets only parameters that our nodes have.

    ROS ignores unknown ones. Sections of nodes that are not ours may hold anything.

    Args:
        path: The file.

    Raises:
        GraphError: It does not exist or is no parameter file, or a name in it is unknown.
        FileError: It is not YAML.
    """
    if not path.is_file():
        raise GraphError(f'no parameter file {path}')
    known = _shipped_parameters(config_file('fger.yaml').parent)
    for section, values in _sections(read_data(path), '', path):
        node = section.rpartition('/')[2]
        if '*' in node:
            names = frozenset(name for each in known.values() for name in each)
        elif node in known:
            names = known[node]
        else:
            if near := difflib.get_close_matches(node, known, 1, 0.75):
                raise GraphError(f'{path}: no node {node!r}', remedy=f'did you mean {near[0]}?')
            continue
        unknown = sorted(
            name
            for name in map(str, values)
            if name not in names and name.partition('.')[0] not in _OF_ROS
        )
        if unknown:
            near = difflib.get_close_matches(unknown[0], names, 1)
            raise GraphError(
                f'{path}: {section} has no parameter {unknown[0]}',
                remedy=f'did you mean {near[0]}?' if near else 'see docs/reference.md',
            )


_OF_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
"""Parameters that every node has."""
_VALUES = 'ros__parameters'


@functools.cache
def _shipped_parameters(folder: Path) -> dict[str, frozenset[str]]:
    """Return the names of the parameters of each node, by the name of the node."""
    found = {}
    for path in folder.glob('*.yaml'):
        content = read_data(path)
        values = content.get(f'/**/{path.stem}') if isinstance(content, dict) else None
        if values is not None:
            found[path.stem] = frozenset(values[_VALUES])
    return found


def _sections(content: Any, name: str, path: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:  # noqa: ANN401
    """Yield the name of each node in a parameter file and its parameters."""
    if not isinstance(content, dict) or not isinstance(content.get(_VALUES, {}), dict):
        raise GraphError(
            f'{path} is no parameter file{f" at {name}" if name else ""}',
            remedy=f'write NODE: {_VALUES}: with one parameter per line',
        )
    if _VALUES in content:
        yield name, content[_VALUES]
        return
    for key, value in content.items():
        yield from _sections(value, f'{name}/{key}' if name else str(key), path)


NO_DRIVER = 'none'
"""Device of a graph without a driver."""


def is_virtual(device: str) -> bool:
    """Return whether a device is the virtual sensor."""
    return device.partition(':')[0] == 'virtual'


def is_camera(device: str) -> bool:
    """Return whether a device is a real camera: neither the virtual sensor nor a recording."""
    return not is_virtual(device) and not Path(device).exists() and '/' not in device


def sensor_graph(
    device: str,
    *,
    driver: Mapping[str, object] | None = None,
    estimator: Mapping[str, object] | None = None,
    virtual_sensor: Mapping[str, object] | None = None,
    single_process: bool = False,
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
        single_process: Run driver and estimator in one process.
        slip: Parameters of slip control, which then runs in the driver's process; None does without
            it.
        align: Add the nodes that align the reference force and publish the error against it.
        view: Add the live view.
        simulated_time: All nodes but the driver follow `/clock`, which the driver publishes of a
            recording, the virtual sensor of its simulation, and a bag player without a driver.
        reference_topic: Topic of the reference force; empty keeps that of the parameter files.

    Raises:
        GraphError: The options contradict each other.
    """
    reference = {'reference_topic': reference_topic} if reference_topic else {}
    nodes = []
    if is_virtual(device):
        # A slow host slows the clock of all nodes down.
        slow = {'publish_clock': True, 'slow_host': 'wait'}
        clock: dict[str, object] = {**slow} if simulated_time else {}
        path = device.partition(':')[2]
        socket = {'socket': path} if path else {}
        nodes.append(
            NodeSpec(
                'mixtac_sim',
                'virtual_sensor_node',
                'virtual_sensor',
                required=True,
                overrides={**socket, **reference, **clock, **(virtual_sensor or {})},
            )
        )
    if view:
        nodes.append(live_view())
    if align:
        nodes += [
            NodeSpec('mixtac_alignment', 'alignment_node', 'alignment', overrides=reference),
            NodeSpec('mixtac_alignment', 'force_error_node', 'force_error'),
        ]
    clock = {'playback_clock': True} if simulated_time and not is_virtual(device) else {}
    follow = {'use_sim_time': True} if simulated_time else {}
    nodes[:] = [
        each
        if each.name == 'virtual_sensor'
        else replace(each, overrides={**each.overrides, **follow})
        for each in nodes
    ]
    # Nothing touches the virtual sensor before it is asked to, nor a sensor that is being recorded.
    recorded = simulated_time or not is_camera(device)
    free = {'assume_free': True} if recorded else {}
    estimator_node = NodeSpec(
        'mixtac_fger',
        'fger_node',
        'fger',
        lifecycle=True,
        required=True,
        overrides={**free, **follow, **(estimator or {})},
    )
    if device == NO_DRIVER:
        if driver or single_process or slip is not None:
            together = 'single_process' if single_process else 'slip control in its process'
            what = next(iter(driver or ()), together)
            raise GraphError(
                f'{what} is for a driver, which device {NO_DRIVER} leaves out',
                remedy='name a device, or leave it out',
            )
        return [*nodes, estimator_node]
    driver_node = NodeSpec(
        'mixtac_driver',
        'driver_node',
        'driver',
        required=True,
        overrides={'device': device, **clock, **(driver or {})},
    )
    estimation = [driver_node, estimator_node]
    if (single_process or slip is not None) and simulated_time:
        raise GraphError(
            'simulated time needs the driver in a process of its own: it stays on the host clock',
            remedy='leave out single_process, or start slip control by itself',
        )
    if slip is not None:
        if single_process:
            raise GraphError(
                "slip control and estimator cannot both run in the driver's process: one would "
                'hold up the other',
                remedy='leave out single_process',
            )
        answering = _in_one_process('slip_sensor_node', [driver_node, slip_control(slip)])
        return [*nodes, answering, estimator_node]
    return [
        *nodes,
        *([_in_one_process('sensor_node', estimation)] if single_process else estimation),
    ]


def _in_one_process(executable_name: str, nodes: Sequence[NodeSpec]) -> NodeSpec:
    """Return one process for driver and another node, by whose name it is known.

    Every node takes the overrides that it declares.
    """
    overrides: dict[str, object] = {}
    for node in nodes:
        if twice := sorted(set(overrides) & set(node.overrides)):
            raise GraphError(
                f'parameter {twice[0]} is set for two nodes of one process: set it in a '
                'parameter file, below the name of its node'
            )
        overrides |= node.overrides
    return replace(
        nodes[-1],
        package='mixtac_cli',
        executable=executable_name,
        overrides=overrides,
        files=tuple(node.name for node in nodes),
    )


def slip_control(overrides: Mapping[str, object]) -> NodeSpec:
    """Return the slip control node.

    Args:
        overrides: Parameters, such as `arm` and `detector`.
    """
    return NodeSpec(
        'mixtac_slip_control',
        'slip_control_node',
        'slip_control',
        required=True,
        overrides=overrides,
    )


def recorder(output: Path, reference_topic: str = '', exclude: Sequence[Topic] = ()) -> NodeSpec:
    """Return the node that records the sensor's topics to a new bag.

    Args:
        output: Folder of the bag.
        reference_topic: Topic of the reference force; empty keeps that of the parameter files.
        exclude: Topics that are not recorded; without any, as the parameter files have it.
    """
    overrides = {'output': str(output)}
    if exclude:
        overrides['exclude'] = ' '.join(each.name for each in exclude)
    if reference_topic:
        overrides['reference_topic'] = reference_topic
    return NodeSpec('mixtac_cli', 'recorder_node', 'recorder', overrides=overrides)


ROSBAG2_DEPTH = 1000
"""Least queue depth of `ros2 bag record` for the sensor's topics; its default is 10."""


def rosbag2_qos(
    namespace: str = DEFAULT_NAMESPACE, reference_topic: str = REFERENCE
) -> dict[str, dict[str, object]]:
    """Return the QoS overrides with which `ros2 bag record` loses no messages, by topic.

    Args:
        namespace: ROS namespace of the sensor.
        reference_topic: Topic of the reference force.
    """
    overrides: dict[str, dict[str, object]] = {}
    for topic in TOPICS:
        name = reference_topic if topic.name == REFERENCE else topic.name
        overrides[absolute(name, namespace)] = {
            'history': 'keep_last',
            'depth': 1 if topic.latched else max(ROSBAG2_DEPTH, 5 * topic.depth),
            'reliability': 'reliable' if topic.reliable else 'best_effort',
            'durability': 'transient_local' if topic.latched else 'volatile',
        }
    return overrides


def live_view(port: int | None = None, save: Path | None = None) -> NodeSpec:
    """Return the node of the live view.

    Args:
        port: Port of the page on 127.0.0.1, 0 for any free one; None keeps that of the parameter
            files.
        save: New .rrd file to write instead of serving a page.
    """
    overrides: dict[str, object] = {} if port is None else {'port': port}
    if save is not None:
        overrides['save'] = str(save)
    return NodeSpec('mixtac_cli', 'view_node', 'view', overrides=overrides)


def yaml_value(value: object) -> str:
    """Return a parameter value as YAML for the command line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("'", "''")
        return f"'{escaped}'"
    return repr(value)
