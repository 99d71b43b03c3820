# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which views are kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_camera import perfect_views

from mixtac_driver.calibration.board import (
    CELLS,
    MAX_VIEWS,
    Verdict,
    ViewSelection,
    coverage,
    coverage_counts,
    measure,
    spread,
)


def straight_view(x, y, z=0.03, turn=(0.0, 0.0, 0.0)):
    return perfect_views('equidistant', 1, 0, 0.0, [(np.array(turn), np.array([x, y, z]))])[0]


def test_measures_follow_the_board():
    left, right = measure(straight_view(-0.02, 0.0)), measure(straight_view(0.02, 0.0))
    up, down = measure(straight_view(0.0, -0.012)), measure(straight_view(0.0, 0.012))
    near, far = measure(straight_view(0, 0, 0.022)), measure(straight_view(0, 0, 0.05))
    flat, tilted = measure(straight_view(0, 0)), measure(straight_view(0, 0, turn=(0.5, 0.5, 0)))
    assert left.x < 0.3 < 0.7 < right.x
    assert up.y < 0.3 < 0.7 < down.y
    assert far.size < near.size
    assert tilted.skew > flat.skew + 0.2
    assert all(0.0 <= each <= 1.0 for m in (left, right, up, down, near, far) for each in m)


def test_a_full_turn_of_the_board_changes_nothing_but_skew_noise():
    view = straight_view(0.005, 0.004)
    upside_down = replace(view, corners=view.corners[::-1].copy())
    assert measure(view).distance(measure(upside_down)) < 0.05


def test_coverage_counts_every_corner_once():
    views = perfect_views('equidistant', 12, 3)
    counts = coverage_counts(views)
    assert counts.shape == CELLS[::-1]
    assert counts.sum() == 12 * 54
    assert coverage(views) == pytest.approx((counts > 0).sum() / 48)
    assert coverage([]) == 0.0
    assert spread([]) == (0, 0, 0, 0)


def test_the_same_view_is_kept_once():
    selection = ViewSelection()
    assert selection.offer(straight_view(0, 0)) is Verdict.KEPT
    assert selection.offer(straight_view(0.0005, 0)) is Verdict.ALIKE
    assert selection.offer(straight_view(0.02, 0)) is Verdict.KEPT
    assert len(selection.views) == len(selection.measures) == 2
    assert selection.verdicts[Verdict.KEPT] == 2


@pytest.mark.parametrize('edge_px', [6.5, 50.0])
def test_blurred_views_are_not_kept(edge_px):
    selection = ViewSelection()
    assert selection.offer(replace(straight_view(0, 0), edge_px=edge_px)) is Verdict.BLURRED
    assert not selection.views


def test_varied_views_complete_it_and_a_pile_of_views_is_bounded():
    selection = ViewSelection()
    assert not selection.complete
    for view in perfect_views('equidistant', 200, 5):
        selection.offer(view)
    assert selection.complete
    assert len(selection.views) <= MAX_VIEWS


def test_views_from_one_place_never_complete_it():
    selection = ViewSelection()
    rng = np.random.default_rng(0)
    for _ in range(100):
        selection.offer(straight_view(*rng.normal(0, 0.001, 2)))
    assert not selection.complete
