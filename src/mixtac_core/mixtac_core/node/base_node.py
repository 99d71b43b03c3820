# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every node shares: topics with their QoS, declared parameters, the run loop."""

from __future__ import annotations

import contextlib
import dataclasses
import faulthandler
import gc
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import rclpy
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from mixtac_core.events.errors import MixtacError, error_line
from mixtac_core.node import topics
from mixtac_core.node.parameters import ParameterError, ParameterSpec, build, specs
from mixtac_core.node.process import STUCK_S, GraphError, freeze_loaded
from mixtac_core.node.topics import DEFAULT_NAMESPACE, Topic, frame_id, message_class

T = TypeVar('T')
ENDING = (signal.SIGINT, signal.SIGTERM)
PATIENCE_S = 1.0
"""Time that a running callback has after a signal; then it is interrupted [s]."""
CHECK_PERIOD_S = 0.2
"""Period at which a node is checked and signals are handled [s]."""
REARM_PERIOD_S = 0.1 * STUCK_S
"""Period at which the watchdog is restarted, which waits for a thread to end [s]."""


def qos(topic: Topic, *, offered: bool = False) -> QoSProfile:
    """Return the QoS profile of a topic.

    Args:
        topic: The topic.
        offered: Return the profile of the publisher, which is reliable, so that every
            subscription matches it (REP 2003); otherwise the profile of our subscriptions.
    """
    reliable = offered or topic.reliable
    latched = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
    return QoSProfile(
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=latched,
    )


QOS_FORCE = qos(topics.FORCE)
"""Force, slip, reference wrench: 500 to 1000 Hz, too fast for the sensor-data depth of 5."""
QOS_SENSOR = qos(topics.IMAGE_RAW)
"""Frames, camera information, IMU."""


class BaseNode:
    """Mixin, before rclpy's node class (plain or lifecycle), of every Mixtac node.

    Nodes are in `DEFAULT_NAMESPACE` by default.

    Args:
        name: Name of the node.
        namespace: Its namespace; remapping (`__ns`) takes precedence.
        options: Further arguments of rclpy's node class.

    Attributes:
        progress: Called with every message; `run` has it restart the watchdog. On an overloaded
            host, messages may keep the executor from its timers for long.
    """

    create_publisher: Any
    create_lifecycle_publisher: Any
    create_subscription: Any
    progress: Callable[[], None] = staticmethod(lambda: None)

    def __init__(
        self,
        name: str,
        *,
        namespace: str = DEFAULT_NAMESPACE,
        **options: Any,  # noqa: ANN401
    ) -> None:
        super().__init__(name, namespace=namespace, **options)  # type: ignore[call-arg]

    def check(self) -> None:
        """Check the node: called several times a second; a MixtacError ends the process."""

    def close(self) -> None:
        """End threads and devices, before the node is destroyed."""

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

        def received(message: Any) -> None:  # noqa: ANN401
            self.progress()
            callback(message)

        kind = message_class(topic.type_name)
        return self.create_subscription(kind, name or topic.name, received, qos(topic), raw=raw)


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


def declare(
    node: Any,  # noqa: ANN401
    schema: type[T],
    on_change: Callable[[T], None] | None = None,
) -> T:
    """Declare a schema's parameters on a node and return their values.

    Values are checked before they are used. Later changes are checked together and passed to
    `on_change`; if that raises a MixtacError, they are refused with its message. Frames get the
    prefix of the node's namespace, see `mixtac_core.node.topics.frame_id`.

    Args:
        node: An rclpy node (lifecycle or not).
        schema: Parameter dataclass.
        on_change: Applies a new set of values; None makes all parameters read-only at run time.

    Raises:
        ParameterError: A start value is not allowed.
    """
    known = {spec.name: spec for spec in specs(schema)}
    # Read-only is enforced below, so that the refusal can name the remedy.
    declared = [(spec.name, spec.default, _descriptor(spec)) for spec in known.values()]
    try:
        given = node.declare_parameters('', declared)
    except InvalidParameterValueException as error:
        raise ParameterError(' '.join(str(error).split())) from error

    def built(values: dict[str, Any]) -> T:
        frames = {name: value for name, value in values.items() if name.endswith('frame_id')}
        own = {name: frame_id(value, node.get_namespace()) for name, value in frames.items()}
        return build(schema, {**values, **own})

    current = built({parameter.name: parameter.value for parameter in given})

    def apply(parameters: list[Any]) -> SetParametersResult:
        nonlocal current
        changes = {p.name: p.value for p in parameters if p.name in known}
        fixed = [name for name in changes if known[name].read_only or on_change is None]
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
    low, high = spec.minimum, spec.maximum
    if low is not None and high is not None:
        if type(spec.default) is int:
            whole = IntegerRange(from_value=int(low), to_value=int(high), step=1)
            descriptor.integer_range = [whole]
        else:
            real = FloatingPointRange(from_value=float(low), to_value=float(high))
            descriptor.floating_point_range = [real]
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
        remedy = 'correct what this names'
        if os.environ.get('ROS_SECURITY_ENABLE') == 'true':
            remedy = 'unset ROS_SECURITY_ENABLE, or read docs/security.md: wheels have no security'
        raise GraphError(f'ROS 2 cannot start: {cause}', remedy=remedy) from error


