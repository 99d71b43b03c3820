# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The shift of a picture: of the whole, and not of a wide contact that is pulled; its shading."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mixtac_fger.pictures import PictureFigures, picture_figures

SHAPE = (60, 80)


def figures(flow_x: np.ndarray) -> PictureFigures:
    picture = np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)
    flow = np.zeros((2, *SHAPE), np.float32)
    flow[0] = flow_x
    return PictureFigures(*picture_figures(picture, picture, flow))


def test_a_camera_that_moved_shifts_everything() -> None:
    assert figures(np.full(SHAPE, 0.4)).shift == pytest.approx(0.4)


def test_a_wide_contact_that_is_pulled_is_no_shift() -> None:
    pulled = np.zeros(SHAPE)
    # More than half of the tiles, but those along the border are mostly still.
    pulled[10:, 10:70] = 0.4
    found = figures(pulled)
    assert found.shift == 0.0
    assert found.displacement == pytest.approx(0.4)


def test_light_shades_a_picture_and_beads_that_move_do_not() -> None:
    beads = np.random.default_rng(0).normal(size=SHAPE).repeat(4, 0).repeat(4, 1)[:60, :80]
    reference = np.asarray(beads, np.float32)
    flow = np.zeros((2, *SHAPE), np.float32)
    # Two bins to the right in a part of the picture.
    flow[0, 20:40, 20:50] = 2.0
    moved = np.where(flow[0] > 0.0, np.roll(reference, 2, 1), reference)
    lit = moved + 0.3 * (np.arange(80) > 60).astype(np.float32)
    still, shaded = (
        PictureFigures(*picture_figures(reference, image, flow)) for image in (moved, lit)
    )
    assert still.shading < 1e-3
    assert shaded.shading == shaded.still_shading == pytest.approx(0.3, abs=0.01)


def test_a_contact_shades_tiles_that_move_and_no_others() -> None:
    picture = np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)
    flow, darker = np.zeros((2, *SHAPE), np.float32), picture.copy()
    flow[0, 20:30, 20:30] = 1e-6
    flow[1, 20:30, 20:30] = 0.5
    darker[20:30, 20:30] -= 0.2
    found = PictureFigures(*picture_figures(picture, darker, flow))
    assert found.shading > 0.1
    assert found.still_shading < 1e-6


def test_a_lens_out_of_focus_takes_the_sharpness_and_a_contact_does_not() -> None:
    random = np.random.default_rng(1)
    reference = gaussian_filter(random.normal(size=SHAPE), 1.0).astype(np.float32)
    flow = np.zeros((2, *SHAPE), np.float32)
    pressed = reference.copy()
    pressed[20:35, 20:40] *= 0.3

    def sharpness(image: np.ndarray) -> float:
        return PictureFigures(*picture_figures(reference, image, flow)).sharpness

    assert sharpness(reference) == pytest.approx(1.0)
    assert sharpness(pressed) == pytest.approx(1.0)
    assert sharpness(gaussian_filter(reference, 0.8)) < 0.7
    assert sharpness(1.5 * reference) == pytest.approx(2.25, rel=0.05)
