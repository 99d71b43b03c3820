# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes the running error of the estimated force against the reference."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from functools import partial

import numpy as np
from message_filters import ApproximateTimeSynchronizer, Subscriber
from rclpy.node import Node
from std_msgs.msg import Float64

from mixtac_core.node import topics
from mixtac_core.node.base_node import BaseNode, declare, qos, run
from mixtac_core.node.diagnostics import OK, WARN, DiagnosticsPublisher, Status
from mixtac_core.node.topics import stamp_to_ns
from mixtac_fger.alignment.histories import has_restarted
from mixtac_fger.alignment.parameters import ForceErrorParameters

WAITING = 50
"""Estimates, or samples of the reference, that wait for each other; 0.1 s of estimates."""
SLOP_S = 0.001
"""Largest difference of the stamps in a pair [s]."""


def mean_errors(errors_n: Collection[float]) -> tuple[float, float]:
    """Return the mean absolute and the root mean square of errors [N]; 0 where there are none."""
    errors = np.array([*errors_n] or [0.0])
    return float(np.abs(errors).mean()), float(np.sqrt((errors**2).mean()))


class ForceErrorNode(BaseNode, Node):  # type: ignore[misc]
    """Running mean absolute and root mean square error, as topics and diagnostics."""

    def __init__(self) -> None:
        super().__init__('force_error')
        p = declare(self, ForceErrorParameters)
        self._sign = p.sign or 1
        self._errors: deque[float] = deque(maxlen=p.window)
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
        self._published = (
            self.publish_topic(topics.FORCE_ERROR_MAE, name='~/mae'),
            self.publish_topic(topics.FORCE_ERROR_RMSE, name='~/rmse'),
        )
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
        error = topics.normal_force(force) - self._sign * topics.normal_force(reference)
        if math.isfinite(error):
            self._errors.append(error)

    def _publish(self) -> None:
        if self._errors:
            for publisher, error in zip(self._published, mean_errors(self._errors), strict=True):
                publisher.publish(Float64(data=error))

    def _status(self) -> Status:
        mae, rmse = mean_errors(self._errors)
        values: dict[str, object] = {'pairs': len(self._errors), 'mae [N]': mae, 'rmse [N]': rmse}
        if not self._errors:
            return Status(WARN, 'no pairs: fit the clocks first (alignment/fit)', values)
        return Status(OK, f'MAE {mae:.3f} N, RMSE {rmse:.3f} N', values)


main = partial(run, ForceErrorNode)
