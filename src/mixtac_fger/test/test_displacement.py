# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Growth of the gel: dilated textures, presses, and both at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates

from mixtac_fger.config import MOMENTS, FgerConfig
from mixtac_fger.displacement import LEAST_GROWTH, Growth
from mixtac_fger.features import Contrast, FramePreparation
from mixtac_fger.moments import moments

CONFIG = FgerConfig()
SHAPE = CONFIG.frame_shape
PLACES = np.stack(np.meshgrid(*(np.arange(n) - 0.5 * (n - 1) for n in SHAPE[::-1])))


def textured(seed: int, growth: float) -> np.ndarray:
    """Return a random texture of a gel that has grown."""
    picture = gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), 2.5)
    middle = 0.5 * (np.array(SHAPE)[:, None, None] - 1)
    places = middle + PLACES[::-1] / (1.0 + growth)
    grown = map_coordinates(picture, places, order=5, mode='nearest')
    return np.asarray(0.3 * grown / picture.std(), np.float32)


def pressed(strength: float, x: float, width: float) -> np.ndarray:
    """Return the displacement by a contact to the right of the middle [bins]."""
    away = PLACES - np.array([x, 0.0])[:, None, None]
    return strength * away / width / (1.0 + np.sum(away**2, axis=0) / width**2) ** 1.5


def followed(growth: Growth, contacts: list[np.ndarray], grown: np.ndarray) -> None:
    """Add frames with a contact and a growth each."""
    found = np.empty(MOMENTS, np.float32)
    for contact, share in zip(contacts, grown, strict=True):
        flow = (contact + (share - growth.value) * PLACES).astype(np.float32)
        moments(flow, found)
        growth.follow(flow, float(found[0]))


@settings(max_examples=10, deadline=None)
@given(growth=st.floats(-0.005, 0.005), seed=st.integers(0, 99))
def test_a_growth_is_found_within_a_tenth_and_leaves_the_input(growth, seed):
    preparation = FramePreparation(CONFIG)
    reference, image = textured(seed, 0.0), textured(seed, growth)
    before = abs(preparation.compare(Contrast(image, image), reference)[0][0])
    for _ in range(40):
        press = preparation.compare(Contrast(image, image), reference)[0][0]
    left = 0.1 * abs(growth) + 2.0 * LEAST_GROWTH
    assert preparation.growth == pytest.approx(growth, abs=left)
    assert abs(press) < 0.1 * before + 4000.0 * LEAST_GROWTH


@settings(max_examples=8, deadline=None)
@given(strength=st.floats(0.2, 2.0), x=st.floats(-15.0, 15.0), width=st.floats(8.0, 14.0))
def test_a_press_and_a_long_hold_are_no_growth_and_growth_under_it_is_found(strength, x, width):
    growth, contact = Growth(SHAPE), pressed(strength, x, width)
    onset = [share * contact for share in np.linspace(0.0, 1.0, 6)]
    followed(growth, onset + 500 * [contact], np.zeros(506))
    assert abs(growth.value) < 2e-4
    followed(growth, 400 * [contact], np.append(np.linspace(0.0, 0.004, 300), np.full(100, 0.004)))
    assert growth.value == pytest.approx(0.004, abs=4e-4)
    followed(growth, onset[::-1] + 20 * onset[:1], np.full(26, 0.004))
    assert growth.value == pytest.approx(0.004, abs=1.1 * LEAST_GROWTH)


def test_frames_that_no_contact_explains_say_nothing_of_the_growth():
    preparation, reference = FramePreparation(CONFIG), textured(1, 0.0)
    for seed in range(2, 32):
        other = textured(seed, 0.0)
        _, picture = preparation.compare(Contrast(other, other), reference)
        assert picture.unexplained() > 1.0
    assert preparation.growth == 0.0


def test_another_reference_starts_anew():
    preparation, grown = FramePreparation(CONFIG), textured(1, 0.004)
    for reference in (textured(1, 0.0), grown):
        for _ in range(30):
            preparation.compare(Contrast(grown, grown), reference)
    assert preparation.growth == 0.0
