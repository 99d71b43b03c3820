# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Distortion both ways, against OpenCV."""

from __future__ import annotations

import numpy as np
import pytest
from board_camera import HEIGHT, WIDE, WIDTH, rays
from hypothesis import given, settings
from hypothesis import strategies as st
from lenses import calibration, calibrations, opencv_undistorted

from mixtac_driver.calibration.lens import MAX_ANGLE_RAD, MODELS, distort, fold_radius, undistort

PIXELS = np.stack(np.meshgrid(np.linspace(0, 345, 24), np.linspace(0, 259, 18)), -1).reshape(-1, 2)


@pytest.mark.parametrize('model', MODELS)
@given(data=st.data())
@settings(max_examples=40)
def test_undistorted_pixels_are_opencvs(model, data):
    camera = data.draw(calibrations(model))
    ours, theirs = camera.undistort(PIXELS), opencv_undistorted(camera, PIXELS)
    assert np.isfinite(ours).all()
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.parametrize('model', MODELS)
@given(data=st.data())
@settings(max_examples=40)
def test_distorting_undoes_it(model, data):
    camera = data.draw(calibrations(model))
    np.testing.assert_allclose(camera.distort(camera.undistort(PIXELS)), PIXELS, atol=1e-6)


@pytest.mark.parametrize('model', MODELS)
def test_directions_of_a_wide_lens_are_those_found_by_bisection(model):
    fx, fy, cx, cy, coefficients = WIDE[model]
    points = (PIXELS - (cx, cy)) / (fx, fy)
    ideal = undistort(model, np.array(coefficients), points)
    found = rays(model, PIXELS[:, 0], PIXELS[:, 1])
    seen = found[:, 2] > np.cos(MAX_ANGLE_RAD) * np.linalg.norm(found, axis=1)
    assert seen.mean() > 0.99
    np.testing.assert_allclose(
        ideal[seen], (found[:, :2] / found[:, 2:])[seen], rtol=1e-5, atol=1e-6
    )
    assert np.isnan(ideal[~seen]).all()


def test_a_lens_without_distortion_changes_nothing():
    points = np.random.default_rng(0).normal(0, 1, (100, 2))
    np.testing.assert_allclose(distort('plumb_bob', np.zeros(5), points), points)
    np.testing.assert_allclose(undistort('plumb_bob', np.zeros(5), points), points)


def test_points_beyond_the_fold_are_marked():
    # r (1 - 0.3 r^2) rises up to r = 1.054 and reaches 0.703 there.
    coefficients = np.array([-0.3, 0, 0, 0, 0])
    assert fold_radius('plumb_bob', coefficients) == pytest.approx(np.sqrt(1 / 0.9), rel=1e-2)
    seen = undistort('plumb_bob', coefficients, np.array([[0.69, 0.0], [0.71, 0.0], [2.0, 1.0]]))
    assert np.isfinite(seen[0]).all()
    assert np.isnan(seen[1:]).all()
    assert np.isnan(distort('plumb_bob', coefficients, np.array([[1.2, 0.0]]))).all()


@pytest.mark.parametrize('model', MODELS)
@given(
    coefficients=st.lists(st.floats(-3, 3), min_size=8, max_size=8),
    points=st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=1, max_size=20),
)
@settings(max_examples=60)
def test_whatever_is_called_undistorted_distorts_back(model, coefficients, points):
    lens, shown = np.array(coefficients[: len(MODELS[model])]), np.array(points)
    with np.errstate(all='ignore'):
        ideal = undistort(model, lens, shown)
        back = distort(model, lens, ideal * (1 - 1e-9))
    good = np.isfinite(ideal).all(axis=1) & np.isfinite(back).all(axis=1)
    np.testing.assert_allclose(back[good], shown[good], atol=1e-4)


def test_directions_near_a_right_angle_are_marked_not_guessed():
    camera = calibration('equidistant', (0, 0, 0, 0), focal=(100.0, 100.0))
    far = camera.undistort(np.array([[WIDTH - 1.0, HEIGHT - 1.0]]))  # 123 degrees off the axis
    assert np.isnan(far).all()
