# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The advance law: the paper's formula inside, limits that hold for every input."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.law import AdvanceLaw, AdvanceSettings

SETTINGS = AdvanceSettings(
    gain=0.5,
    events_per_m=1e7,
    max_step=4e-5,
    max_total=3e-4,
    hold_windows=10,
    back_off_step=1e-6,
    preload_step=2e-6,
    force_band=0.02,
)


def test_below_the_limits_it_is_the_papers_law() -> None:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    k = 0.5 / 1e7
    steps = [law.update(n, 60.0, 0.5, slipping=True) for n in (80, 160, 260)]
    assert steps == pytest.approx([k * 20, k * 100, k * 200])
    assert law.total == pytest.approx(k * 320)


def test_a_memory_goes_on_answering_while_the_slip_lasts() -> None:
    law = AdvanceLaw(dataclasses.replace(SETTINGS, memory_windows=10.0))
    law.reset(preload=0.5)
    k, fade = 0.5 / 1e7, math.exp(-0.1)
    counts = (260, 60, 0, 400)
    steps = [law.update(n, 60.0, 0.5, slipping=True) for n in counts]
    assert steps == pytest.approx([k * 200, k * 200 * fade, k * 200 * fade**2, k * 340])
    # The end of the slip ends it.
    assert law.update(0, 60.0, 0.5, slipping=False) == 0.0
    assert law.update(0, 60.0, 0.5, slipping=True) == 0.0


windows = st.lists(
    st.tuples(
        st.integers(0, 50_000),
        st.floats(0.0, 1e4),
        st.one_of(st.none(), st.floats(-1.0, 5.0)),
        st.booleans(),
    ),
    max_size=80,
)


@given(windows, st.floats(0.0, 1e-3), st.floats(0.0, 2.0))
def test_limits_hold_for_every_input(
    sequence: list[tuple[int, float, float | None, bool]], limit: float, preload: float
) -> None:
    law = AdvanceLaw(SETTINGS)
    law.reset(limit, preload)
    for count, threshold, force, slipping in sequence:
        before = law.total
        step = law.update(count, threshold, force, slipping=slipping)
        assert -SETTINGS.back_off_step - 1e-18 <= step <= SETTINGS.max_step + 1e-18
        assert 0.0 <= law.total <= min(limit, SETTINGS.max_total)
        assert law.total == pytest.approx(before + step, abs=1e-18)


def slipped() -> AdvanceLaw:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    law.update(1000, 60.0, 0.5, slipping=True)
    return law


def test_it_holds_and_then_returns_slowly_to_the_preload() -> None:
    law = slipped()
    start = law.total
    held = [law.update(30, 60.0, 0.9, slipping=False) for _ in range(10)]
    assert held == [0.0] * 10
    back = [law.update(30, 60.0, 0.9, slipping=False) for _ in range(5)]
    assert back == pytest.approx([-1e-6] * 5)
    assert law.update(30, 60.0, 0.51, slipping=False) == 0.0
    for _ in range(1000):
        law.update(30, 60.0, 0.9, slipping=False)
    assert law.total == 0.0
    assert start > 0.0


def test_slip_while_returning_ends_the_return() -> None:
    law = slipped()
    for _ in range(20):
        law.update(30, 60.0, 0.9, slipping=False)
    floor = law.total
    law.update(100, 60.0, 0.9, slipping=True)
    for _ in range(1000):
        law.update(30, 60.0, 0.9, slipping=False)
    assert law.total == pytest.approx(floor)


def test_the_preload_is_kept_as_the_gel_relaxes() -> None:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    steps = [law.update(30, 60.0, 0.45, slipping=False) for _ in range(12)]
    assert steps[:10] == [0.0] * 10
    assert steps[10:] == pytest.approx([2e-6] * 2)
    assert AdvanceLaw(SETTINGS).update(30, 60.0, 0.0, slipping=False) == 0.0


def test_what_was_added_is_held_and_returned_like_an_answer_to_slip() -> None:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    law.add(5e-6)
    assert law.total == 5e-6
    held = [law.update(30, 60.0, 0.9, slipping=False) for _ in range(11)]
    assert held == pytest.approx([0.0] * 10 + [-1e-6])


def test_a_limit_that_the_force_has_used_up_is_refused() -> None:
    with pytest.raises(SlipControlError, match='max_force'):
        AdvanceLaw(SETTINGS).reset(-1e-6)
    with pytest.raises(SlipControlError, match='max_force'):
        AdvanceLaw(SETTINGS).reset(math.nan)


@pytest.mark.parametrize(
    'bad',
    [{'gain': -1.0}, {'max_step': math.nan}, {'events_per_m': 0.0}, {'hold_windows': -1}],
)
def test_bad_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='give'):
        AdvanceSettings(**bad)
