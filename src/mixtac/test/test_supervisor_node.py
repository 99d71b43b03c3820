# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is logged about an object that was struck."""

from __future__ import annotations

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac.supervisor_node import Impact


@pytest.mark.parametrize(
    ('impact', 'held', 'words'),
    [
        (Impact(0.5, 1.2, detected=True), True, '1.20 mm'),
        (Impact(0.5, 50.0), False, 'not detected'),
        (Impact(0.5, 1.0, stopped='too much force'), True, 'too much force'),
    ],
)
def test_an_impact_is_described(impact, held, words):
    assert impact.held == held
    assert words in str(impact)
