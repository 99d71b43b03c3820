# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Moments of a displacement: press, width, pull and turning of a contact anywhere."""

from __future__ import annotations

import numpy as np
import pytest
from toy_sensor import displacement

from mixtac_fger.config import MOMENTS, PRESSES, FgerConfig
from mixtac_fger.moments import PEAK_SHARE, contact_of, moments, moments_of_cells

ROWS, COLUMNS = FgerConfig().frame_shape
MIDDLE = 0.5 * (COLUMNS - 1), 0.5 * (ROWS - 1)


def found(*where, **load):
    """Return press, pull, lean and turning of a displacement."""
    out = np.zeros(MOMENTS, np.float32)
    moments(displacement(*where, **load), out)
    return out[0], out[PRESSES:][:2], out[PRESSES + 2 :][:2], out[-4:]


def test_the_turning_is_told_about_a_contact_anywhere_under_any_pull():
    plain = found((42.0, 32.0), press=0.1, turn=0.05)[3]
    assert (plain > 0.0).all()
    other = found((42.0, 32.0), press=0.1, turn=-0.1)[3]
    np.testing.assert_allclose(other, -2.0 * plain, rtol=1e-3)
    for place in ((42.0, 32.0), (36.0, 35.5)):
        for pull in ((1.0, 0.0), (-0.4, 0.9)):
            turning = found(place, press=0.1, pull=pull, turn=0.05)[3]
            # A pull moves the mean along itself, out of the middle of the narrowest sum.
            np.testing.assert_allclose(turning[:3], plain[:3], rtol=0.15)


def test_a_press_and_a_pull_turn_nothing_and_nothing_has_no_moment():
    turned = found((42.0, 32.0), press=0.1, turn=0.05)[3]
    for pull in ((0.0, 0.0), (1.0, 0.0), (-0.4, 0.9)):
        turning = found((40.0, 30.0), press=0.1, pull=pull)[3]
        assert np.abs(turning[:3] / turned[:3]).max() < 0.03
    assert all(not np.any(each) for each in found((40.0, 30.0)))


def test_a_press_is_told_anywhere_under_any_load_across():
    plain = found(MIDDLE, press=0.1)[0]
    assert plain > 0.0
    for load in ({}, {'turn': 0.05}, {'pull': (0.3, -0.2)}):
        for place in (MIDDLE, (36.0, 35.5)):
            np.testing.assert_allclose(found(place, press=0.1, **load)[0], plain, rtol=0.05)
    np.testing.assert_allclose(found(MIDDLE, press=0.2)[0], 2.0 * plain, rtol=1e-3)


def test_a_pull_is_told_in_axes_of_the_contact_frame():
    for place in (MIDDLE, (36.0, 35.5)):
        pull = found(place, press=0.1, pull=(0.3, -0.2))[1]
        still = found(place, press=0.1)
        change = pull - still[1]
        assert change[0] > 0.0  # to the right
        assert change[1] > 0.0  # upwards, as y grows downwards in the image
        np.testing.assert_allclose(change[0] / change[1], 1.5, rtol=0.1)
        away = np.array([place[0] - MIDDLE[0], MIDDLE[1] - place[1]]) / 21.0
        np.testing.assert_allclose(still[2], still[0] * away, atol=1e-3)


@pytest.mark.parametrize('place', [MIDDLE, (36.0, 35.5), (55.0, 24.0)])
def test_cells_of_a_grid_add_up_to_the_moments(place):
    shape, grid = (ROWS, COLUMNS), (13, 17)
    moved = displacement(place, press=0.1, pull=(0.3, -0.2), turn=0.05, width=12.0)
    whole = np.zeros(MOMENTS, np.float32)
    moments(moved, whole)
    contact = contact_of(whole, shape)
    np.testing.assert_allclose(contact[:2], place, atol=2.0)
    # Cells whose sides are whole bins: 5 by 5 of 65 by 85.
    means = moved[:, :, :85].reshape(2, 13, 5, 17, 5).mean(axis=(2, 4)).transpose(1, 2, 0)
    per_cell = np.empty((MOMENTS, *grid, 2))
    moments_of_cells(contact, (ROWS, 85), per_cell)
    added = np.tensordot(per_cell, means, 3)
    # The lean is the press times the place; both are of the one grid.
    np.testing.assert_allclose(added[: PRESSES + 2], whole[: PRESSES + 2], rtol=0.05)
    np.testing.assert_allclose(added[-3:], whole[-3:], rtol=0.1)
    assert contact_of(0.0 * whole, shape)[:2] == MIDDLE


@pytest.mark.parametrize('width', [10.0, 15.0])
def test_the_width_is_that_of_the_divergence(width):
    y, x = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x, y = x - MIDDLE[0], y - MIDDLE[1]
    square = (x**2 + y**2) / width**2
    # The divergence of (x, y) exp(-square / 2), above its share of the peak.
    weight = np.maximum((2.0 - square) * np.exp(-0.5 * square) - 2.0 * PEAK_SHARE, 0.0)
    expected = np.sum(weight * (x**2 + y**2)) / np.sum(weight)
    out = np.zeros(MOMENTS, np.float32)
    moments(displacement(MIDDLE, press=0.1, width=width), out)
    # The differences are over eight bins.
    assert out[1] / out[0] == pytest.approx(expected, rel=0.2)
    assert contact_of(out, (ROWS, COLUMNS))[2] == pytest.approx(out[1] / out[0])
