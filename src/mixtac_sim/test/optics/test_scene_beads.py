# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Discs: exact removal, place, sum, and what is marked as changed."""

import numpy as np

from mixtac_sim.grids import HEIGHT, PIXELS, TILE, WIDTH
from mixtac_sim.optics.scene import ONE, Renderer


def spots(*rows):
    return np.array(rows, np.float64)


def image(renderer):
    return renderer.cover[:PIXELS].reshape(HEIGHT, WIDTH) / ONE


def test_moving_there_and_back_leaves_no_trace():
    rng = np.random.default_rng(1)
    renderer = Renderer(rng.uniform(1.0, 3.0, 50))
    home = np.column_stack(
        [rng.uniform(-5, 350, 50), rng.uniform(-5, 265, 50), np.full(50, 5.0), np.full(50, 2.0)]
    )
    renderer.draw(home)
    before = renderer.cover.copy()
    for _ in range(20):
        renderer.draw(home + rng.normal(0.0, 1.0, home.shape) * [1, 1, 0.1, 0.1])
    renderer.draw(home)
    np.testing.assert_array_equal(renderer.cover, before)


def test_disc_is_where_it_was_put():
    renderer = Renderer(np.array([2.0]))
    renderer.draw(spots((100.3, 80.7, 5.0, 2.0)))
    drawn = image(renderer)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    assert np.isclose((drawn * columns).sum() / drawn.sum(), 100.3, atol=0.02)
    assert np.isclose((drawn * rows).sum() / drawn.sum(), 80.7, atol=0.02)
    assert np.isclose(drawn[81, 100], 2.0, rtol=0.02)
    assert drawn[81, 108] == 0.0


def test_blur_spreads_the_edge_and_not_the_area():
    areas = []
    for width in (1.5, 4.0):
        renderer = Renderer(np.array([1.0]))
        renderer.draw(spots((50.0, 50.0, 6.0, width)))
        areas.append(image(renderer).sum())
    assert np.isclose(areas[0], areas[1], rtol=0.06)


def test_only_tiles_that_changed_are_marked():
    renderer = Renderer(np.array([2.0, 2.0]))
    renderer.draw(spots((100.0, 80.0, 5.0, 2.0), (200.0, 200.0, 5.0, 2.0)))
    renderer.dirty[:] = 0
    before = renderer.cover.copy()
    renderer.draw(spots((101.0, 80.0, 5.0, 2.0), (200.0, 200.0, 5.0, 2.0)))
    changed = np.flatnonzero((renderer.cover != before).reshape(-1, TILE).any(axis=1))
    assert set(changed) <= set(np.flatnonzero(renderer.dirty))
    assert 0 < renderer.dirty.sum() < 60


def test_beads_outside_the_view_do_no_harm():
    renderer = Renderer(np.array([2.0, 2.0]))
    renderer.draw(spots((-100.0, 80.0, 5.0, 2.0), (200.0, 600.0, 5.0, 2.0)))
    assert not renderer.cover.any()
