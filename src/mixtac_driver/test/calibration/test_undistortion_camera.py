# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a node gets from a calibration file."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from board_camera import HEIGHT, WIDTH
from lenses import calibration

from mixtac_driver.calibration.camera_info import read_camera_info, write_camera_info
from mixtac_driver.calibration.lens import CalibrationError
from mixtac_driver.calibration.undistortion import CalibratedCamera
from mixtac_driver.parameters import DriverParameters
from mixtac_events.arrays import Events

SIZE = (WIDTH, HEIGHT)
FIELDS = ('width', 'height', 'distortion_model', 'd', 'k', 'r', 'p')


@pytest.fixture
def url(tmp_path):
    path = tmp_path / 'davis346.yaml'
    write_camera_info(path, calibration())
    return f'file://{path}'


def one_event(x=100, y=80):
    return Events(
        np.array([5], np.int64),
        np.array([x], np.uint16),
        np.array([y], np.uint16),
        np.ones(1, bool),
    )


def test_fields_are_those_of_the_file(url):
    camera = CalibratedCamera(DriverParameters(camerainfo_url=url), SIZE)
    fields = camera.camera_info_fields()
    expected = calibration()
    assert tuple(fields) == FIELDS
    assert (fields['width'], fields['height'], fields['distortion_model']) == (*SIZE, 'equidistant')
    assert fields['d'] == expected.distortion.tolist()
    assert fields['k'] == expected.camera_matrix.ravel().tolist()
    assert fields['p'][3] == 0.0
    assert 'davis346.yaml' in camera.describe()


def test_without_a_file_there_are_no_fields_and_the_log_says_so(tmp_path):
    camera = CalibratedCamera(DriverParameters(camerainfo_url=str(tmp_path / 'none.yaml')), SIZE)
    assert camera.camera_info_fields() == {}
    assert camera.calibration is None
    assert 'mixtac calibrate' in camera.describe()


@pytest.mark.parametrize('wanted', ['undistort_frames', 'undistort_events'])
def test_undistortion_without_a_file_is_refused(tmp_path, wanted):
    parameters = DriverParameters(camerainfo_url=str(tmp_path / 'none.yaml'), **{wanted: True})
    with pytest.raises(CalibrationError):
        CalibratedCamera(parameters, SIZE)


def test_a_calibration_of_another_size_is_refused(url):
    with pytest.raises(CalibrationError):
        CalibratedCamera(DriverParameters(camerainfo_url=url), (640, 480))


def test_a_damaged_file_is_refused(tmp_path):
    (tmp_path / 'c.yaml').write_text('image_width: 346')
    with pytest.raises(CalibrationError):
        CalibratedCamera(DriverParameters(camerainfo_url=str(tmp_path / 'c.yaml')), SIZE)


def test_a_file_of_another_name_is_said(url):
    camera = CalibratedCamera(DriverParameters(camerainfo_url=url, camera_name='left'), SIZE)
    assert "names the camera 'davis346'" in camera.describe()


def test_frames_and_events_are_undistorted_only_where_asked(url):
    camera = CalibratedCamera(DriverParameters(camerainfo_url=url), SIZE)
    with pytest.raises(CalibrationError):
        camera.events(one_event())
    with pytest.raises(CalibrationError):
        camera.image(np.zeros((HEIGHT, WIDTH), np.uint16))


def test_an_event_moves_to_its_rectified_pixel(url):
    parameters = DriverParameters(camerainfo_url=url, undistort_events=True)
    out = CalibratedCamera(parameters, SIZE).events(one_event())
    expected = np.rint(calibration().undistort(np.array([[100.0, 80.0]])))[0]
    assert (out.x[0], out.y[0], out.t[0], out.polarity[0]) == (*expected, 5, True)


@pytest.mark.parametrize('bits', [8, 16])
def test_a_mosaic_becomes_colour_first(url, bits):
    parameters = DriverParameters(camerainfo_url=url, undistort_frames=True)
    camera = CalibratedCamera(parameters, SIZE)
    dtype, full = (np.uint8, 200) if bits == 8 else (np.uint16, 50_000)
    mosaic = np.zeros((HEIGHT, WIDTH), dtype)
    mosaic[::2, ::2] = full  # red pixels of RGGB
    image, encoding = camera.image(mosaic, f'bayer_rggb{bits}')
    assert encoding == f'bgr{bits}'
    assert image.dtype == dtype
    assert image[100:150, 150:200, 2].mean() == pytest.approx(full, rel=0.01)
    assert image[100:150, 150:200, :2].max() == 0


def test_an_unknown_mosaic_is_refused(url):
    parameters = DriverParameters(camerainfo_url=url, undistort_frames=True)
    with pytest.raises(CalibrationError):
        CalibratedCamera(parameters, SIZE).image(np.zeros((20, 30), np.uint8), 'bayer_rgbw8')


def test_grey_frames_stay_grey(url):
    parameters = DriverParameters(camerainfo_url=url, undistort_frames=True)
    image, encoding = CalibratedCamera(parameters, SIZE).image(
        np.full((20, 30), 9, np.uint16), x=50
    )
    assert (image.shape, encoding) == ((HEIGHT, WIDTH), 'mono16')


def test_a_saved_calibration_is_used_at_once_and_read_next_time(tmp_path, url):
    source = CalibratedCamera(DriverParameters(camerainfo_url=url), SIZE)
    target = f'file://{tmp_path}/new/${{NAME}}.yaml'
    parameters = DriverParameters(camerainfo_url=target, camera_name='fingertip')
    camera = CalibratedCamera(parameters, SIZE)
    path = camera.save(SimpleNamespace(**source.camera_info_fields()))
    assert path == tmp_path / 'new' / 'fingertip.yaml'
    assert camera.camera_info_fields() == source.camera_info_fields()
    assert read_camera_info(path).name == 'fingertip'
    assert CalibratedCamera(parameters, SIZE).camera_info_fields() == source.camera_info_fields()


@pytest.mark.parametrize(
    'change',
    [
        {'width': 640},
        {'distortion_model': 'fisheye'},
        {'d': [0.1]},
        {'k': [0.0] * 9},
        {'d': [float('nan')] * 4},
    ],
)
def test_what_is_no_calibration_is_neither_saved_nor_used(url, change):
    camera = CalibratedCamera(DriverParameters(camerainfo_url=url), SIZE)
    before, text = camera.camera_info_fields(), camera.path.read_text()
    with pytest.raises(CalibrationError):
        camera.save(SimpleNamespace(**{**before, **change}))
    assert camera.camera_info_fields() == before
    assert camera.path.read_text() == text
