# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The advance law: the paper's formula inside, limits that hold for every input."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_slip_control.law import Advance, AdvanceLaw
from mixtac_slip_control.parameters import SlipControlParameters

SETTINGS = SlipControlParameters(
    gain=0.5,
    events_per_mm=1e4,
    memory_time=0.0,
    slip_rate=0.0,
    max_step=4e-5,
    hold_time=0.2,
    back_off=1e-3,
    preload_speed=2e-3,
    force_band=0.02,
)
HOLD = 200
LIMIT = 3e-4


def test_below_the_limits_it_is_the_papers_law() -> None:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    k = 0.5 / 1e7
    steps = [law.update(n, 60.0, 0.5, LIMIT, slipping=True) for n in (80, 160, 260)]
    assert steps == pytest.approx([k * 20, k * 100, k * 200])
    assert law.total == pytest.approx(k * 320)


def test_a_memory_goes_on_answering_while_the_slip_lasts() -> None:
    law = AdvanceLaw(dataclasses.replace(SETTINGS, memory_time=0.01))
    law.reset(preload=0.5)
    k, fade = 0.5 / 1e7, math.exp(-0.1)
    counts = (260, 60, 0, 400)
    steps = [law.update(n, 60.0, 0.5, LIMIT, slipping=True) for n in counts]
    assert steps == pytest.approx([k * 200, k * 200 * fade, k * 200 * fade**2, k * 340])
    # The end of the slip ends it.
    assert law.update(0, 60.0, 0.5, LIMIT, slipping=False) == 0.0
    assert law.update(0, 60.0, 0.5, LIMIT, slipping=True) == 0.0


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
    law.reset(preload)
    for count, threshold, force, slipping in sequence:
        before = law.total
        step = law.update(count, threshold, force, limit, slipping=slipping)
        assert -SETTINGS.back_off * SETTINGS.window - 1e-18 <= step <= SETTINGS.max_step + 1e-18
        assert 0.0 <= law.total <= limit
        assert law.total == pytest.approx(before + step, abs=1e-18)


def slipped() -> AdvanceLaw:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    law.update(1000, 60.0, 0.5, LIMIT, slipping=True)
    return law


def test_it_holds_and_then_returns_slowly_to_the_preload() -> None:
    law = slipped()
    start = law.total
    held = [law.update(30, 60.0, 0.9, LIMIT, slipping=False) for _ in range(HOLD)]
    assert held == [0.0] * HOLD
    back = [law.update(30, 60.0, 0.9, LIMIT, slipping=False) for _ in range(5)]
    assert back == pytest.approx([-1e-6] * 5)
    assert law.update(30, 60.0, 0.51, LIMIT, slipping=False) == 0.0
    for _ in range(1000):
        law.update(30, 60.0, 0.9, LIMIT, slipping=False)
    assert law.total == 0.0
    assert start > 0.0


def test_slip_while_returning_ends_the_return() -> None:
    law = slipped()
    for _ in range(HOLD + 10):
        law.update(30, 60.0, 0.9, LIMIT, slipping=False)
    floor = law.total
    law.update(100, 60.0, 0.9, LIMIT, slipping=True)
    for _ in range(1000):
        law.update(30, 60.0, 0.9, LIMIT, slipping=False)
    assert law.total == pytest.approx(floor)


def test_the_preload_is_kept_as_the_gel_relaxes() -> None:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    # There was no slip whose advance would be held.
    steps = [law.update(30, 60.0, 0.45, LIMIT, slipping=False) for _ in range(2)]
    assert steps == pytest.approx([2e-6] * 2)
    # It comes up to the preload, and waits until the force has left the band again.
    found = [law.update(30, 60.0, f, LIMIT, slipping=False) for f in (0.495, 0.501, 0.495, 0.45)]
    assert found == pytest.approx([2e-6, 0.0, 0.0, 2e-6])
    assert AdvanceLaw(SETTINGS).update(30, 60.0, 0.0, LIMIT, slipping=False) == 0.0


