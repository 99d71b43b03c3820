# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every node shares: namespace, topics with their QoS, declared parameters, the run loop."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import faulthandler
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from mixtac_events.errors import MixtacError, error_line
from mixtac_node import topics
from mixtac_node.parameters import ParameterError, ParameterSpec, build, specs
from mixtac_node.process import STUCK_S, GraphError, claim_nodes, freeze_loaded
from mixtac_node.topics import DEFAULT_NAMESPACE, Topic, frame_id, message_class

T = TypeVar('T')
ENDING = (signal.SIGINT, signal.SIGTERM)
PATIENCE_S = 0.5
"""Time that the callback which a signal interrupts has to return; a compilation takes longer."""


CHECK_PERIOD_S = 0.2
"""Period at which nodes are checked, and signals looked at [s]."""


class Interrupted(BaseException):
    """Ends a callback that has not returned in time after a signal."""


def qos(topic: Topic, *, offered: bool = False) -> QoSProfile:
    """Return the QoS profile of a topic.

    Args:
        topic: The topic.
        offered: Return the publisher's, which is reliable, so that every subscription gets its
            messages (REP 2003); otherwise that of our subscriptions.
    """
    reliable = offered or topic.reliable
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(
            DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
        ),
    )


QOS_EVENTS = qos(topics.EVENTS)
"""Event packets: what every consumer of event_camera_msgs subscribes with."""
QOS_FORCE = qos(topics.FORCE)
"""Force, slip, reference wrench: 500 to 1000 Hz, too fast for the sensor-data depth of 5."""
QOS_SENSOR = qos(topics.IMAGE_RAW)
"""Frames, camera information, IMU."""
QOS_LATCHED = qos(topics.CLOCK_FIT)
"""The latest value for late joiners (clock fit, camera clock)."""


