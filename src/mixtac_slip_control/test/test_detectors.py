# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's count law and the translation of the skin."""

from __future__ import annotations

import math
from typing import TypeVar

import pytest

from mixtac_slip_control.detectors import CountDetector, Detectors, FlowDetector

from .slip_windows import LEARNED, parameters, quiet_windows, window

D = TypeVar('D', CountDetector, FlowDetector)


def taught(kind: type[D], **changes: float) -> D:
    detector = kind(parameters(**changes))
    for each in quiet_windows(LEARNED):
        assert not detector.update(each)
        detector.learn(each)
    assert detector.learned
    return detector


def test_nothing_slips_before_the_background_is_learned() -> None:
    detector = CountDetector(parameters())
    assert not detector.update(window(0, 100_000))


def test_an_excess_is_slip_at_once_and_ends_after_quiet() -> None:
    detector = taught(CountDetector)
    assert not any(detector.update(each) for each in quiet_windows(3000, seed=1))
    assert detector.update(window(0, 500))
    ends = [detector.update(window(1 + k, 30)) for k in range(6)]
    assert ends == [True] * 4 + [False] * 2


def test_between_release_and_threshold_slip_goes_on() -> None:
    detector = taught(CountDetector)
    detector.update(window(0, 500))
    between = int(30 + 0.8 * (detector.threshold - 30))
    assert all(detector.update(window(k, between)) for k in range(50))


def test_the_threshold_rises_with_the_advance() -> None:
    detector = taught(CountDetector, advance_events_per_mm=2e4)
    detector.update(window(0, 30))
    still = detector.threshold
    assert detector.update(window(1, int(still) + 100))
    detector = taught(CountDetector, advance_events_per_mm=2e4)
    assert not detector.update(window(1, int(still) + 100), 1e-5)
    assert detector.threshold == pytest.approx(still + 200.0)
    assert not detector.update(window(1, int(still) + 100), -1e-5)


def test_a_quiet_camera_has_a_smallest_threshold() -> None:
    detector = CountDetector(parameters(min_excess=500.0))
    for k in range(LEARNED):
        detector.update(window(k, 0))
        detector.learn(window(k, 0))
    assert not detector.update(window(0, 499))
    assert detector.update(window(1, 501))


def test_reset_forgets() -> None:
    detector = taught(CountDetector)
    detector.update(window(0, 5000))
    detector.reset()
    assert not detector.learned
    assert not detector.slipping


@pytest.mark.parametrize('angle', [0.0, 1.0, 2.5, 4.0])
def test_a_knock_in_any_direction_is_slip_at_once(angle: float) -> None:
    detector = taught(FlowDetector)
    flow = (0.08 * math.cos(angle), 0.08 * math.sin(angle))
    assert detector.update(window(0, 30, flow))


def test_counts_without_motion_are_no_slip() -> None:
    detector = taught(FlowDetector)
    assert not any(detector.update(window(k, 5000, (0.002, -0.002))) for k in range(100))


def test_slow_motion_adds_up_where_single_windows_stay_below() -> None:
    detector = taught(FlowDetector, min_slow_flow=0.06)
    slow = 0.8 * detector.threshold
    found = [detector.update(window(k, 30, (slow, 0.0))) for k in range(6)]
    assert not found[0]
    assert any(found)
    detector = taught(FlowDetector, min_slow_flow=0.06)
    swings = [detector.update(window(k, 30, (slow * (-1) ** k, 0.0))) for k in range(20)]
    assert not any(swings)


def test_the_flow_threshold_rises_with_the_advance_in_both_sums() -> None:
    detector = taught(FlowDetector, advance_flow_per_mm=5.0)
    assert not any(detector.update(window(k, 30, (0.1, 0.0)), 4e-5) for k in range(20))
    assert detector.update(window(0, 30, (0.5, 0.0)), 4e-5)


def test_windows_without_a_frame_teach_nothing() -> None:
    detector = FlowDetector(parameters())
    for k in range(1000):
        detector.update(window(k, guided=False))
        detector.learn(window(k, guided=False))
    assert not detector.learned


def test_a_new_length_of_the_slow_sum_is_learned_anew() -> None:
    detector = taught(FlowDetector)
    detector.configure(parameters(slow_time=8e-3))
    assert not detector.learned


def test_the_chosen_detector_decides_and_sets_the_threshold_of_the_law() -> None:
    for chosen in ('flow', 'count'):
        both = Detectors(parameters(detector=chosen, settle_time=0.0))
        for each in quiet_windows(LEARNED):
            both.update(each, 0.0)
        assert both.learned
        assert both.update(window(0, 5000), 0.0) == (chosen == 'count')
        assert both.update(window(1, 30, (0.5, 0.0)), 0.0)
        expected = both.count.expected if chosen == 'flow' else both.count.threshold
        assert both.law_threshold == expected


@pytest.mark.parametrize('chosen', ['flow', 'count'])
def test_a_change_of_light_is_no_slip_and_is_not_learned(chosen: str) -> None:
    both = Detectors(parameters(detector=chosen, settle_time=0.0))
    for each in quiet_windows(LEARNED):
        both.update(each, 0.0)
    before = both.count.background.median
    for k in range(2000):
        assert not both.update(window(k, 5000, (0.5, 0.0), light=True), 0.0)
    assert both.count.background.median == before
    assert both.update(window(2000, 5000, (0.5, 0.0)), 0.0)
    assert not both.update(window(2001, 5000, (0.5, 0.0), light=True), 0.0)


def test_events_that_do_not_agree_on_a_translation_are_no_slip() -> None:
    detector = taught(FlowDetector)
    many = [window(k, 5000, (0.1 * (-1) ** k, 0.0), noise=0.04**2) for k in range(20)]
    assert not any(detector.update(each) for each in many)
    assert detector.flow == 0.0
    assert detector.update(window(20, 5000, (0.15, 0.0), noise=0.04**2))
    # Once it slips, the skin may stand still under it.
    assert detector.update(window(21, 5000, (0.1, 0.0), noise=0.04**2))


def test_a_small_slip_while_it_learns_does_not_raise_the_threshold() -> None:
    known, detector = taught(FlowDetector), FlowDetector(parameters())
    for each in quiet_windows(LEARNED + 20):
        slips = 100_000 < each.end_us <= 110_000
        given = window(0, 60, (0.05, 0.0), noise=0.01**2) if slips else each
        detector.update(given)
        detector.learn(given)
    assert detector.learned
    detector.update(window(0))
    known.update(window(0))
    assert detector.threshold == pytest.approx(known.threshold, rel=0.1)
