# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The count criterion and its hysteresis."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_slip_control.detector import DetectorSettings, SlipDetector
from mixtac_slip_control.errors import SlipControlError


def decisions(counts: list[int], **settings: float) -> list[bool]:
    detector = SlipDetector(DetectorSettings(**settings))
    return [detector.update(count, 30.0, 5.0) for count in counts]


def test_slip_is_a_count_above_the_threshold() -> None:
    detector = SlipDetector()
    assert detector.threshold(30.0, 5.0) == 60.0
    assert detector.threshold(30.0, 1.0) == 50.0, 'the smallest excess'
    assert not detector.update(60, 30.0, 5.0)
    assert detector.update(61, 30.0, 5.0)


def test_slip_ends_after_quiet_windows_in_a_row() -> None:
    assert decisions([61, 45, 45, 46, 45, 45, 45], release_windows=3) == [True] * 6 + [False]
    assert decisions([61, 30, 61, 30], release_windows=1) == [True, False, True, False]


@given(
    counts=st.lists(st.integers(0, 100), max_size=60),
    ratio=st.floats(0.0, 1.0),
    windows=st.integers(1, 6),
)
def test_hysteresis_only_prolongs(counts: list[int], ratio: float, windows: int) -> None:
    slips = decisions(counts, release_ratio=ratio, release_windows=windows)
    above = [count > 60 for count in counts]
    before = False
    for i, (slip, over) in enumerate(zip(slips, above, strict=True)):
        assert slip or not over
        assert over or before or not slip
        if before and not slip:
            assert all(c <= 30 + ratio * 30 for c in counts[i - windows + 1 : i + 1])
        before = slip


def test_reset_returns_to_rest() -> None:
    detector = SlipDetector()
    detector.update(1000, 30.0, 5.0)
    detector.reset()
    assert not detector.slipping
    assert not detector.update(55, 30.0, 5.0)


@pytest.mark.parametrize(
    'settings',
    [
        {'n_sigma': -1.0},
        {'min_excess': float('nan')},
        {'release_ratio': 1.5},
        {'release_windows': 0},
    ],
)
def test_settings_without_a_meaning_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='give'):
        DetectorSettings(**settings)
