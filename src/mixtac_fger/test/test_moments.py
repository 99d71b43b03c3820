# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Moments of a displacement: each load has its own, anywhere, and none of the others'."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_fger.config import MOMENTS, FgerConfig
from mixtac_fger.moments import contact_of, moments, moments_of_cells

ROWS, COLUMNS = FgerConfig().frame_shape
MIDDLE = 0.5 * (COLUMNS - 1), 0.5 * (ROWS - 1)


def displacement(place, press=0.0, pull=(0.0, 0.0), turn=0.0, width=8.0):
    """Return the displacement [2, rows, columns] under a contact, y downwards [bins]."""
    y, x = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x, y = x - place[0], y - place[1]
    near = np.exp(-(x**2 + y**2) / (2.0 * width**2))
    # Skin moves away from a press; a turn from x to y as the contact frame has them, y upwards.
    moved = press * near * np.stack([x, y]) + near * np.reshape(pull, (2, 1, 1))
    return (moved + turn * near * np.stack([y, -x])).astype(np.float32)


def found(*where, **load):
    """Return press, pull, lean and turning of a displacement."""
    out = np.zeros(MOMENTS, np.float32)
    moments(displacement(*where, **load), out)
    return out[0], out[1:3], out[3:5], out[5:]


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
            press = found(place, press=0.1, **load)[0]
            np.testing.assert_allclose(press, plain, rtol=0.05)
    np.testing.assert_allclose(found(MIDDLE, press=0.2)[0], 2.0 * plain, rtol=1e-3)


def test_a_pull_is_told_in_axes_of_the_contact_frame():
    for place in (MIDDLE, (36.0, 35.5)):
        press, pull, lean, _ = found(place, press=0.1, pull=(0.3, -0.2))
        still = found(place, press=0.1)
        change = pull - still[1]
        assert change[0] > 0.0  # to the right
        assert change[1] > 0.0  # upwards, as y grows downwards in the image
        np.testing.assert_allclose(change[0] / change[1], 1.5, rtol=0.1)
        away = np.array([place[0] - MIDDLE[0], MIDDLE[1] - place[1]]) / 21.0
        np.testing.assert_allclose(still[2], still[0] * away, atol=1e-3)
        assert press > 0.0
        assert np.shape(lean) == (2,)


def test_what_is_not_finite_ends_nothing():
    spoilt = displacement((42.0, 32.0), press=0.1)
    spoilt[0, 20, 20] = np.nan
    moments(spoilt, np.zeros(MOMENTS, np.float32))


@pytest.mark.parametrize('place', [MIDDLE, (36.0, 35.5), (55.0, 24.0)])
def test_cells_of_a_grid_add_up_to_the_moments(place):
    shape, grid = (ROWS, COLUMNS), (13, 17)
    moved = displacement(place, press=0.1, pull=(0.3, -0.2), turn=0.05, width=12.0)
    whole = np.zeros(MOMENTS, np.float32)
    moments(moved, whole)
    contact = contact_of(whole, shape)
    np.testing.assert_allclose(contact, place, atol=2.0)
    # Cells whose sides are whole bins: 5 by 5 of 65 by 85.
    means = moved[:, :, :85].reshape(2, 13, 5, 17, 5).mean(axis=(2, 4)).transpose(1, 2, 0)
    per_cell = np.empty((MOMENTS, *grid, 2))
    moments_of_cells(contact, (ROWS, 85), per_cell)
    added = np.tensordot(per_cell, means, 3)
    # The lean is the press times the place; both are of the one grid.
    np.testing.assert_allclose(added[:3], whole[:3], rtol=0.05)
    np.testing.assert_allclose(added[6:], whole[6:], rtol=0.1)


def test_the_contact_stays_within_the_picture():
    whole = np.zeros(MOMENTS, np.float32)
    assert contact_of(whole, (ROWS, COLUMNS)) == MIDDLE
    whole[:] = 1e-3, 0.0, 0.0, 5.0, -5.0, *(0.0,) * (MOMENTS - 5)
    assert contact_of(whole, (ROWS, COLUMNS)) == (COLUMNS - 1.0, ROWS - 1.0)
