# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Undistorted frames and events, against OpenCV's functions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from board_camera import HEIGHT, WIDTH
from hypothesis import given, settings
from hypothesis import strategies as st
from lenses import calibration, calibrations, opencv_undistorted

from mixtac_driver.calibration.lens import MODELS, CalibrationError
from mixtac_driver.calibration.solve import rectified_camera
from mixtac_driver.calibration.undistortion import EventUndistortion, ImageUndistortion
from mixtac_events.arrays import Events

ALL = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).reshape(-1, 2)


def texture(seed=3, dtype=np.uint16):
    noise = np.random.default_rng(seed).uniform(0, np.iinfo(dtype).max, (HEIGHT, WIDTH))
    return cv2.GaussianBlur(noise, (0, 0), 2.0).astype(dtype)


def opencv_image(camera, image):
    k, d, p = camera.camera_matrix, camera.distortion, camera.projection[:, :3]
    if camera.model == 'equidistant':
        return cv2.fisheye.undistortImage(image, k, d, None, p)
    return cv2.undistort(image, k, d, None, p)


def random_events(n, seed=0):
    rng = np.random.default_rng(seed)
    return Events(
        np.sort(rng.integers(0, 10**6, n)),
        rng.integers(0, WIDTH, n).astype(np.uint16),
        rng.integers(0, HEIGHT, n).astype(np.uint16),
        rng.integers(0, 2, n).astype(bool),
    )


def locate(undistortion, x, y):
    """Return rectified columns, rows and validity of raw pixels; invalid ones are (0, 0)."""
    place = undistortion.table[y, x]
    valid = place >= 0
    return np.where(valid, place & 0xFFFF, 0), np.where(valid, place >> 16, 0), valid


@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize('dtype', [np.uint8, np.uint16])
def test_frames_are_opencvs(model, dtype):
    camera, image = calibration(model), texture(dtype=dtype)
    ours, theirs = ImageUndistortion(camera).undistort(image), opencv_image(camera, image)
    assert ours.dtype == dtype
    # OpenCV undistorts in strips, with maps of 1/32 px.
    difference = np.abs(ours.astype(float) - theirs.astype(float))[1:-1, 1:-1]
    assert np.quantile(difference, 0.99) < 0.004 * np.iinfo(dtype).max


@pytest.mark.parametrize('model', MODELS)
@given(data=st.data())
@settings(max_examples=8)
def test_events_go_where_opencv_says(model, data):
    camera = data.draw(calibrations(model))
    expected = opencv_undistorted(camera, ALL.astype(float))
    x, y, valid = locate(
        EventUndistortion(camera), ALL[:, 0].astype(np.uint16), ALL[:, 1].astype(np.uint16)
    )
    inside = ((expected > -0.5) & (expected < (WIDTH - 0.5, HEIGHT - 0.5))).all(axis=1)
    edge = (np.abs(expected % 1.0 - 0.5) < 1e-4).any(axis=1)  # either neighbour is nearest
    np.testing.assert_array_equal(valid[~edge], inside[~edge])
    sure = valid & ~edge
    np.testing.assert_array_equal(np.stack([x, y], 1)[sure], np.rint(expected[sure]))
    assert not x[~valid].any()
    assert not y[~valid].any()


def test_events_keep_order_time_and_polarity():
    camera = calibration()
    events, table = random_events(20_000), EventUndistortion(camera)
    out = table.undistort(events)
    x, y, valid = locate(table, events.x, events.y)
    assert 0 < len(out) < len(events)
    np.testing.assert_array_equal(out.t, events.t[valid])
    np.testing.assert_array_equal(out.polarity, events.polarity[valid])
    np.testing.assert_array_equal(out.x, x[valid])
    np.testing.assert_array_equal(out.y, y[valid])
    assert out.x.max() < WIDTH
    assert out.y.max() < HEIGHT
    assert len(out) / len(events) == pytest.approx((table.table >= 0).mean(), abs=0.02)


def test_no_events_and_events_outside_the_array():
    table = EventUndistortion(calibration())
    assert len(table.undistort(Events.empty())) == 0
    outside = Events(
        np.zeros(2, np.int64),
        np.array([WIDTH, 65535], np.uint16),
        np.array([0, 65535], np.uint16),
        np.zeros(2, bool),
    )
    assert len(table.undistort(outside)) == 0


def test_input_events_are_left_as_they_are():
    events = random_events(100)
    x = events.x.copy()
    EventUndistortion(calibration()).undistort(events)
    np.testing.assert_array_equal(events.x, x)


def test_frames_and_events_agree():
    """A bright dot of the frame and an event at its pixel land at the same place."""
    camera = calibration()
    image, x, y = np.zeros((HEIGHT, WIDTH), np.uint16), 210, 90
    cv2.circle(image, (x, y), 4, 65535, -1)
    flat = ImageUndistortion(camera).undistort(image).astype(float)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    new_x, new_y, _ = locate(
        EventUndistortion(camera), np.array([x], np.uint16), np.array([y], np.uint16)
    )
    assert (flat * columns).sum() / flat.sum() == pytest.approx(new_x[0], abs=1.0)
    assert (flat * rows).sum() / flat.sum() == pytest.approx(new_y[0], abs=1.0)


def test_a_region_is_shown_at_its_place():
    undistortion, image = ImageUndistortion(calibration()), texture()
    whole = undistortion.undistort(image)
    part = undistortion.undistort(image[60:200, 100:250], x=100, y=60)
    assert part.shape == whole.shape
    same = part == whole
    assert same[100:160, 150:200].all()
    assert (part[~same] < whole[~same]).mean() > 0.9  # the rest is black
    np.testing.assert_array_equal(undistortion.undistort(image), whole)


@pytest.mark.parametrize(('x', 'y'), [(1, 0), (0, 1), (-1, 0)])
def test_an_image_that_does_not_fit_is_refused(x, y):
    with pytest.raises(CalibrationError):
        ImageUndistortion(calibration()).undistort(texture(), x, y)


def test_colour_frames_keep_their_channels():
    colour = np.stack([texture(seed) for seed in (1, 2, 3)], axis=-1)
    undistortion = ImageUndistortion(calibration())
    out = undistortion.undistort(colour)
    np.testing.assert_array_equal(out[..., 1], undistortion.undistort(colour[..., 1].copy()))


@pytest.mark.parametrize('model', MODELS)
def test_alpha_zero_fills_the_image_and_one_shows_all_of_it(model):
    raw = calibration(model)
    white = np.full((HEIGHT, WIDTH), 255, np.uint8)
    arguments = (model, raw.distortion, raw.camera_matrix, raw.size)
    filled = calibration(model, projection=rectified_camera(*arguments, alpha=0.0))
    assert ImageUndistortion(filled).undistort(white).min() > 250
    assert (EventUndistortion(filled).table < 0).any()
    whole = calibration(model, projection=rectified_camera(*arguments, alpha=1.0))
    assert (
        EventUndistortion(whole).table >= 0
    ).mean() > 0.999  # one corner of the widest is beyond 85 degrees
    focal = [rectified_camera(*arguments, alpha=a)[0, 0] for a in (0.0, 0.3, 0.7, 1.0)]
    assert focal == sorted(focal, reverse=True)