@pytest.mark.parametrize('stiffness', [700.0, 1e3, 1e4])
def test_a_wanted_force_is_approached_as_fast_on_soft_contacts_as_on_stiff_ones(
    stiffness: float,
) -> None:
    law = AdvanceLaw(dataclasses.replace(SETTINGS, preload_rate=0.4, preload_speed=6e-4))
    law.reset(preload=0.5)
    law.aim(0.7, stiffness)
    steps = [law.update(30, 60.0, 0.5, LIMIT, slipping=False) for _ in range(2)]
    assert stiffness * sum(steps) == pytest.approx(2 * 0.4e-3)
    law.aim(0.7, 100.0)  # softer than its largest speed can follow
    assert law.update(30, 60.0, 0.5, LIMIT, slipping=False) == pytest.approx(6e-7)


@pytest.mark.parametrize('slip', [False, True])
def test_what_was_added_is_returned_and_held_first_only_after_a_slip(slip: bool) -> None:
    law = AdvanceLaw(SETTINGS)
    law.reset(preload=0.5)
    law.add(5e-6)
    assert law.total == 5e-6
    if slip:
        law.update(30, 60.0, 0.9, LIMIT, slipping=True)
    wait = HOLD if slip else 0
    held = [law.update(30, 60.0, 0.9, LIMIT, slipping=False) for _ in range(wait + 1)]
    assert held == pytest.approx([0.0] * wait + [-1e-6])


@pytest.mark.parametrize('stiffness', [1e3, 1e4])
def test_a_slip_without_events_is_answered_by_a_rising_force(stiffness: float) -> None:
    law = AdvanceLaw(dataclasses.replace(SETTINGS, slip_rate=20.0))
    law.reset(preload=0.5)
    law.aim(0.5, stiffness)
    steps = [law.update(10, 60.0, 0.5, LIMIT, slipping=True) for _ in range(3)]
    assert stiffness * sum(steps) == pytest.approx(3 * 0.02)
    # It is the least: events ask for more.
    assert law.update(760, 60.0, 0.5, LIMIT, slipping=True) == pytest.approx(700 * 0.5 / 1e7)
    assert law.update(10, 60.0, 0.5, LIMIT, slipping=False) == 0.0


@pytest.mark.parametrize(('detector', 'stiffness'), [('count', 1e3), ('flow', 1.0)])
def test_that_rise_is_for_slip_told_by_motion_and_within_the_largest_step(
    detector: str, stiffness: float
) -> None:
    law = AdvanceLaw(dataclasses.replace(SETTINGS, slip_rate=20.0, detector=detector))
    law.reset(preload=0.5)
    law.aim(0.5, stiffness)
    step = law.update(10, 60.0, 0.5, LIMIT, slipping=True)
    assert step == (0.0 if detector == 'count' else SETTINGS.max_step)


def stiffness_after_the_probe(slips_at: int, windows: int) -> float:
    """Return the relative deviation of the stiffness of a contact of 800 N/m, held at 1 N."""
    arm = SimpleNamespace(at=0.0, advance_at=lambda _: arm.at)
    grip = SimpleNamespace(wanted=lambda _: 1.0)
    advance = Advance(SlipControlParameters(), arm, grip)  # type: ignore[arg-type]
    noise = np.random.default_rng(1).normal(0.0, 0.02, windows + 100)
    for index, error in enumerate(noise.tolist()):
        now_s, force = 0.002 * index, 0.4 + 800.0 * arm.at + error
        advance.on_window(2000 * index, now_s)
        advance.on_force(force, 2000 * index, now_s, 0.04)
        if index == 100:
            advance.start()
        if index > 100:
            detectors = SimpleNamespace(slipping=index == slips_at, law_threshold=0.0)
            advance.update(0, detectors, force, now_s)  # type: ignore[arg-type]
            arm.at = advance.total
    assert not advance.bound.probe.active
    return advance.bound.stiffness.deviation / 800.0


def test_what_keeps_the_force_teaches_the_stiffness_until_the_first_slip() -> None:
    probed = stiffness_after_the_probe(-1, 160)
    assert stiffness_after_the_probe(-1, 800) < 0.6 * probed
    slipped = stiffness_after_the_probe(261, 800)
    assert slipped == pytest.approx(stiffness_after_the_probe(-1, 162), rel=0.2)
