# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip by the translation of the skin."""

from __future__ import annotations

import math

import pytest

from mixtac_slip_control.background import BackgroundSettings
from mixtac_slip_control.detectors import FlowDetector, FlowSettings
from mixtac_slip_control.errors import SlipControlError

from .slip_windows import quiet_windows, window

BACKGROUND = BackgroundSettings(learning_windows=200)


def taught(**settings: float) -> FlowDetector:
    detector = FlowDetector(FlowSettings(background=BACKGROUND, **settings))
    for each in quiet_windows(200):
        assert not detector.update(each)
        detector.learn(each)
    assert detector.learned
    return detector


@pytest.mark.parametrize('angle', [0.0, 1.0, 2.5, 4.0])
def test_a_knock_in_any_direction_is_slip_at_once(angle: float) -> None:
    detector = taught()
    flow = (0.08 * math.cos(angle), 0.08 * math.sin(angle))
    assert detector.update(window(0, 30, flow))


def test_counts_without_motion_are_no_slip() -> None:
    detector = taught()
    assert not any(detector.update(window(k, 5000, (0.002, -0.002))) for k in range(100))


def test_slow_motion_adds_up_where_single_windows_stay_below() -> None:
    detector = taught(min_slow_flow=0.06)
    slow = 0.8 * detector.threshold
    found = [detector.update(window(k, 30, (slow, 0.0))) for k in range(6)]
    assert not found[0]
    assert any(found)
    detector = taught(min_slow_flow=0.06)
    swings = [detector.update(window(k, 30, (slow * (-1) ** k, 0.0))) for k in range(20)]
    assert not any(swings)


def test_the_threshold_rises_with_the_advance_in_both_sums() -> None:
    detector = taught(advance_flow_per_m=5e3)
    assert not any(detector.update(window(k, 30, (0.1, 0.0)), 4e-5) for k in range(20))
    assert detector.update(window(0, 30, (0.5, 0.0)), 4e-5)


def test_windows_without_a_frame_teach_nothing() -> None:
    detector = FlowDetector(FlowSettings(background=BACKGROUND))
    for k in range(1000):
        detector.update(window(k, guided=False))
        detector.learn(window(k, guided=False))
    assert not detector.learned


def test_a_new_length_of_the_slow_sum_is_learned_anew() -> None:
    detector = taught()
    detector.configure(FlowSettings(background=BACKGROUND, slow_windows=8))
    assert not detector.learned


@pytest.mark.parametrize('bad', [{'min_flow': -1.0}, {'slow_windows': 1}])
def test_bad_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='>= 0'):
        FlowSettings(**bad)
