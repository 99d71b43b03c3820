# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration files of several programs, their URLs, and events at undistorted pixels."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from board_camera import HEIGHT, WIDE, WIDTH, camera_matrix
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_core.events.arrays import Events
from mixtac_driver.camera_info import (
    MODELS,
    CalibratedCamera,
    CalibrationError,
    CameraCalibration,
    parse_camera_info,
    read_camera_info,
    resolve,
    undistortion_table,
    write_camera_info,
)
from mixtac_driver.parameters import DriverParameters

# As camera_calibration_parsers writes it (the example of its documentation).
OTHERS = """image_width: 2448
image_height: 2050
camera_name: prosilica
camera_matrix:
  rows: 3
  cols: 3
  data: [4827.94, 0, 1223.5, 0, 4835.62, 1024.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.41527, 0.31874, -0.00197071, 7.13084e-05, 1e-05]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [4827.94, 0, 1223.5, 0, 0, 4835.62, 1024.5, 0, 0, 0, 1, 0]
"""
OPENCV = """%YAML:1.0
---
image_width: 346
image_height: 260
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 200., 0., 173., 0., 201., 130., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ -0.3, 0.1, 0., 0. ]
avg_reprojection_error: 0.2
"""
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.03, 0.01, -0.006, 0.001]
  distortion_model: MODEL
  intrinsics: [155.0, 155.6, 170.3, 133.1]
  resolution: [346, 260]
  rostopic: /davis/image_raw
