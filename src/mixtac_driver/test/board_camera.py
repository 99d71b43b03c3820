# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A checkerboard before a wide-angle camera; OpenCV has the lens, which is not tested here."""

from __future__ import annotations

import cv2
import numpy as np

from mixtac_driver.calibration import Board, View

WIDTH, HEIGHT = 346, 260
SQUARE_M = 0.004
COLUMNS, ROWS = 9, 6
WIDE = {
    'equidistant': (155.0, 155.6, 170.3, 133.1, (-0.031, 0.012, -0.006, 0.0011)),
    'plumb_bob': (201.0, 200.2, 176.4, 127.8, (-0.235, 0.062, 6e-4, -4e-4, -0.0058)),
    # Gain (1 + a r^2) / (1 + b r^2): a wide lens that no short polynomial describes.
    'rational_polynomial': (
        205.0,
        205.9,
        171.2,
        131.5,
        (0.30, 0.02, 5e-4, 3e-4, 0.001, 0.50, 0.07, 0.002),
    ),
}
"""fx, fy, cx, cy, coefficients of a wide-angle lens in each model."""


def camera_matrix(fx, fy, cx, cy):
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def lens(model):
    """Camera matrix and coefficients."""
    *matrix, coefficients = WIDE[model]
    return camera_matrix(*matrix), np.array(coefficients)


def rotation(vector):
    return cv2.Rodrigues(np.asarray(vector, float))[0]


class BoardCamera:
    """Renders a board of COLUMNS x ROWS inner corners through the equidistant lens.

    Args:
        oversampling: Rays per pixel and axis.
    """

    def __init__(self, oversampling=2):
        self._n = oversampling
        steps = (np.arange(oversampling) + 0.5) / oversampling - 0.5
        x = (np.arange(WIDTH)[:, None] + steps).ravel()
        y = (np.arange(HEIGHT)[:, None] + steps).ravel()
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
        ideal = cv2.fisheye.undistortPoints(pixels, *lens('equidistant'))[:, 0]
        self._rays = np.hstack([ideal, np.ones((len(ideal), 1))])

    def image(self, turn, centre, rng, *, blur=0.8, noise=4.0, contrast=0.55, light=420.0):
        """A 10-bit image, left-aligned in 16.

        Args:
            turn: Rotation vector of the board.
            centre: Position of the board's centre before the camera [m].
            rng: Source of the noise.
            blur: Standard deviation [px].
            noise: Standard deviation [steps of 10 bit].
            contrast: Dark over bright is 1 - contrast.
            light: Brightness of white in the middle [steps of 10 bit].
        """
        matrix = rotation(turn)
        normal = matrix[:, 2]
        along = (normal @ centre) / (self._rays @ normal)
        hit = self._rays * along[:, None] - centre
        column = hit @ matrix[:, 0] / SQUARE_M + (COLUMNS + 1) / 2
        row = hit @ matrix[:, 1] / SQUARE_M + (ROWS + 1) / 2
        ahead = along > 0
        inside = ahead & (column > 0) & (column < COLUMNS + 1) & (row > 0) & (row < ROWS + 1)
        paper = ahead & (column > -1) & (column < COLUMNS + 2) & (row > -1) & (row < ROWS + 2)
        black = inside & ((np.floor(column) + np.floor(row)) % 2 == 0)
        value = np.where(paper, np.where(black, 1 - contrast, 1.0), 0.75)
        shape = (HEIGHT, self._n, WIDTH, self._n)
        pixels = value.reshape(shape).mean(axis=(1, 3))
        pixels = cv2.GaussianBlur(pixels, (0, 0), blur) if blur else pixels
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
        shade = 1 - 0.35 * (((x - 180) / 200) ** 2 + ((y - 120) / 200) ** 2)
        pixels = pixels * shade * light + rng.normal(0, noise, pixels.shape) + 60
        return (np.clip(np.rint(pixels), 0, 1023).astype(np.uint16)) << 6


def corners(model, turn, centre):
    """True pixels of the inner corners [54, 2], row by row."""
    column, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    board = np.stack([column - (COLUMNS - 1) / 2, row - (ROWS - 1) / 2, 0.0 * row], axis=-1)
    points = board.reshape(1, -1, 3) * SQUARE_M
    project = cv2.fisheye.projectPoints if model == 'equidistant' else cv2.projectPoints
    return project(points, np.asarray(turn, float), np.asarray(centre), *lens(model))[0].reshape(
        -1, 2
    )


def visible(model, turn, centre, margin=4):
    """Whether all corners and their squares are before the lens and inside the image."""
    found = corners(model, turn, centre)
    return (found > margin).all() and (found < (WIDTH - margin, HEIGHT - margin)).all()


def good_poses(model, count, seed, margin=4):
    """Poses with the whole board in view; a third of them reach for the corners of the image."""
    found = [each for each in poses(10 * count, seed) if visible(model, *each, margin)]
    middle = np.array([WIDTH, HEIGHT]) / 2
    reach = [np.linalg.norm(corners(model, *each) - middle, axis=1).max() for each in found]
    order = np.argsort(reach)[::-1]
    third = count // 3
    return [found[i] for i in (*order[:third], *sorted(order[third:])[: count - third])]


def perfect_views(model, count, seed, noise=0.05, held=None):
    """Views with true corners and Gaussian noise [px]."""
    rng = np.random.default_rng(seed + 1)
    board = Board(COLUMNS, ROWS, SQUARE_M)
    chosen = held or good_poses(model, count, seed)
    return [
        View(board, corners(model, *each) + rng.normal(0, noise, (54, 2)), WIDTH, HEIGHT, str(i))
        for i, each in enumerate(chosen)
    ]


def poses(count, seed):
    """Rotation vectors and centres of a board held all over the image of a wide-angle lens."""
    rng = np.random.default_rng(seed)
    found = []
    for index in range(count):
        distance = rng.uniform(0.022, 0.05)
        angle = np.deg2rad(rng.uniform(0, 46))
        around = 2 * np.pi * (index * 0.618034 % 1.0)
        direction = np.array(
            [np.sin(angle) * np.cos(around) * 1.2, np.sin(angle) * np.sin(around) * 0.8, 1.0]
        )
        turn = rng.uniform(-0.55, 0.55, 3) * np.array([1, 1, 0.6])
        found.append((turn, direction * distance))
    return found
