# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Corners in frames of known truth."""

from __future__ import annotations

import numpy as np
import pytest
from board_camera import COLUMNS, HEIGHT, ROWS, SQUARE_M, WIDTH, BoardCamera, corners

from mixtac_driver.calibration.board import Board, find_board
from mixtac_driver.calibration.lens import CalibrationError

BOARD = Board(COLUMNS, ROWS, SQUARE_M)
STRAIGHT = (np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.03]))
TILTED = (np.array([0.4, -0.35, 0.2]), np.array([0.008, -0.006, 0.032]))
RIM = (np.array([-0.1, -0.5, 0.1]), np.array([-0.028, 0.008, 0.03]))


@pytest.fixture(scope='module')
def camera():
    return BoardCamera('equidistant')


def error_px(view, pose):
    truth = corners('equidistant', *pose)
    # A board of 9 x 6 corners looks the same upside down.
    return min(
        np.sqrt(((view.corners - each) ** 2).sum(axis=1).mean()) for each in (truth, truth[::-1])
    )


@pytest.mark.parametrize('pose', [STRAIGHT, TILTED, RIM])
@pytest.mark.parametrize(
    ('look', 'limit_px'),
    [
        ({}, 0.2),
        ({'contrast': 0.15}, 0.45),
        ({'noise': 15.0}, 0.35),
        ({'blur': 1.8}, 0.5),
        ({'light': 120.0, 'contrast': 0.4}, 0.45),
    ],
    ids=['plain', 'low-contrast', 'noise', 'blur', 'dark'],
)
def test_corners_are_where_the_board_is(camera, pose, look, limit_px):
    image = camera.image(*pose, np.random.default_rng(1), **look)
    view = find_board(image, BOARD, 'here', thorough=True)
    assert view is not None
    assert (view.width, view.height, view.label) == (WIDTH, HEIGHT, 'here')
    assert error_px(view, pose) < limit_px


def test_eight_bit_frames_do_as_well(camera):
    image = (camera.image(*TILTED, np.random.default_rng(1)) >> 8).astype(np.uint8)
    view = find_board(image, BOARD)
    assert view is not None
    assert error_px(view, TILTED) < 0.25


def test_right_justified_ten_bit_frames_do_as_well(camera):
    view = find_board(camera.image(*TILTED, np.random.default_rng(1)) >> 6, BOARD)
    assert view is not None
    assert error_px(view, TILTED) < 0.2


def test_blur_widens_edges(camera):
    widths = [
        find_board(camera.image(*STRAIGHT, np.random.default_rng(1), blur=blur), BOARD).edge_px
        for blur in (0.6, 1.2, 1.8)
    ]
    assert widths == sorted(widths)
    assert widths[-1] > 1.5 * widths[0]


def test_a_board_that_sticks_out_is_not_found(camera):
    pose = (np.zeros(3), np.array([-0.055, 0.0, 0.03]))
    assert find_board(camera.image(*pose, np.random.default_rng(1)), BOARD) is None


def test_another_board_is_not_found(camera):
    image = camera.image(*STRAIGHT, np.random.default_rng(1))
    assert find_board(image, Board(8, 7, SQUARE_M)) is None


@pytest.mark.parametrize(
    'image',
    [
        np.zeros((260, 346), np.uint16),
        np.full((260, 346), 65472, np.uint16),
        np.full((260, 346), 200, np.uint8),
        np.tile(np.arange(346, dtype=np.uint16) * 100, (260, 1)),
        np.random.default_rng(0).integers(0, 65536, (260, 346)).astype(np.uint16),
    ],
    ids=['black', 'white', 'grey', 'ramp', 'noise'],
)
def test_nothing_is_found_where_nothing_is(image):
    assert find_board(image, BOARD) is None


@pytest.mark.parametrize('text', ['9', '9x', 'x6', '9x-6', '2x6', '9.5x6', ''])
def test_boards_that_are_none_are_refused(text):
    with pytest.raises(CalibrationError):
        Board.parse(text, SQUARE_M)


@pytest.mark.parametrize('square', [0.0, -1.0, float('nan'), float('inf')])
def test_squares_have_a_size(square):
    with pytest.raises(CalibrationError):
        Board(9, 6, square)


def test_points_run_row_by_row():
    points = Board.parse('4X3', 0.5).points()
    assert points.shape == (12, 3)
    assert points[:5].tolist() == [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1.5, 0, 0], [0, 0.5, 0]]
