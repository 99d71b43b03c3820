# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Event features against least squares by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_fger.config import FgerConfig
from mixtac_fger.features import FramePreparation, WindowFeatures, bin_cells


@pytest.fixture
def image() -> np.ndarray:
    y, x = np.mgrid[0:260, 0:346]
    return (300 + 100 * np.sin(0.5 * x + 0.1 * y) + 100 * np.cos(0.4 * y)).astype(np.uint16)


def features_of(events: Events, image: np.ndarray, **options: object) -> np.ndarray:
    config = FgerConfig(**options)
    preparation, window = FramePreparation(config), WindowFeatures(config)
    out = np.full(window.shape, np.nan, np.float32)
    window.compute(events, preparation.guide(preparation.contrast(image)), out)
    return out


def random_events(count: int) -> Events:
    random = np.random.default_rng(1)
    return Events(
        np.arange(count, dtype=np.int64),
        random.integers(0, 346, count).astype(np.uint16),
        random.integers(0, 260, count).astype(np.uint16),
        random.random(count) > 0.3,
    )


def test_flow_is_the_regularised_least_squares_solution(image):
    config, events = FgerConfig(), random_events(5000)
    preparation = FramePreparation(config)
    guide = preparation.guide(preparation.contrast(image))
    out = features_of(events, image)
    row_cell, column_cell = bin_cells(config.gradient_shape, config.grid_shape)
    x, y = events.x.astype(int) // 2, events.y.astype(int) // 2
    sign = np.where(events.polarity, 1.0, -1.0)
    for row, column in [(0, 0), (2, 5), (5, 7)]:
        gx = guide.along_x[row_cell == row][:, column_cell == column].astype(float).ravel()
        gy = guide.along_y[row_cell == row][:, column_cell == column].astype(float).ravel()
        tensor = 4 * np.array([[gx @ gx, gx @ gy], [gx @ gy, gy @ gy]])
        tensor += 4 * len(gx) * config.cell_regularisation * np.eye(2)
        here = (row_cell[y] == row) & (column_cell[x] == column)
        sums = [(sign * guide.along_x[y, x])[here].sum(), (sign * guide.along_y[y, x])[here].sum()]
        assert out[row, column, :2] == pytest.approx(-np.linalg.solve(tensor, sums), rel=1e-3)
        assert np.expm1(out[row, column, 2]) == pytest.approx((sign[here] > 0).sum(), rel=1e-5)
        assert np.expm1(out[row, column, 3]) == pytest.approx((sign[here] < 0).sum(), rel=1e-5)


def test_flow_points_where_the_texture_went(image):
    moved = np.log(np.roll(image, 1, axis=1).astype(float)) - np.log(image.astype(float))
    y, x = np.nonzero(np.abs(moved[:, 2:]) > 0.02)
    x = x + 2
    events = Events(np.arange(len(x)), x.astype(np.uint16), y.astype(np.uint16), moved[y, x] > 0)
    out = features_of(events, image)
    assert (out[..., 0] > 5 * np.abs(out[..., 1])).all()


def test_no_events_are_zero_whatever_the_image(image):
    assert not features_of(Events.empty(), image).any()
    assert not features_of(Events.empty(), np.zeros_like(image)).any()


def test_flow_is_limited(image):
    flat = np.full_like(image, 300)
    flat[:, ::8] += 40
    out = features_of(random_events(90_000), flat, flow_limit=0.5)
    assert np.abs(out[..., :2]).max() == 0.5


def test_counts_alone_leave_the_flow_out(image):
    events = random_events(5000)
    out = features_of(events, image, gradient_flow=False)
    assert not out[..., :2].any()
    assert np.array_equal(out[..., 2:], features_of(events, image)[..., 2:])
