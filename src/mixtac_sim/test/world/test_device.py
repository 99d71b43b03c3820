# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensors and days, as their seeds draw them."""

import pytest

from mixtac_sim.world.device import draw_conditions
from mixtac_sim.world.effects import PRESETS, preset

HOUR_US = 3_600_000_000


@pytest.mark.parametrize('name', PRESETS)
def test_lamps_are_warm_after_ten_minutes_and_never_go_out(name):
    for seed in range(20):
        day = draw_conditions(seed, preset(name))
        assert day.light_at(0) == day.light
        warm = day.light_at(HOUR_US // 6)
        assert warm == pytest.approx(day.light * (1.0 + 600.0 * day.light_drift_per_s))
        assert warm > 0.7 * day.light
        assert day.light_at(24 * HOUR_US) == warm
