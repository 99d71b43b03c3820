# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's count law."""

from __future__ import annotations

import pytest

from mixtac_slip_control.background import BackgroundSettings
from mixtac_slip_control.detectors import CountDetector, CountSettings, HysteresisSettings
from mixtac_slip_control.errors import SlipControlError

from .slip_windows import quiet_windows, window

BACKGROUND = BackgroundSettings(learning_windows=200)


def taught(**settings: float) -> CountDetector:
    detector = CountDetector(CountSettings(background=BACKGROUND, **settings))
    for each in quiet_windows(200):
        assert not detector.update(each)
        detector.learn(each)
    assert detector.learned
    return detector


def test_nothing_slips_before_the_background_is_learned() -> None:
    detector = CountDetector(CountSettings(background=BACKGROUND))
    assert not detector.update(window(0, 100_000))


def test_an_excess_is_slip_at_once_and_ends_after_quiet() -> None:
    detector = taught()
    assert not any(detector.update(each) for each in quiet_windows(3000, seed=1))
    assert detector.update(window(0, 500))
    ends = [detector.update(window(1 + k, 30)) for k in range(6)]
    assert ends == [True] * 4 + [False] * 2


def test_between_release_and_threshold_slip_goes_on() -> None:
    detector = taught()
    detector.update(window(0, 500))
    between = int(30 + 0.8 * (detector.threshold - 30))
    assert all(detector.update(window(k, between)) for k in range(50))


def test_the_threshold_rises_with_the_advance() -> None:
    detector = taught(advance_events_per_m=2e7)
    detector.update(window(0, 30))
    still = detector.threshold
    assert detector.update(window(1, int(still) + 100))
    detector = taught(advance_events_per_m=2e7)
    assert not detector.update(window(1, int(still) + 100), 1e-5)
    assert detector.threshold == pytest.approx(still + 200.0)
    assert not detector.update(window(1, int(still) + 100), -1e-5)


def test_a_quiet_camera_has_a_smallest_threshold() -> None:
    detector = CountDetector(CountSettings(background=BACKGROUND, min_excess=500.0))
    for k in range(200):
        detector.update(window(k, 0))
        detector.learn(window(k, 0))
    assert not detector.update(window(0, 499))
    assert detector.update(window(1, 501))


def test_reset_forgets() -> None:
    detector = taught()
    detector.update(window(0, 5000))
    detector.reset()
    assert not detector.learned
    assert not detector.slipping


@pytest.mark.parametrize('bad', [{'min_excess': -1.0}, {'advance_events_per_m': float('nan')}])
def test_bad_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='>= 0'):
        CountSettings(**bad)


@pytest.mark.parametrize('bad', [{'release_ratio': 1.5}, {'release_windows': 0}])
def test_bad_hysteresis_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match='ratio'):
        HysteresisSettings(**bad)
