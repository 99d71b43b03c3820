# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A checkerboard before a wide-angle camera, ray-cast."""

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


def rays(x, y):
    """Directions [n, 3] of pixels of the equidistant lens, by bisection on the angle."""
    fx, fy, cx, cy, d = WIDE['equidistant']
    u, v = (x - cx) / fx, (y - cy) / fy
    bent = np.hypot(u, v)
    # Bisection at a few radii, straight lines between them.
    radii = np.linspace(0, bent.max(), 20_000)
    low, high = np.zeros_like(radii), np.full_like(radii, 1.55)
    for _ in range(50):
        middle = (low + high) / 2
        shown = sum(k * middle ** (2 * i + 3) for i, k in enumerate(d)) + middle
        low, high = np.where(shown < radii, middle, low), np.where(shown < radii, high, middle)
    angle = np.interp(bent, radii, low)
    scale = np.sin(angle) / np.maximum(bent, 1e-12)
    return np.stack([u * scale, v * scale, np.cos(angle)], axis=-1)


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
        grid_x, grid_y = np.meshgrid(x, y)
        self._rays = rays(grid_x.ravel(), grid_y.ravel())

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
    fx, fy, cx, cy, d = WIDE[model]
    column, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    board = np.stack([column - (COLUMNS - 1) / 2, row - (ROWS - 1) / 2, 0.0 * row], axis=-1)
    x, y, z = (board.reshape(-1, 3) * SQUARE_M @ rotation(turn).T + centre).T
    if model == 'equidistant':
        angle = np.arctan2(np.hypot(x, y), z)
        shown = angle + sum(k * angle ** (2 * i + 3) for i, k in enumerate(d))
        scale = shown / np.hypot(x, y)
        return np.stack([cx + fx * x * scale, cy + fy * y * scale], axis=1)
    k = np.zeros(8)
    k[: len(d)] = d
    a, b = x / z, y / z
    s = a * a + b * b
    gain = (1 + k[0] * s + k[1] * s**2 + k[4] * s**3) / (1 + k[5] * s + k[6] * s**2 + k[7] * s**3)
    u = a * gain + 2 * k[2] * a * b + k[3] * (s + 2 * a * a)
    v = b * gain + k[2] * (s + 2 * b * b) + 2 * k[3] * a * b
    return np.stack([cx + fx * u, cy + fy * v], axis=1)


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