"""


def calibration(model='equidistant', **other):
    *_, distortion = WIDE[model]
    fields = {
        'name': 'davis346',
        'width': WIDTH,
        'height': HEIGHT,
        'model': model,
        'distortion': np.array(distortion, float),
        'camera_matrix': camera_matrix(155.0, 155.6, 170.3, 133.1),
        'rectification': np.eye(3),
        'projection': np.hstack([camera_matrix(110.0, 112.0, 173.0, 129.0), np.zeros((3, 1))]),
    }
    return CameraCalibration(**{**fields, **other})


def test_a_file_of_camera_calibration_parsers_is_read():
    camera = parse_camera_info(OTHERS)
    assert (camera.width, camera.height, camera.name) == (2448, 2050, 'prosilica')
    assert camera.distortion.tolist() == [-0.41527, 0.31874, -0.00197071, 7.13084e-05, 1e-05]
    assert camera.projection[1].tolist() == [0, 4835.62, 1024.5, 0]


def test_a_file_of_opencv_is_read():
    camera = parse_camera_info(OPENCV, 'left')
    assert (camera.name, camera.size, camera.model) == ('left', (346, 260), 'plumb_bob')
    assert camera.distortion.tolist() == [-0.3, 0.1, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(camera.projection[:, :3], camera.camera_matrix)


@pytest.mark.parametrize(
    ('theirs', 'ours', 'count'), [('radtan', 'plumb_bob', 5), ('equidistant', 'equidistant', 4)]
)
def test_a_camchain_of_kalibr_is_read(theirs, ours, count):
    camera = parse_camera_info(KALIBR.replace('MODEL', theirs))
    assert (camera.model, camera.size, len(camera.distortion)) == (ours, (346, 260), count)
    assert camera.camera_matrix[0].tolist() == [155.0, 0.0, 170.3]


@pytest.mark.parametrize('model', MODELS)
@given(name=st.text(st.characters(codec='utf-8', exclude_categories=['Cs', 'Cc']), max_size=30))
@settings(max_examples=20)
def test_what_is_written_is_read_to_the_last_bit(model, name):
    camera = calibration(model, name=name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'x.yaml'
        write_camera_info(path, camera, 'two\nlines')
        read, text = read_camera_info(path), path.read_text()
    assert (read.size, read.model, read.name) == (camera.size, camera.model, name)
    for field in ('distortion', 'camera_matrix', 'rectification', 'projection'):
        np.testing.assert_array_equal(getattr(read, field), getattr(camera, field))
    for block in yaml.safe_load(text).values():
        if isinstance(block, dict):
            assert all(isinstance(each, float) for each in block['data'])


@pytest.mark.parametrize(
    ('old', 'new', 'named'),
    [
        ('image_width: 2448', 'image_width: wide', 'image_width'),
        ('image_width: 2448', 'image_width: 0', '0x2050'),
        ('image_height: 2050\n', '', 'image_height'),
        ('plumb_bob', 'ftheta', 'ftheta'),
        ('plumb_bob', 'equidistant', 'equidistant'),
        ('[4827.94, 0, 1223.5, 0, 4835', '[-4827.94, 0, 1223.5, 0, 4835', 'camera_matrix'),
        ('[4827.94, 0, 1223.5, 0, 0,', '[0, 0, 1223.5, 0, 0,', 'projection_matrix'),
        ('-0.41527', '.nan', 'distortion'),
        ('-0.41527', 'none', 'distortion_coefficients'),
        ('-0.41527, ', '', 'distortion_coefficients'),
    ],
)
def test_damage_is_named(tmp_path, old, new, named):
    assert old in OTHERS
    path = tmp_path / 'camera.yaml'
    path.write_text(OTHERS.replace(old, new, 1))
    with pytest.raises(CalibrationError) as caught:
        read_camera_info(path)
    assert named in str(caught.value)
    assert str(path) in str(caught.value)


@given(st.integers(0, len(OTHERS) - 1), st.binary(max_size=3))
@settings(max_examples=100)
def test_damage_anywhere_is_refused_or_harmless(place, junk):
    text = OTHERS[:place] + junk.decode('latin-1') + OTHERS[place + len(junk) + 1 :]
    try:
        camera = parse_camera_info(text)
    except CalibrationError:
        return
    assert np.isfinite(camera.camera_matrix).all()


def test_urls_name_files(monkeypatch, tmp_path):
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    assert resolve('', 'left') == tmp_path / 'camera_info' / 'left.yaml'
    assert resolve('file:///a/b%20c.yaml', 'left').name == 'b c.yaml'
    assert resolve('/a/${NAME}.yaml', 'left').name == 'left.yaml'
    for url, name in (('http://a/b', 'x'), ('file://a', 'x'), ('${HOME}/a', 'x'), ('', 'a/b')):
        with pytest.raises(CalibrationError):
            resolve(url, name)


@pytest.mark.parametrize('model', ['equidistant', 'plumb_bob'])
def test_events_land_where_the_undistorted_image_shows_them(model):
    camera = calibration(model)
    image, x, y = np.zeros((HEIGHT, WIDTH), np.uint16), 210, 90
    cv2.circle(image, (x, y), 4, 65535, -1)
    k, d, p = camera.camera_matrix, camera.distortion, camera.projection[:, :3]
    show = cv2.fisheye.undistortImage if model == 'equidistant' else cv2.undistort
    flat = show(image, k, d, None, p).astype(float)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    place = undistortion_table(camera)[y, x]
    assert (flat * columns).sum() / flat.sum() == pytest.approx(place & 0xFFFF, abs=1.0)
    assert (flat * rows).sum() / flat.sum() == pytest.approx(place >> 16, abs=1.0)


def test_events_keep_their_order_and_outside_ones_are_dropped(tmp_path):
    rng, n, path = np.random.default_rng(0), 20_000, tmp_path / 'camera.yaml'
    x, y = (rng.integers(0, size, n).astype(np.uint16) for size in (WIDTH, HEIGHT))
    events = Events(np.arange(n), x, y, rng.integers(0, 2, n).astype(bool))
    write_camera_info(path, calibration())
    p = DriverParameters(camerainfo_url=str(path), undistort_events=True)
    camera = CalibratedCamera(p)
    camera.use_size((WIDTH, HEIGHT))
    out = camera.undistort(events)
    places = undistortion_table(calibration())[y, x]
    assert 0 < len(out) < n
    np.testing.assert_array_equal(out.t, events.t[places >= 0])
    np.testing.assert_array_equal(out.polarity, events.polarity[places >= 0])
    np.testing.assert_array_equal(out.y.astype(int) << 16 | out.x, places[places >= 0])


def test_a_calibration_that_is_of_another_camera_or_missing_is_refused(tmp_path):
    path = tmp_path / 'camera.yaml'
    p = DriverParameters(camerainfo_url=str(path), undistort_events=True)
    with pytest.raises(CalibrationError):
        CalibratedCamera(p)
    write_camera_info(path, calibration(width=240, height=180))
    with pytest.raises(CalibrationError) as caught:
        CalibratedCamera(p).use_size((WIDTH, HEIGHT))
    assert '240x180' in str(caught.value)
