# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The summary for diagnostics."""

from __future__ import annotations

from mixtac_node.diagnostics import ERROR, OK, WARN
from mixtac_slip_control.controller import SlipController
from mixtac_slip_control.status import FeedCounts, node_status

from .slip_windows import parameters


def test_the_status_says_what_is_missing() -> None:
    controller, counts = SlipController(parameters()), FeedCounts()
    level, message, values = node_status(controller, counts, None, 1.0)
    assert level == WARN
    assert message
    assert values['force age [s]'] == 'never'
    counts.problem = 'image of another size'
    assert 'another size' in node_status(controller, counts, None, 1.0)[1]
    controller.interlock.enable(None)
    controller.interlock.stop('force is nan')
    assert node_status(controller, counts, None, 1.0)[:2] == (ERROR, 'stopped: force is nan')
    assert OK < WARN
