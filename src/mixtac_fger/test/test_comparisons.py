# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The shift of a picture: of the whole, and not of a wide contact that is pulled; its shading."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_fger.comparisons import PictureFigures, picture_figures

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
    assert shaded.shading == pytest.approx(0.3, abs=0.01)
