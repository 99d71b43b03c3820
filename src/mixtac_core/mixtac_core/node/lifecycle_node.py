# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Configures and activates lifecycle nodes, and reports the reason of failures."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

from mixtac_core.node.process import GraphError

TIMEOUT_S = 180.0
"""A first start compiles, which takes minutes on a busy computer."""
REPORT_PERIOD_S = 15.0
LOG_PATIENCE_S = 3.0


class LifecycleClient:
    """Drives one lifecycle node to `active`.

    Args:
        node: Node that calls the services.
        target: Fully qualified name of the lifecycle node.
        alive: Called while waiting; raises when the process behind the node has ended.
        reason: Returns the last error that the node logged, empty if unknown.
        timeout_s: Longest time to wait for the node to appear and for each answer [s].
    """

    def __init__(
        self,
        node: Node,
        target: str,
        alive: Callable[[], None],
        reason: Callable[[], str] = str,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self._node = node
        self._target = target
        self._alive = alive
        self._reason = reason
        self._timeout_s = timeout_s
        self._change = node.create_client(ChangeState, f'{target}/change_state')
        self._get = node.create_client(GetState, f'{target}/get_state')

    def bring_up(self) -> None:
        """Configure and activate the node.

        Raises:
            GraphError: It does not appear, refuses a transition, or takes too long.
        """
        self._wait(
            lambda: self._change.wait_for_service(timeout_sec=0.2),
            'did not appear',
            'check that it is installed, and on the same ROS_DOMAIN_ID',
        )
        self._transition(
            Transition.TRANSITION_CONFIGURE, 'configured', State.PRIMARY_STATE_INACTIVE
        )
        self._transition(Transition.TRANSITION_ACTIVATE, 'activated', State.PRIMARY_STATE_ACTIVE)

    def _wait(self, done: Callable[[], bool], failure: str, remedy: str) -> None:
        """Wait until `done` returns True, and report periodically that it takes long."""
        began_s = reported_s = time.monotonic()
        while not done():
            self._alive()
            now_s = time.monotonic()
            if now_s - began_s > self._timeout_s:
                raise GraphError(
                    f'{self._target} {failure} within {self._timeout_s:.0f} s', remedy=remedy
                )
            if now_s - reported_s > REPORT_PERIOD_S:
                reported_s = now_s
                self._node.get_logger().info(
                    f'waiting for {self._target} for {now_s - began_s:.0f} s; a first start '
                    'compiles, which takes minutes on a busy computer'
                )

    def _transition(self, transition: int, done: str, goal: int) -> None:
        request = ChangeState.Request()
        request.transition.id = transition
        reply = self._call(self._change, request)
        state = self._call(self._get, GetState.Request()).current_state
        if not reply.success or state.id != goal:
            why = self._logged_reason() or 'see its log'
            raise GraphError(f'{self._target} could not be {done}: {why}')

    def _logged_reason(self) -> str:
        # The log arrives by another way than the answer, and often later.
        deadline_s = time.monotonic() + LOG_PATIENCE_S
        while not (why := self._reason()) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        return why

    def _call(self, client: Any, request: Any) -> Any:  # noqa: ANN401
        future = client.call_async(request)

        def answered() -> bool:
            rclpy.spin_once(self._node, timeout_sec=0.1)
            return bool(future.done())

        self._wait(answered, 'did not answer', 'see its log')
        return future.result()
