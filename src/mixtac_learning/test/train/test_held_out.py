# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is held out to validate on: whole sensors, or trials where sensors are few."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from mixtac_learning.train.run import held_out


@given(st.lists(st.sampled_from('abcdefgh'), min_size=2, max_size=60), st.floats(0.01, 0.9))
def test_a_part_is_held_out_and_a_part_is_trained_on(sensors, part):
    held = held_out(sensors, part)
    assert held == sorted(set(held)) == held_out(list(sensors), part)
    assert 0 < len(held) < len(sensors)
    different = len(set(sensors))
    kept = {sensor for index, sensor in enumerate(sensors) if index not in held}
    if part * different >= 1.0:
        assert kept.isdisjoint(sensors[index] for index in held)
        assert len(kept) >= 1
    else:
        assert len(held) == min(max(round(part * len(sensors)), 1), len(sensors) - 1)


def test_nothing_is_held_out_unless_asked_for():
    assert held_out(['a', 'b', 'b'], 0.0) == []
