# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock of a replay."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip('rosgraph_msgs.msg')

from mixtac_driver.node.publishers import ClockPublisher
from mixtac_node.stamps import stamp_to_us

EPOCH_US = 1_760_000_000_000_000


def test_recorded_time_is_published_once_a_millisecond_and_never_back():
    sent = []
    node = SimpleNamespace(
        create_publisher=lambda _kind, topic, _qos: SimpleNamespace(
            publish=lambda message: sent.append((topic, stamp_to_us(message.clock)))
        )
    )
    clock = ClockPublisher(node)
    for offset in (0, 400, 999, 1000, 2500, 2000, 3600):
        clock.publish(EPOCH_US + offset)
    assert sent == [('/clock', EPOCH_US + offset) for offset in (0, 1000, 2500, 3600)]
