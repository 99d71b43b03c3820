# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The count of the paper and the translation of the skin."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mixtac_slip_control.detectors import SPANS, CountDetector, Detectors
from mixtac_slip_control.parameters import SlipControlParameters

from .slip_windows import quiet_windows, window

LAWS = ('step', 'paper')


def taught(law: str = 'step', **changes: float) -> Detectors:
    detectors = Detectors(lambda: SlipControlParameters(law=law, **changes))
    for each in quiet_windows():
        assert not detectors.update(each, 0.0)
    assert detectors.count.learned
    return detectors


def test_the_count_never_slips_before_its_threshold_is_learned() -> None:
    detectors = Detectors(lambda: SlipControlParameters(law='paper'))
    assert not detectors.update(window(0, 100_000, (1.0, 0.0)), 0.0)


@pytest.mark.parametrize('law', LAWS)
def test_windows_at_rest_are_no_slip(law: str) -> None:
    detectors = taught(law)
    assert not any(detectors.update(each, 0.0) for each in quiet_windows(5000, seed=1))


def test_the_threshold_is_far_out_in_the_tail_and_stays_there() -> None:
    rest, rng = CountDetector(), np.random.default_rng(0)
    for value in rng.exponential(200.0, 1000):
        rest.learn(int(value))
    # The tail of an exponential beyond its 90 % quantile is the same exponential.
    assert rest.limit == pytest.approx(200.0 * (math.log(10.0) + 35.0), rel=0.3)
    before = rest.limit
    rest.learn(1_000_000)
    assert rest.limit == before
    rest.reset()
    assert not rest.learned


def test_the_paper_detects_slip_where_the_count_exceeds_its_threshold() -> None:
    detectors = taught('paper')
    detectors.update(window(0), 0.0)
    threshold = detectors.count.limit
    assert not detectors.update(window(0, math.floor(threshold)), 0.0)
    assert detectors.update(window(1, math.floor(threshold) + 1), 0.0)
    assert not detectors.update(window(2, 30), 0.0)
    # A translation of the skin does not count.
    assert not detectors.update(window(3, 30, (0.5, 0.0)), 0.0)


def test_a_camera_without_noise_has_a_smallest_threshold() -> None:
    detectors = Detectors(lambda: SlipControlParameters(law='paper'))
    for k in range(1000):
        detectors.update(window(k, 0), 0.0)
    assert not detectors.update(window(0, 20), 0.0)
    assert detectors.update(window(1, 21), 0.0)


@pytest.mark.parametrize('angle', [0.0, 1.0, 2.5, 4.0])
def test_a_knock_in_any_direction_is_slip_at_once_and_ends_after_quiet(angle: float) -> None:
    detectors = taught()
    assert detectors.update(window(0, 30, (0.4 * math.cos(angle), 0.4 * math.sin(angle))), 0.0)
    ends = [detectors.update(window(k), 0.0) for k in range(1, 10)]
    assert ends == sorted(ends, reverse=True)
    assert ends[:4] == [True] * 4
    assert not ends[-1]


def test_counts_without_motion_are_no_slip() -> None:
    detectors = taught()
    found = [detectors.update(window(k, 5000, (0.002, -0.002)), 0.0) for k in range(100)]
    assert not any(found)
    assert detectors.count.slipping


@pytest.mark.parametrize('sign', [1, -1])
def test_slow_motion_adds_up_also_where_the_skin_springs_back(sign: int) -> None:
    detectors = taught(min_flow=0.2)
    found = [detectors.update(window(k, 30, (0.12 * sign**k, 0.0)), 0.0) for k in range(6)]
    assert not found[0]
    assert found[-1]


def test_noise_of_any_size_exceeds_the_thresholds_once_in_ten_hours() -> None:
    """The sums of squares of random signs have gamma distributions."""
    for windows, least in SPANS.items():
        terms = sum(least**k / math.factorial(k) for k in range(windows))
        assert math.exp(-least) * terms == pytest.approx(1e-3 / 36_000, rel=0.1)


def test_the_flow_threshold_rises_with_the_advance_in_both_sums() -> None:
    detectors = taught()
    slow = [detectors.update(window(k, 30, (0.1, 0.0)), 4e-5) for k in range(20)]
    assert not any(slow)
    assert detectors.update(window(0, 30, (0.5, 0.0)), 4e-5)


@pytest.mark.parametrize('law', LAWS)
def test_a_change_of_light_is_no_slip_and_is_not_learned(law: str) -> None:
    detectors = Detectors(lambda: SlipControlParameters(law=law))
    for k in range(2000):
        assert not detectors.update(window(k, 5000, (0.5, 0.0), light=True), 0.0)
    assert not detectors.count.learned
    detectors = taught(law)
    assert detectors.update(window(0, 5000, (0.5, 0.0)), 0.0)
    assert not detectors.update(window(1, 5000, (0.5, 0.0), light=True), 0.0)


def test_events_that_do_not_agree_on_a_translation_are_no_slip() -> None:
    detectors = taught()
    many = [window(k, 5000, (0.1 * (-1) ** k, 0.0), noise=0.06**2) for k in range(20)]
    assert not any(detectors.update(each, 0.0) for each in many)
    assert detectors.flow.flow == 0.0
    assert detectors.update(window(20, 5000, (0.3, 0.0), noise=0.06**2), 0.0)


def test_reset_forgets() -> None:
    detectors = taught()
    detectors.update(window(0, 5000, (0.5, 0.0)), 0.0)
    detectors.reset()
    assert not detectors.count.learned
    assert not detectors.slipping