class BaseNode:
    """Mixin, before rclpy's node class (plain or lifecycle), of every Mixtac node.

    Nodes are in `DEFAULT_NAMESPACE` by default. Publishers and subscriptions take history, depth
    and reliability from the parameters `qos_overrides.TOPIC.publisher.*` and
    `qos_overrides.TOPIC.subscription.*` where those are given
    (https://design.ros2.org/articles/qos_configurability.html); lifecycle publishers as well.

    Args:
        name: Name of the node.
        namespace: Its namespace; remapping (`__ns`) takes precedence.
        options: Further arguments of rclpy's node class.
    """

    def __init__(
        self,
        name: str,
        *,
        namespace: str = DEFAULT_NAMESPACE,
        **options: Any,  # noqa: ANN401
    ) -> None:
        super().__init__(name, namespace=namespace, **options)  # type: ignore[call-arg]

    def publish_topic(self, topic: Topic, *, name: str = '', managed: bool = False) -> Any:  # noqa: ANN401
        """Create the publisher of a topic, with the topic's type and QoS.

        Args:
            topic: The topic.
            name: Other name for it, for example from a parameter; empty for the topic's own.
            managed: Create a lifecycle publisher, which publishes only while the node is active.
        """
        create = self.create_lifecycle_publisher if managed else self.create_publisher
        profile = qos(topic, offered=True)
        return create(message_class(topic.type_name), name or topic.name, profile)

    def subscribe_topic(
        self,
        topic: Topic,
        callback: Callable[[Any], None],
        *,
        name: str = '',
        raw: bool = False,
    ) -> Any:  # noqa: ANN401
        """Create a subscription to a topic, with the topic's type and QoS.

        Args:
            topic: The topic.
            callback: Called with each message.
            name: Other name for it, for example from a parameter; empty for the topic's own.
            raw: Pass the serialised message to the callback, as bytes.
        """
        kind = message_class(topic.type_name)
        return self.create_subscription(kind, name or topic.name, callback, qos(topic), raw=raw)

    def create_publisher(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a publisher whose QoS can be overridden."""
        return super().create_publisher(kind, topic, *_own(args), **_overridable(topic, options))  # type: ignore[misc]

    def create_subscription(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a subscription whose QoS can be overridden."""
        if topic == CLOCK:
            args = (_since_epoch(args[0]), *args[1:])
        return super().create_subscription(kind, topic, *_own(args), **_overridable(topic, options))  # type: ignore[misc]

    def create_service(self, kind: Any, name: str, callback: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a service; those that set parameters refuse values of unknown types."""
        if kind in {SetParameters, SetParametersAtomically}:
            callback = _of_known_types(callback)
        return super().create_service(kind, name, callback, **options)  # type: ignore[misc]

    def create_lifecycle_publisher(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:  # noqa: ANN401
        """Create a lifecycle publisher whose QoS can be overridden."""
        options = _overridable(topic, options)
        return super().create_lifecycle_publisher(kind, topic, *_own(args), **options)  # type: ignore[misc]


def answering(action: Callable[[Any], str]) -> Callable[[Any, Any], Any]:
    """Return the callback of a service whose answer is `success` and `message`.

    Args:
        action: Called with the request; returns what it did. A MixtacError is its refusal.
    """

    def callback(request: Any, response: Any) -> Any:  # noqa: ANN401
        try:
            response.success, response.message = True, action(request)
        except MixtacError as error:
            response.success, response.message = False, str(error)
        return response

    return callback


CLOCK = '/clock'
_TOPICS_OF_RCLPY = ('/parameter_events', '/rosout', CLOCK)


def _since_epoch(callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """Keep times before the epoch from rclpy's callback of `/clock`, which raises for them."""

    def on_clock(message: Any) -> None:  # noqa: ANN401
        if message.clock.sec >= 0:
            callback(message)

    return on_clock


def _of_known_types(callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Keep parameters of unknown types from rclpy's callback, which raises for them."""

    def on_set(request: Any, response: Any) -> Any:  # noqa: ANN401
        for each in request.parameters:
            if each.value.type > ParameterType.PARAMETER_STRING_ARRAY:
                reason = f'parameter {each.name!r} has the unknown type {each.value.type}'
                refusal = SetParametersResult(successful=False, reason=reason)
                if hasattr(response, 'results'):
                    response.results = [refusal] * len(request.parameters)
                else:
                    response.result = refusal
                return response
        return callback(request, response)

    return on_set


def _own(values: Iterable[Any]) -> list[Any]:
    # rclpy writes overrides into the profile that it is given, so each topic gets a copy.
    return [copy.copy(value) if isinstance(value, QoSProfile) else value for value in values]


def _overridable(topic: str, options: dict[str, Any]) -> dict[str, Any]:
    if topic in _TOPICS_OF_RCLPY:
        # Created before the node can have parameters.
        return options
    own = dict(zip(options, _own(options.values()), strict=True))
    return {'qos_overriding_options': QoSOverridingOptions.with_default_policies(), **own}


def declare(
    node: Any,  # noqa: ANN401
    schema: type[T],
    on_change: Callable[[T], None] | None = None,
) -> T:
    """Declare a schema's parameters on a node and return their values.

    Values are checked before they are used. Later changes are checked together and passed to
    `on_change`; if that raises a MixtacError, they are refused with its message. Frames get the
    prefix of the node's namespace, see `mixtac_node.topics.frame_id`.

    Args:
        node: An rclpy node (lifecycle or not).
        schema: Parameter dataclass.
        on_change: Applies a new set of values; None makes all parameters read-only at run time.

    Raises:
        ParameterError: A start value is not allowed.
    """
    declared = specs(schema)
    for spec in declared:
        # Read-only is enforced below, so that the refusal can name the remedy.
        try:
            node.declare_parameter(spec.name, spec.default, _descriptor(spec))
        except InvalidParameterValueException as error:
            raise ParameterError(' '.join(str(error).split())) from error
    names = {spec.name: spec for spec in declared}
    frames = {name for name in names if name.endswith('frame_id')}

    def built(values: dict[str, Any]) -> T:
        own = {name: frame_id(values[name], node.get_namespace()) for name in frames}
        return build(schema, {**values, **own})

    current = built({name: node.get_parameter(name).value for name in names})

    def apply(parameters: list[Any]) -> SetParametersResult:
        nonlocal current
        changes = {p.name: p.value for p in parameters if p.name in names}
        fixed = [n for n in changes if names[n].read_only or on_change is None]
        if fixed:
            reason = f'parameter {fixed[0]} is fixed while the node runs; restart with a new value'
            return SetParametersResult(successful=False, reason=reason)
        try:
            wanted = built({**dataclasses.asdict(current), **changes})  # type: ignore[call-overload]
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


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Name the cause where ROS 2 cannot start.

    Raises:
        GraphError: ROS 2 cannot read an argument, a parameter file or a variable; or SROS 2 is on,
            without keys or with a middleware without security.
    """
    try:
        yield
    except rclpy_implementation.RCLError as error:
        cause = ' '.join(str(error).split())
        if os.environ.get('ROS_SECURITY_ENABLE') != 'true':
            raise GraphError(
                f'ROS 2 cannot start: {cause}', remedy='correct what this names'
            ) from error
        raise GraphError(
            f'ROS_SECURITY_ENABLE is set, but ROS 2 cannot start securely: {cause}',
            remedy='read docs/security.md; the wheels have no security, an installed ROS 2 has',
        ) from error


class _Signals:
    """SIGINT and SIGTERM from now on.

    Attributes:
        received: Whether one has come. A callback, or the construction of a node, that still runs
            PATIENCE_S later ends with `Interrupted`.
        interrupted: Whether that has happened. Libraries may turn `Interrupted` into an exception
            of their own.
    """

    def __init__(self) -> None:
        self.received = self.interrupted = False
        signal.signal(signal.SIGALRM, self._interrupt)
        sys.unraisablehook = _unraisable
        for number in ENDING:
            signal.signal(number, self._receive)
        # The launch files start nodes with SIGINT blocked: no import ends in a traceback.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)

    def _receive(self, _signum: int, _frame: object) -> None:
        if not self.received:
            self.received = True
            signal.setitimer(signal.ITIMER_REAL, PATIENCE_S, PATIENCE_S)

    def _interrupt(self, _signum: int, _frame: object) -> None:
        self.interrupted = True
        raise Interrupted

    def ignore(self) -> None:
        """Ignore them while the process ends; its status would not be 0 otherwise."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)


def _unraisable(report: sys.UnraisableHookArgs) -> None:
    """Say nothing of a callback from C that is interrupted: the next interruption follows."""
    if not isinstance(report.exc_value, Interrupted):
        sys.__unraisablehook__(report)


def _close(nodes: list[Any]) -> None:
    for node in reversed(nodes):
        if hasattr(node, 'close'):
            node.close()
    for node in nodes:
        node.destroy_node()


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
    the process as one from its construction does. A callback that does not return ends the process
    after `STUCK_S` with a traceback of all threads: it is seen, and can be restarted.

    Args:
        make_nodes: Makes the nodes; called after `rclpy.init`.
        args: ROS arguments, `sys.argv` if None.

    Returns:
        Exit status: 0 after a signal, 1 with one line on stderr after a MixtacError.
    """
    signals = _Signals()
    nodes: list[Any] = []
    try:
        if signals.received:
            return 0
        with starting():
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            nodes = make_nodes()
        names = [node.get_fully_qualified_name() for node in nodes]
        _claims = claim_nodes(names, rclpy.get_default_context().get_domain_id())
        executor = EventsExecutor()
        for node in nodes:
            executor.add_node(node)
        checks = [node.check for node in nodes if hasattr(node, 'check')]
        freeze_loaded()
        watched_s = -STUCK_S
        while not signals.received and rclpy.ok():
            # Seldom: it waits for a thread to end, which on a busy host takes milliseconds.
            if time.monotonic() > watched_s + STUCK_S / 10:
                watched_s = time.monotonic()
                # Needs nothing of Python, whose lock a call that hangs in the middleware may hold.
                faulthandler.dump_traceback_later(STUCK_S, exit=True)
            # In the wheels of Jazzy, spin() of this executor never calls back. Not spin_once, which
            # returns after each callback.
            executor.spin_until_future_complete(Future(), timeout_sec=CHECK_PERIOD_S)
            # Not in a timer: the executor would print a traceback before the error line.
            for check in checks:
                check()
    except MixtacError as error:
        print(error_line(str(error)), file=sys.stderr)
        return 1
    except (ExternalShutdownException, Interrupted):
        return 0
    except Exception:
        if not signals.interrupted:
            raise
        return 0
    finally:
        faulthandler.cancel_dump_traceback_later()
        signals.ignore()
        _close(nodes)
        rclpy.try_shutdown()
    return 0
