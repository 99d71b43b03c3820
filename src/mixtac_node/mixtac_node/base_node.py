# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every node shares: QoS profiles, declared parameters, the run loop."""

from __future__ import annotations

import copy
import dataclasses
import signal
import sys
from typing import TYPE_CHECKING, Any, TypeVar

import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions

from mixtac_events.errors import MixtacError
from mixtac_node.parameters import ParameterError, ParameterSpec, build, specs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


T = TypeVar('T')


def _best_effort(depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT
    )


QOS_EVENTS = _best_effort(1000)
"""Event packets: what every consumer of event_camera_msgs subscribes with."""
QOS_FORCE = _best_effort(100)
"""Force, slip, reference wrench: 500 to 1000 Hz, too fast for the sensor-data depth of 5."""
QOS_SENSOR = _best_effort(10)
"""Frames, camera information, IMU."""
QOS_LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The latest value for late joiners (clock fit, camera clock)."""


class OverridableQos:
    """Mixin, before rclpy's node class: QoS of its topics can be set by parameters.

    Publishers and subscriptions take history, depth and reliability from the parameters
    `qos_overrides.TOPIC.publisher.*` and `qos_overrides.TOPIC.subscription.*` where those are given
    (https://design.ros2.org/articles/qos_configurability.html); lifecycle publishers as well.
    """

    def create_publisher(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a publisher whose QoS can be overridden."""
        return super().create_publisher(kind, topic, *_own(args), **_overridable(topic, options))  # type: ignore[misc]

    def create_subscription(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a subscription whose QoS can be overridden."""
        return super().create_subscription(kind, topic, *_own(args), **_overridable(topic, options))  # type: ignore[misc]

    def create_lifecycle_publisher(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a lifecycle publisher whose QoS can be overridden."""
        options = _overridable(topic, options)
        return super().create_lifecycle_publisher(kind, topic, *_own(args), **options)  # type: ignore[misc]


OWN_OF_RCLPY = ('/parameter_events', '/rosout', '/clock')


def _own(values: Iterable[Any]) -> list[Any]:
    # rclpy writes overrides into the profile that it is given: those of others stay as they are.
    return [copy.copy(value) if isinstance(value, QoSProfile) else value for value in values]


def _overridable(topic: str, options: dict[str, Any]) -> dict[str, Any]:
    if topic in OWN_OF_RCLPY:
        # They come before a node can have parameters.
        return options
    own = dict(zip(options, _own(options.values()), strict=True))
    return {'qos_overriding_options': QoSOverridingOptions.with_default_policies(), **own}


def declare(
    node: Any,  # noqa: ANN401
    schema: type[T],
    on_change: Callable[[T], None] | None = None,
) -> T:
    """Declare a schema's parameters on a node and return their values.

    Values are checked before anything uses them; later changes are checked as a whole, handed to
    `on_change` and refused with its message if that raises a MixtacError.

    Args:
        node: An rclpy node (lifecycle or not).
        schema: Parameter dataclass.
        on_change: Applies a new set of values; None makes all parameters read-only at run time.

    Raises:
        ParameterError: A start value is not allowed.
    """
    declared = specs(schema)
    for spec in declared:
        # Read-only is enforced below, where the refusal can name the remedy.
        try:
            node.declare_parameter(spec.name, spec.default, _descriptor(spec))
        except InvalidParameterValueException as error:
            raise ParameterError(' '.join(str(error).split())) from error
    names = {spec.name: spec for spec in declared}
    current = build(schema, {name: node.get_parameter(name).value for name in names})

    def apply(parameters: list[Any]) -> SetParametersResult:
        nonlocal current
        changes = {p.name: p.value for p in parameters if p.name in names}
        fixed = [n for n in changes if names[n].read_only or on_change is None]
        if fixed:
            reason = f'parameter {fixed[0]} is fixed while the node runs; restart with a new value'
            return SetParametersResult(successful=False, reason=reason)
        try:
            wanted = build(schema, {**dataclasses.asdict(current), **changes})  # type: ignore[call-overload]
            if changes and on_change is not None:
                on_change(wanted)
        except MixtacError as error:
            return SetParametersResult(successful=False, reason=str(error))
        current = wanted
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(apply)
    return current


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    text = f'{spec.description} [{spec.unit}]' if spec.unit else spec.description
    # Dynamic typing lets `spec.check` accept 1 for 1.0 and name the remedy for the rest.
    descriptor = ParameterDescriptor(name=spec.name, description=text, dynamic_typing=True)
    if spec.choices:
        descriptor.additional_constraints = 'one of ' + ', '.join(map(str, spec.choices))
    if spec.minimum is None or spec.maximum is None or isinstance(spec.default, (bool, str)):
        return descriptor
    if isinstance(spec.default, int):
        descriptor.integer_range = [
            IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)
        ]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(spec.minimum), to_value=float(spec.maximum))
        ]
    return descriptor


def run(node_class: Callable[[], Any], args: list[str] | None = None) -> int:
    """Run one node until SIGINT or SIGTERM, then close it; see `run_together`.

    Args:
        node_class: Makes the node; called after `rclpy.init`.
        args: ROS arguments, `sys.argv` if None.

    Returns:
        Exit status: 0 after a signal, 1 with one line on stderr after a MixtacError.
    """
    return run_together(lambda: [node_class()], args)


def run_together(make_nodes: Callable[[], list[Any]], args: list[str] | None = None) -> int:
    """Run nodes in one executor until SIGINT or SIGTERM, then close them, the last one first.

    A node may have a `close()` method: it ends threads and devices before the node is destroyed.
    It may have a `check()` method: called several times a second, and a MixtacError from it ends
    the process as one from its construction does.

    Args:
        make_nodes: Makes the nodes; called after `rclpy.init`.
        args: ROS arguments, `sys.argv` if None.

    Returns:
        Exit status: 0 after a signal, 1 with one line on stderr after a MixtacError.
    """
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    stopping = False

    def stop(_signum: int, _frame: object) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    nodes: list[Any] = []
    try:
        nodes = make_nodes()
        executor = EventsExecutor()
        for node in nodes:
            executor.add_node(node)
        checks = [node.check for node in nodes if hasattr(node, 'check')]
        while not stopping and rclpy.ok():
            # spin() of this executor never calls back in the wheels of Jazzy; spin_once does.
            executor.spin_once(timeout_sec=0.2)
            # Not in a timer: the executor would print a traceback before the one line.
            for check in checks:
                check()
    except MixtacError as error:
        print(f'error: {error}', file=sys.stderr)
        return 1
    except ExternalShutdownException:
        return 0
    finally:
        for node in reversed(nodes):
            if hasattr(node, 'close'):
                node.close()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
