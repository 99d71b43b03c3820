# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lens calibration against rendered boards and lenses of known truth, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_camera import (
    COLUMNS,
    HEIGHT,
    ROWS,
    SQUARE_M,
    WIDE,
    WIDTH,
    BoardCamera,
    corners,
    good_poses,
    perfect_views,
)

from mixtac_driver.calibration import Board, RefusedError, ViewSelection, calibrate, find_board
from mixtac_driver.camera_info import MODELS

BOARD = Board(COLUMNS, ROWS, SQUARE_M)
STRAIGHT = (np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.03]))
TILTED = (np.array([0.4, -0.35, 0.2]), np.array([0.008, -0.006, 0.032]))
RIM = (np.array([-0.1, -0.5, 0.1]), np.array([-0.028, 0.008, 0.03]))


@pytest.fixture(scope='module')
def camera():
    return BoardCamera()


@pytest.mark.parametrize('pose', [STRAIGHT, TILTED, RIM])
@pytest.mark.parametrize(
    ('look', 'limit_px'),
    [({}, 0.2), ({'contrast': 0.15}, 0.45), ({'noise': 15.0}, 0.35), ({'blur': 1.8}, 0.5)],
    ids=['plain', 'low-contrast', 'noise', 'blur'],
)
def test_corners_are_where_the_board_is(camera, pose, look, limit_px):
    view = find_board(camera.image(*pose, np.random.default_rng(1), **look), BOARD, 'here')
    assert view is not None
    assert (view.width, view.height, view.label) == (WIDTH, HEIGHT, 'here')
    truth = corners('equidistant', *pose)
    # A board of 9 x 6 corners looks the same upside down.
    errors = [
        np.sqrt(((view.corners - each) ** 2).sum(axis=1).mean()) for each in (truth, truth[::-1])
    ]
    assert min(errors) < limit_px


@pytest.mark.parametrize(
    'image',
    [
        np.zeros((260, 346), np.uint16),
        np.full((260, 346), 200, np.uint8),
        np.random.default_rng(0).integers(0, 65536, (260, 346)).astype(np.uint16),
    ],
    ids=['black', 'grey', 'noise'],
)
def test_no_board_is_found_where_there_is_none(image):
    assert find_board(image, BOARD) is None


def test_rendered_frames_give_the_lens_back(camera):
    rng = np.random.default_rng(7)
    held = good_poses('equidistant', 14, 11, 10)
    views = [find_board(camera.image(*each, rng), BOARD) for each in held]
    solution = calibrate([each for each in views if each is not None])
    found = solution.parameters()
    for name, value in zip(('fx', 'fy', 'cx', 'cy'), WIDE['equidistant'], strict=False):
        assert found[name][0] == pytest.approx(value, abs=1.6)
    assert solution.rms_px < 0.3


@pytest.mark.parametrize('model', ['equidistant', 'plumb_bob'])
def test_deviations_describe_the_errors(model):
    scores = []
    for seed in range(8):
        found = calibrate(perfect_views(model, 20, seed), model=model).parameters()
        truth = dict(zip(('fx', 'fy', 'cx', 'cy'), WIDE[model], strict=False))
        scores += [(found[name][0] - truth[name]) / found[name][1] for name in truth]
    # Mean square of 32 standard scores: 1 with a spread of some 0.3. OpenCV 4 counts each corner
    # as one measurement, which doubles the variance.
    assert 0.3 < np.mean(np.square(scores)) < 2.5


@pytest.mark.parametrize('model', MODELS)
def test_bad_views_are_removed(model):
    views = perfect_views(model, 24, 2)
    rng = np.random.default_rng(0)
    for index in (4, 17):
        noise = rng.normal(0, 2.0, (54, 2))
        views[index] = replace(views[index], corners=views[index].corners + noise)
    solution = calibrate(views, model=model)
    assert {view.label for view, _ in solution.removed} == {'4', '17'}
    assert solution.rms_px < 0.1


def reason(views, **options):
    with pytest.raises(RefusedError) as caught:
        calibrate(views, **options)
    return caught.value.reason


def test_too_few_views_are_refused():
    assert reason([]) == 'too few views'
    assert reason(perfect_views('equidistant', 7, 1)) == 'too few views'


def test_views_of_the_middle_only_are_refused():
    rng = np.random.default_rng(0)
    depths = [0.05, 0.09] * 10
    held = [
        (rng.uniform(-0.7, 0.7, 3), np.append(rng.uniform(-1, 1, 2) * 0.002, z)) for z in depths
    ]
    assert reason(perfect_views('equidistant', 20, 1, held=held)) == 'views do not cover the image'


def test_a_wrong_board_is_refused():
    rng = np.random.default_rng(0)
    views = perfect_views('equidistant', 20, 1)
    shaken = [replace(v, corners=v.corners + rng.normal(0, 2.5, (54, 2))) for v in views]
    assert reason(shaken) in ('large reprojection error', 'uncertain focal length', 'no fit')


def test_a_view_is_kept_once_and_the_selection_completes():
    selection = ViewSelection()
    views = perfect_views('equidistant', 60, 1)
    assert selection.offer(views[0])
    assert not selection.offer(views[0])
    assert not selection.complete
    for view in views:
        selection.offer(view)
    assert len(selection.views) > 10
    assert min(selection.progress().values()) > 0.5
