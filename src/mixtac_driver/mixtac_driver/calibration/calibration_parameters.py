# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node that serves a calibration and undistorts with it."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class CalibrationParameters:
    """Where the calibration is, and what it is used for."""

    camera_name: str = parameter(
        'davis346',
        'Name of the camera in its calibration: letters, digits and _',
        read_only=True,
    )
    camerainfo_url: str = parameter(
        '',
        'Calibration written by `mixtac calibrate`: file:///path, package://name/path or a path, '
        'where ${NAME} is camera_name and ${ROS_HOME} is ~/.ros unless set; empty is '
        'file://${ROS_HOME}/camera_info/${NAME}.yaml',
        read_only=True,
    )
    undistort_frames: bool = parameter(
        False,
        'Publish frames without the distortion of the lens as well; needs a calibration',
        read_only=True,
    )
    undistort_events: bool = parameter(
        False,
        'Publish events at undistorted pixels as well; needs a calibration',
        read_only=True,
    )
