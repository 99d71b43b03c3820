# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes the running error of the estimated force against the reference."""

from __future__ import annotations

import math
from collections import deque
from functools import partial

from message_filters import ApproximateTimeSynchronizer, Subscriber
from rclpy.node import Node
from std_msgs.msg import Float64

from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, declare, qos, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.stamps import stamp_to_ns
from mixtac_fger.alignment.histories import has_restarted
from mixtac_fger.alignment.parameters import ForceErrorParameters

WAITING = 50
"""Estimates, or samples of the reference, that wait for each other; 0.1 s of estimates."""
SLOP_S = 0.001
"""Largest difference of the stamps in a pair [s]."""


class RunningError:
    """Errors of the latest pairs of estimate and reference.

    Args:
        window: Number of pairs.
    """

    def __init__(self, window: int) -> None:
        self._errors: deque[float] = deque(maxlen=window)

    def push(self, estimate_n: float, reference_n: float) -> None:
        """Add a pair of normal forces [N]; one that is no number is left out."""
        if math.isfinite(error := estimate_n - reference_n):
            self._errors.append(error)

    @property
    def pairs(self) -> int:
        """Return over how many pairs the errors run."""
        return len(self._errors)

    @property
    def mae(self) -> float:
        """Return the mean absolute error [N]; 0 without pairs."""
        return sum(map(abs, self._errors)) / max(1, len(self._errors))

    @property
    def rmse(self) -> float:
        """Return the root mean square error [N]; 0 without pairs."""
        mean = sum(error * error for error in self._errors) / max(1, len(self._errors))
        return float(mean**0.5)


class ForceErrorNode(BaseNode, Node):  # type: ignore[misc]
    """Running mean absolute and root mean square error, as topics and diagnostics."""

    def __init__(self) -> None:
        super().__init__('force_error')
        p = declare(self, ForceErrorParameters)
        self._sign = p.sign or 1
        self._error = RunningError(p.window)
        self._newest_ns = 0
        force, reference = (
            Subscriber(self, topics.message_class(topic.type_name), name, qos_profile=qos(topic))
            for topic, name in (
                (topics.FORCE, p.force_topic),
                (topics.ALIGNMENT_REFERENCE, p.reference_topic),
            )
        )
        for half in (force, reference):
            half.registerCallback(self._on_half)
        self._pairs = ApproximateTimeSynchronizer([force, reference], WAITING, SLOP_S)
        self._pairs.registerCallback(self._on_pair)
        self._mae = self.publish_topic(topics.FORCE_ERROR_MAE, name='~/mae')
        self._rmse = self.publish_topic(topics.FORCE_ERROR_RMSE, name='~/rmse')
        self.create_timer(0.1, self._publish)
        self._diagnostics = DiagnosticsPublisher(self, 'force error', self._status)

    def _on_half(self, message: topics.ForceMessage) -> None:
        stamp_ns = stamp_to_ns(message.header.stamp)
        if has_restarted(stamp_ns, self._newest_ns):
            # What waits is of the clock before, and would push out all that is new.
            for queue in self._pairs.queues:
                queue.clear()
        self._newest_ns = stamp_ns

    def _on_pair(self, force: topics.ForceMessage, reference: topics.ForceMessage) -> None:
        self._error.push(topics.normal_force(force), self._sign * topics.normal_force(reference))

    def _publish(self) -> None:
        if self._error.pairs:
            self._mae.publish(Float64(data=self._error.mae))
            self._rmse.publish(Float64(data=self._error.rmse))

    def _status(self) -> Status:
        error = self._error
        values: dict[str, object] = {
            'pairs': error.pairs,
            'mae [N]': error.mae,
            'rmse [N]': error.rmse,
        }
        if not error.pairs:
            return Status(WARN, 'no pairs: fit the clocks first (alignment/fit)', values)
        return Status(OK, f'MAE {error.mae:.3f} N, RMSE {error.rmse:.3f} N', values)


main = partial(run, ForceErrorNode)
