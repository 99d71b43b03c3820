# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The laws on a contact that is simulated here: linear, late, noisy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.law import AdvanceLaw, Phase, paper_advance
from mixtac_slip_control.parameters import SlipControlParameters


class Grasp:
    """A law that presses on a spring; force arrives some windows late, with noise."""

    def __init__(
        self,
        stiffness: float = 5e3,
        start: float = 0.5,
        *,
        gain: float = 1.0,
        noise: float = 0.01,
        late: int = 10,
        seed: int = 0,
        **changes: object,
    ) -> None:
        self.parameters = SlipControlParameters(**changes)
        self.law = AdvanceLaw(lambda: self.parameters)
        self.stiffness, self.first, self.gain, self.noise = stiffness, start, gain, noise
        self.past = [0.0] * (late + 1)
        self.rng = np.random.default_rng(seed)
        self.peak = 0.0
        for _ in range(300):
            self.law.on_force(self._measured(0.0), 0.0, 0.0, calm=True, enabled=False)
        self.law.start(0.0)

    def _measured(self, advance: float) -> float:
        true = self.first + self.stiffness * advance
        return self.gain * true + self.rng.normal(0.0, self.noise)

    @property
    def force(self) -> float:
        """True force [N]."""
        return self.first + self.stiffness * self.law.total

    def step(self, *, slipping: bool = False, count: int = 30) -> float:
        then = self.past.pop(0)
        measured = self._measured(then)
        self.law.on_force(measured, then, 0.0, calm=not slipping, enabled=True)
        change = self.law.update(count, 60.0, self.law.total, measured, slipping=slipping)
        self.past.append(self.law.total)
        self.peak = max(self.peak, self.force)
        return change

    def rest(self, windows: int) -> Grasp:
        for _ in range(windows):
            self.step()
        return self


def test_the_law_of_the_paper_is_as_printed() -> None:
    assert paper_advance(160, 60.0, 2e-7) == pytest.approx(2e-5)
    assert paper_advance(60, 60.0, 2e-7) == 0.0
    assert paper_advance(10, 60.0, 2e-7) == 0.0


def test_the_paper_neither_presses_nor_holds_nor_returns() -> None:
    grasp = Grasp(law='paper')
    assert grasp.rest(500).law.total == 0.0
    assert grasp.step(count=100, slipping=True) == pytest.approx(2e-7 * 40.0)
    before = grasp.law.total
    assert grasp.rest(2000).law.total == before


@pytest.mark.parametrize('gain', [0.8, 1.0, 1.25])
@pytest.mark.parametrize('stiffness', [1e3, 5e3, 1e4])
def test_the_press_reaches_the_margin_whatever_the_gain_of_the_sensor(
    stiffness: float, gain: float
) -> None:
    grasp = Grasp(stiffness, gain=gain).rest(1000)
    assert grasp.law.step.phase is Phase.KEEP
    assert grasp.force / grasp.first == pytest.approx(1.3, abs=0.12)
    assert grasp.law.contact.stiffness == pytest.approx(gain * stiffness, rel=0.3)


def test_a_slip_is_answered_by_one_step_that_is_held_and_taken_back() -> None:
    grasp = Grasp().rest(1000)
    pressed = grasp.law.total
    assert grasp.step(slipping=True) > 0.0
    answer = grasp.law.total
    for _ in range(10):
        assert grasp.step(slipping=True) == pytest.approx(0.0, abs=1e-6)
    assert 0.8 < grasp.force <= 1.0
    grasp.step()
    assert grasp.law.step.phase is Phase.HOLD
    assert grasp.rest(250).law.total >= answer
    assert grasp.force == pytest.approx(1.0, abs=0.03)
    grasp.rest(10_000)
    assert grasp.law.step.phase is Phase.KEEP
    assert grasp.law.total == pytest.approx(pressed, abs=1.5e-5)


def test_a_return_that_led_to_a_slip_is_not_repeated() -> None:
    grasp = Grasp().rest(1000)
    grasp.step(slipping=True)
    grasp.rest(1200)
    assert grasp.law.step.phase is Phase.RETURN
    floor = grasp.law.total
    grasp.step(slipping=True)
    assert grasp.rest(10_000).law.total >= floor - 1e-9


@pytest.mark.parametrize(('start', 'answer'), [(0.5, 1.0), (0.9, 1.08), (1.15, 1.245)])
def test_a_slip_that_goes_on_is_answered_up_to_a_force_that_suits_the_grasp(
    start: float, answer: float
) -> None:
    grasp = Grasp(start=start, noise=0.0).rest(1000)
    for _ in range(400):
        grasp.step(slipping=True)
    assert 0.8 * answer < grasp.force <= answer


def test_the_press_of_a_heavy_object_uses_the_whole_usable_force() -> None:
    grasp = Grasp(2e3, 1.1, noise=0.0).rest(1000)
    assert grasp.force == pytest.approx(grasp.parameters.usable_force, abs=0.02)


def test_a_slip_before_anything_was_measured_does_not_drop_a_soft_object() -> None:
    """The bound of the stiffest contact relaxes as the force does not rise with the advance."""
    grasp = Grasp(1e3)
    for _ in range(150):
        grasp.step(slipping=True)
    assert grasp.force > 0.8
    stiff = Grasp(1e4)
    for _ in range(150):
        stiff.step(slipping=True)
    assert stiff.peak < stiff.parameters.max_force


def test_a_force_that_relaxes_is_restored() -> None:
    grasp = Grasp().rest(1000)
    grasp.first -= 0.08
    assert grasp.rest(3000).force == pytest.approx(1.3 * 0.5, abs=0.06)


@pytest.mark.parametrize('start', [1.25, 1.5])
def test_a_force_without_room_is_refused_and_both_forces_are_named(start: float) -> None:
    with pytest.raises(SlipControlError) as caught:
        Grasp(start=start)
    for named in (f'{SlipControlParameters().usable_force:.2f} N', f'{start:.2f} N', 'force_share'):
        assert named in str(caught.value)


@settings(max_examples=60)
@given(
    law=st.sampled_from(['step', 'paper']),
    stiffness=st.floats(500.0, 1e4),
    start=st.floats(0.1, 1.08),
    gain=st.floats(0.92, 1.08),
    late=st.integers(2, 12),
    seed=st.integers(0, 1000),
)
def test_no_course_of_slips_exceeds_the_force(
    law: str, stiffness: float, start: float, gain: float, late: int, seed: int
) -> None:
    grasp = Grasp(stiffness, start, gain=gain, noise=0.02, late=late, seed=seed, law=law)
    rng = np.random.default_rng(seed)
    left = 0
    for _ in range(1500):
        left = left - 1 if left else int(rng.integers(1, 200)) if rng.random() < 0.01 else 0
        grasp.step(slipping=left > 0, count=int(rng.integers(30, 5000)) if left else 30)
        assert 0.0 <= grasp.law.total <= grasp.parameters.max_total
    assert grasp.peak * gain < 1.05 * grasp.parameters.usable_force