class Signals:
    """Handles SIGINT and SIGTERM from now on.

    The executor stops after the callback that runs. A callback, or the construction of a node, that
    still runs `PATIENCE_S` after a signal ends with KeyboardInterrupt. Libraries may turn that into
    an exception of their own.

    Attributes:
        received: Whether a signal has arrived.
        stderr: Descriptor of the standard error stream, which stays open.
    """

    def __init__(self) -> None:
        self.received = False
        self.stderr = os.dup(2)
        self._nowhere = os.open(os.devnull, os.O_WRONLY)
        self._rearm_s = 0.0
        signal.signal(signal.SIGALRM, self._interrupt)
        for number in ENDING:
            signal.signal(number, self._receive)
        # The launch files start nodes with SIGINT blocked: no import ends in a traceback.
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)

    def _receive(self, _signum: int, _frame: object) -> None:
        if not self.received:
            self.received = True
            signal.setitimer(signal.ITIMER_REAL, PATIENCE_S, PATIENCE_S)

    def _interrupt(self, _signum: int, _frame: object) -> None:
        # rclpy logs what leaves a callback as FATAL, with a traceback.
        os.dup2(self._nowhere, 2)
        raise KeyboardInterrupt

    def watch(self) -> None:
        """Restart the watchdog, which ends the process `STUCK_S` after the last call."""
        if (now_s := time.monotonic()) >= self._rearm_s:
            self._rearm_s = now_s + REARM_PERIOD_S
            # Needs nothing of Python, whose lock a call that hangs in the middleware may hold.
            faulthandler.dump_traceback_later(STUCK_S, exit=True, file=self.stderr)

    def ignore(self) -> None:
        """Ignore signals while the process ends; its status would not be 0 otherwise."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)
        os.dup2(self.stderr, 2)


def run(node_class: Callable[[], BaseNode], args: list[str] | None = None) -> int:
    """Run a node until SIGINT or SIGTERM, then close it.

    Nothing is called back any more when the node is closed, and the node is destroyed before ROS is
    shut down. A MixtacError ends the process, other failures of callbacks are logged. A callback
    that does not return ends the process after `STUCK_S` with a traceback of all threads: launch
    files and systemd report that, and can restart the node. A node that is late goes on.

    Args:
        node_class: Makes the node; called after `rclpy.init`.
        args: ROS arguments, `sys.argv` if None.

    Returns:
        Exit status: 0 after a signal, 1 with one line on stderr after a MixtacError.
    """
    signals = Signals()
    node: Any = None
    try:
        if signals.received:
            # Blocked during the imports.
            return 0
        with starting():
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            node = node_class()
        freeze_loaded()
        _spin(node, signals)
    except (ExternalShutdownException, KeyboardInterrupt):
        pass
    except Exception as error:
        # What was interrupted may end with any error.
        if not signals.received:
            if not isinstance(error, MixtacError):
                raise
            print(error_line(str(error)), file=sys.stderr)
            return 1
    finally:
        faulthandler.cancel_dump_traceback_later()
        signals.ignore()
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
        # What was frozen is not collected: extension modules would report it as leaked.
        gc.unfreeze()
    return 0


def _spin(node: Any, signals: Signals) -> None:  # noqa: ANN401
    """Run callbacks until a signal arrives or a check of the node fails.

    The check is a callback of the executor. On a busy host it comes late, but it comes: the
    executor does not return before its queue is empty, which can take for ever there.

    Raises:
        MixtacError: From `check`.
    """
    ended = Future()

    def check() -> None:
        # Not by the handler of the signal: the lock of the future may be held where it arrives.
        if signals.received and not ended.done():
            ended.set_result(None)
        try:
            node.check()
        except MixtacError as error:
            ended.set_exception(error)

    signals.watch()
    node.progress = signals.watch
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    node.create_timer(CHECK_PERIOD_S, check, clock=steady)
    node.create_timer(REARM_PERIOD_S, signals.watch, clock=steady)
    executor = EventsExecutor()
    executor.add_node(node)
    while rclpy.ok() and not (signals.received or ended.done()):
        try:
            # In the wheels of Jazzy, spin() of this executor never calls back.
            executor.spin_until_future_complete(ended, timeout_sec=CHECK_PERIOD_S)
        except (MixtacError, ExternalShutdownException):
            raise
        except Exception:
            if signals.received:
                raise
            # rclpy itself raises for parameters of unknown types and for times before the epoch.
            node.get_logger().error(f'a callback failed: {traceback.format_exc()}')
    if ended.done():
        ended.result()
