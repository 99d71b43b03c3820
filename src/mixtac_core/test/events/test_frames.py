# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frame kernels against plain NumPy and against images that were moved on purpose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.frames import bin_mean, displacement, log_contrast


def waves(shift_x: float = 0.0, shift_y: float = 0.0) -> np.ndarray:
    rows, columns = 65, 86
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float64)
    x, y = x - shift_x, y - shift_y
    return (0.4 * np.sin(0.8 * x + 0.2 * y) + 0.4 * np.cos(0.7 * y - 0.1 * x)).astype(np.float32)


@pytest.mark.parametrize('kind', [np.uint8, np.uint16])
def test_bins_are_block_means(kind):
    image = np.random.default_rng(0).integers(0, 255, (260, 346)).astype(kind)
    out = np.empty((65, 86), np.float32)
    bin_mean(image, 4, out)
    expected = image[:, :344].reshape(65, 4, 86, 4).mean(axis=(1, 3))
    assert np.allclose(out, expected, rtol=1e-6)


@given(st.floats(0.01, 1000.0))
def test_log_contrast_does_not_depend_on_exposure(gain):
    image = np.exp(waves())
    one, other = np.empty_like(image), np.empty_like(image)
    log_contrast(image, 0.05, one)
    log_contrast((image * gain).astype(np.float32), 0.05, other)
    assert np.allclose(one, other, atol=1e-4)
    assert np.allclose(one, np.log(image / image.mean() + 0.05), atol=1e-5)


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 4), st.integers(0, 1000))
def test_displacement_is_that_of_the_definition(rows, columns, radius, seed):
    reference, image = np.random.default_rng(seed).random((2, rows, columns), np.float32)
    work, out = np.empty((9, rows, columns), np.float32), np.empty((2, rows, columns), np.float32)
    displacement(reference, image, radius, 0.5, work, out)
    size = 2 * radius + 1

    def box(field):
        view = np.lib.stride_tricks.sliding_window_view(np.pad(field, radius), (size, size))
        return view.sum(axis=(2, 3))

    padded = np.pad((reference + image) / 2, 1, mode='edge')
    gx = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2
    gy = (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
    ridge = 0.5 * size**2
    tensor = np.array([[box(gx * gx) + ridge, box(gx * gy)], [box(gx * gy), box(gy * gy) + ridge]])
    side = np.array([box(gx * (image - reference)), box(gy * (image - reference))])
    expected = -np.linalg.solve(tensor.transpose(2, 3, 0, 1), side.transpose(1, 2, 0)[..., None])
    np.testing.assert_allclose(out, expected[..., 0].transpose(2, 0, 1), atol=1e-4)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_displacement_finds_how_far_a_texture_moved(shift_x, shift_y):
    reference = waves()
    work = np.empty((9, *reference.shape), np.float32)
    out = np.empty((2, *reference.shape), np.float32)
    displacement(reference, waves(shift_x, shift_y), 3, 1e-3, work, out)
    inner = out[:, 5:-5, 5:-5].reshape(2, -1).mean(axis=1)
    # Central differences of these waves are 10 % too small, so the displacement is 10 % too large;
    # their curvature adds up to 0.012 px, most where the other direction moves by half a pixel.
    shift = np.array([shift_x, shift_y])
    assert np.all(np.abs(inner - shift) <= 0.1 * np.abs(shift) + 0.015)
