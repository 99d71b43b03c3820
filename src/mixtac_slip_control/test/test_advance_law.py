# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The advance: the paper's law inside limits that nothing exceeds."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_slip_control.advance_law import AdvanceLaw, AdvanceSettings
from mixtac_slip_control.errors import SlipControlError

SETTINGS = st.builds(
    AdvanceSettings,
    gain=st.floats(0.0, 1e-4),
    max_step=st.floats(0.0, 1e-3),
    max_total=st.floats(0.0, 1e-2),
    hold_windows=st.integers(0, 20),
    back_off_step=st.floats(0.0, 1e-4),
)
WINDOWS = st.lists(
    st.tuples(st.integers(0, 10**6), st.floats(0.0, 1e6), st.booleans()), max_size=80
)


@given(settings=SETTINGS, windows=WINDOWS)
def test_no_limit_is_ever_exceeded(
    settings: AdvanceSettings, windows: list[tuple[int, float, bool]]
) -> None:
    law = AdvanceLaw(settings)
    total = 0.0
    for count, threshold, slipping in windows:
        advance = law.update(count, threshold, slipping=slipping)
        total += advance
        assert math.isfinite(advance)
        # Differences of the sum carry its rounding.
        assert -settings.back_off_step - 1e-17 <= advance <= settings.max_step + 1e-17
        assert advance <= 0.0 or slipping
        assert 0.0 <= law.total <= settings.max_total
        assert law.total == pytest.approx(total, abs=1e-14)


def test_the_advance_is_proportional_to_the_excess() -> None:
    law = AdvanceLaw(AdvanceSettings(gain=2e-8))
    assert law.update(160, 60.0, slipping=True) == pytest.approx(2e-6)
    assert law.update(60, 60.0, slipping=True) == 0.0
    assert law.update(40, 60.0, slipping=True) == 0.0, 'between release and threshold'
    assert law.update(1000, 60.0, slipping=False) == 0.0
    assert law.total == pytest.approx(2e-6)


def test_the_advance_is_held_then_backed_off() -> None:
    law = AdvanceLaw(AdvanceSettings(gain=1e-8, hold_windows=3, back_off_step=4e-7))
    law.update(160, 60.0, slipping=True)
    steps = [law.update(0, 60.0, slipping=False) for _ in range(7)]
    assert steps == pytest.approx([0, 0, 0, -4e-7, -4e-7, -2e-7, 0])
    assert law.total == 0.0


def test_without_back_off_it_is_held_for_ever() -> None:
    law = AdvanceLaw()
    law.update(10_000, 60.0, slipping=True)
    held = law.total
    assert held == AdvanceSettings().max_step
    assert all(law.update(0, 60.0, slipping=False) == 0.0 for _ in range(5000))
    assert law.total == held


def test_a_lowered_limit_stops_the_advance_without_a_jump() -> None:
    law = AdvanceLaw()
    law.update(10_000, 0.0, slipping=True)
    reached = law.total
    law.settings = AdvanceSettings(max_total=reached / 2)
    assert law.update(10_000, 0.0, slipping=True) == 0.0
    assert law.total == reached


@pytest.mark.parametrize(
    'settings',
    [{'gain': -1.0}, {'max_step': math.nan}, {'max_total': math.inf}, {'hold_windows': -1}],
)
def test_settings_without_a_meaning_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='finite'):
        AdvanceSettings(**settings)
