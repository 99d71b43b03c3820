# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrations for tests, and the lenses that hypothesis draws."""

from __future__ import annotations

import cv2
import numpy as np
from board_camera import HEIGHT, WIDE, WIDTH, camera_matrix
from hypothesis import strategies as st

from mixtac_driver.calibration.lens import CameraCalibration


def calibration(
    model='equidistant', distortion=None, focal=(155.0, 155.6), centre=(170.3, 133.1), **other
):
    if distortion is None:
        *_, distortion = WIDE[model]
    projection = np.zeros((3, 4))
    projection[:3, :3] = camera_matrix(110.0, 112.0, 173.0, 129.0)
    fields = {
        'name': 'davis346',
        'width': WIDTH,
        'height': HEIGHT,
        'model': model,
        'distortion': np.array(distortion, float),
        'camera_matrix': camera_matrix(*focal, *centre),
        'rectification': np.eye(3),
        'projection': projection,
    }
    return CameraCalibration(**{**fields, **other})


def _between(low, high):
    return st.floats(low, high, allow_nan=False)


DISTORTIONS = {
    'plumb_bob': st.tuples(
        _between(-0.055, 0.15),
        _between(0.0, 0.02),
        _between(-2e-3, 2e-3),
        _between(-2e-3, 2e-3),
        _between(0.0, 0.004),
    ),
    'rational_polynomial': st.tuples(
        _between(0.1, 0.3),
        _between(0.005, 0.03),
        _between(-1e-3, 1e-3),
        _between(-1e-3, 1e-3),
        _between(0.0, 0.002),
        _between(0.1, 0.25),
        _between(0.0, 0.01),
        _between(0.0, 0.0005),
    ),
    'equidistant': st.tuples(
        _between(-0.05, 0.1), _between(0.0, 0.02), _between(0.0, 0.004), _between(0.0, 0.001)
    ),
}
"""Lenses that do not fold back inside the image."""


@st.composite
def calibrations(draw, model):
    turn = draw(_between(-0.1, 0.1))
    rectification = np.array(
        [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    )
    return calibration(
        model,
        draw(DISTORTIONS[model]),
        (draw(_between(190, 300)), draw(_between(190, 300))),
        (draw(_between(160, 185)), draw(_between(120, 140))),
        rectification=rectification,
    )


def opencv_undistorted(camera, points):
    """Rectified pixels of raw ones [n, 2], by OpenCV."""
    k, d, r, p = camera.camera_matrix, camera.distortion, camera.rectification, camera.projection
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 500, 1e-12)
    if camera.model == 'equidistant':
        return cv2.fisheye.undistortPoints(points[:, None], k, d, R=r, P=p)[:, 0]
    if hasattr(cv2, 'undistortPointsIter'):  # OpenCV 4
        return cv2.undistortPointsIter(points[:, None], k, d, r, p, stop)[:, 0]
    return cv2.undistortPoints(points[:, None], k, d, R=r, P=p, criteria=stop)[:, 0]
