# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The parts together: learning, enabling, slipping, and never more than the limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_slip_control.advance_law import AdvanceSettings
from mixtac_slip_control.background import BackgroundSettings
from mixtac_slip_control.controller import SlipController, SlipSettings
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.slip_control_parameters import SlipControlParameters


def ready(seed: int = 1, **advance: float) -> SlipController:
    controller = SlipController(SlipSettings(advance=AdvanceSettings(**advance)))
    for count in np.random.default_rng(seed).poisson(30.0, 600):
        controller.step(int(count))
    return controller


ACTIONS = st.lists(
    st.integers(0, 3000) | st.sampled_from(['enable', 'disable', 'recalibrate', 'lost']),
    max_size=150,
)


@given(actions=ACTIONS, learned=st.booleans(), max_total=st.floats(0.0, 1e-4))
def test_limits_hold_whatever_happens(
    actions: list[int | str], learned: bool, max_total: float
) -> None:
    settings = SlipSettings(
        background=BackgroundSettings(learning_windows=10),
        advance=AdvanceSettings(max_total=max_total),
        settle_windows=3,
    )
    controller = SlipController(settings)
    for _ in range(10 if learned else 0):
        controller.step(20)
    for action in actions:
        if isinstance(action, str) and action != 'lost':
            try:
                getattr(controller, action)()
            except SlipControlError:
                assert action != 'disable'
            continue
        step = controller.step(0 if action == 'lost' else action, complete=action != 'lost')
        assert step.enabled or step.advance == 0.0
        assert 0.0 <= step.advance <= settings.advance.max_step + 1e-17
        assert 0.0 <= step.total_advance <= max_total
        numbers = (step.background, step.background_sigma, step.threshold)
        assert all(math.isfinite(v) and v >= 0.0 for v in numbers)
        assert step.threshold > step.background


def test_slip_is_seen_and_answered() -> None:
    controller = ready(gain=1e-8)
    controller.enable()
    steps = [controller.step(count) for count in (30, 400, 600, 30)]
    assert [s.slipping for s in steps] == [False, True, True, True]
    expected = 1e-8 * (400 - steps[1].threshold) + 1e-8 * (600 - steps[2].threshold)
    assert steps[-1].total_advance == pytest.approx(expected)
    assert steps[-1].advance == 0.0


def test_disabled_it_watches_and_asks_for_nothing() -> None:
    controller = ready()
    step = controller.step(1000)
    assert step.slipping
    assert (step.enabled, step.advance, step.total_advance) == (False, 0.0, 0.0)


def test_enabling_starts_from_zero_and_disabling_keeps_the_record() -> None:
    controller = ready()
    controller.enable()
    total = controller.step(1000).total_advance
    controller.disable()
    assert controller.step(1000).total_advance == total > 0.0
    for _ in range(200):
        controller.step(30)
    controller.enable()
    assert controller.step(30).total_advance == 0.0


def test_enabling_is_refused_while_learning_or_slipping() -> None:
    with pytest.raises(SlipControlError, match='not learned'):
        SlipController().enable()
    controller = ready()
    controller.step(5000)
    with pytest.raises(SlipControlError, match='still'):
        controller.enable()
    assert not controller.enabled


def test_the_background_does_not_learn_slip() -> None:
    controller = ready()
    before = controller.step(30).background
    for _ in range(3000):
        controller.step(500)
    assert controller.step(30).background == pytest.approx(before, abs=0.05)


def test_windows_with_lost_packets_do_not_lower_the_background() -> None:
    controller = ready()
    before = controller.step(30).background
    for _ in range(20_000):
        controller.step(0, complete=False)
    assert controller.step(30).background == pytest.approx(before, abs=0.05)


def test_poisson_noise_raises_no_alarm() -> None:
    controller = ready()
    counts = np.random.default_rng(9).poisson(30.0, 100_000)
    assert not any(controller.step(int(count)).slipping for count in counts)


def test_calibrating_anew_follows_a_new_scene() -> None:
    controller = ready()
    controller.step(500)
    controller.recalibrate()
    assert not controller.calibrated
    for _ in range(500):
        assert not controller.step(500).slipping
    assert controller.step(500).background == 500.0
    controller.enable()
    with pytest.raises(SlipControlError, match='disable'):
        controller.recalibrate()


def test_parameters_become_settings_in_windows() -> None:
    settings = SlipControlParameters(window=2e-3, back_off=1e-3).settings()
    assert settings.background.learning_windows == 250
    assert settings.background.time_constant_windows == pytest.approx(2500.0)
    assert settings.detector.release_windows == 2
    assert settings.advance.hold_windows == 100
    assert settings.advance.back_off_step == pytest.approx(2e-6)
    assert SlipControlParameters().window_us == 1000
    with pytest.raises(SlipControlError, match='windows'):
        SlipControlParameters(window=2e-2, learning_time=0.05).settings()


def test_settings_change_while_running() -> None:
    controller = ready()
    controller.enable()
    total = controller.step(1000).total_advance
    controller.configure(SlipControlParameters(max_total=0.0).settings())
    assert controller.step(1000).total_advance == total
    assert controller.enabled
