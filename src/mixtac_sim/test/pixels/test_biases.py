# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bias registers and pixels: jAER's formulas with numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_sim.pixels.biases import (
    DEFAULT_REGISTERS,
    DIFF,
    FOLLOWER,
    OFF,
    ON,
    PHOTORECEPTOR,
    REFRACTORY,
    PixelSettings,
    current_a,
)


def register(coarse, fine, *, enabled=True):
    return enabled | 2 | 4 | 8 | fine << 4 | coarse << 12


def test_currents_are_fractions_of_the_coarse_step():
    assert current_a(register(5, 128)) == pytest.approx(193.75e-9)
    assert current_a(register(5, 128, enabled=False)) < 1e-13
    assert current_a(register(1, 33)) == pytest.approx(12.1e-12, rel=0.01)


def test_known_settings_give_the_known_constants():
    # Diff 4,39; On 6,200; Pr 2,58; SF 1,33; Refr 4,25: 0.41 log-e, 590 Hz, 3.4 us.
    found = PixelSettings.from_formulas(
        {
            DIFF: register(4, 39),
            ON: register(6, 200),
            PHOTORECEPTOR: register(2, 58),
            FOLLOWER: register(1, 33),
            REFRACTORY: register(4, 25),
        }
    )
    assert found.threshold_on == pytest.approx(0.41, abs=0.01)
    assert found.source_follower_hz == pytest.approx(590.0, rel=0.02)
    assert found.refractory_us == pytest.approx(3.4, abs=0.05)


def test_default_registers_are_those_of_the_driver():
    biases = pytest.importorskip('mixtac_driver.davis346.biases')
    wire = {bias.address: bias.encode(None) for bias in biases.DEFAULT_BIASES.values()}
    assert {address: wire[address] for address in DEFAULT_REGISTERS} == dict(DEFAULT_REGISTERS)


def test_defaults_leave_a_chip_as_it_is():
    for registers in ({}, DEFAULT_REGISTERS):
        assert PixelSettings.from_biases(registers) == PixelSettings()


def test_thresholds_go_with_the_logarithm_of_the_current():
    settings = [
        PixelSettings.from_formulas({ON: register(c, 39), OFF: register(4, 1)}) for c in (5, 6, 7)
    ]
    on = [s.threshold_on for s in settings]
    assert np.diff(on) == pytest.approx(np.log(8.0) / 14.0, rel=0.02)
    assert settings[0].threshold_off == pytest.approx(np.log(39.0) / 14.0, rel=0.01)


def test_follower_and_refractory_follow_their_currents():
    registers, usual = {FOLLOWER: register(1, 4), REFRACTORY: register(3, 25)}, PixelSettings()
    slow = PixelSettings.from_biases(registers)
    assert usual.source_follower_hz / slow.source_follower_hz == pytest.approx(4.0)
    assert slow.refractory_us / usual.refractory_us == pytest.approx(8.0, rel=0.01)
    assert slow.shot_hz == pytest.approx(0.25 * usual.shot_hz)


@given(st.dictionaries(st.sampled_from(sorted(DEFAULT_REGISTERS)), st.integers(0, 0xFFFF)))
def test_any_registers_give_possible_settings(registers):
    settings = PixelSettings.from_biases(registers)
    assert settings.threshold_on > 0.0
    assert settings.threshold_off > 0.0
