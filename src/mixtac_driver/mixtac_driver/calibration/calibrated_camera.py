# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a driver node needs of a calibration: camera_info, undistorted frames and events, saving."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_driver.calibration.camera_calibration import CameraCalibration
from mixtac_driver.calibration.camera_info_file import read_camera_info, write_camera_info
from mixtac_driver.calibration.camera_info_url import resolve
from mixtac_driver.calibration.errors import CalibrationError
from mixtac_driver.calibration.event_undistortion import EventUndistortion

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_driver.calibration.calibration_parameters import CalibrationParameters
    from mixtac_driver.calibration.image_undistortion import ImageUndistortion
    from mixtac_events.arrays import Events

    Image = NDArray[np.uint8 | np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class _Tables:
    """One calibration with the tables made from it; replaced as a whole, also between threads."""

    calibration: CameraCalibration
    frames: ImageUndistortion | None
    events: EventUndistortion | None


class CalibratedCamera:
    """The calibration that a node serves; there may be none yet.

    Frames and events may be undistorted in one thread while another saves a new calibration.

    Args:
        parameters: Where the calibration is, and what it is used for.
        size: Columns and rows of the camera.

    Attributes:
        path: File of the calibration, whether or not it exists.

    Raises:
        CalibrationError: The file is damaged or of a camera of another size, or there is none and
            undistortion is asked for.
    """

    def __init__(self, parameters: CalibrationParameters, size: tuple[int, int]) -> None:
        self._parameters = parameters
        self._size = size
        self._tables: _Tables | None = None
        self.path: Path = resolve(parameters.camerainfo_url, parameters.camera_name)
        if self.path.exists():
            self._use(read_camera_info(self.path))
        elif parameters.undistort_frames or parameters.undistort_events:
            raise CalibrationError(
                f'undistortion needs a calibration and {self.path} does not exist: write it with '
                '`mixtac calibrate`, or set camerainfo_url'
            )

    @property
    def calibration(self) -> CameraCalibration | None:
        """Return the calibration, or None."""
        tables = self._tables
        return tables.calibration if tables else None

    def describe(self) -> str:
        """Return one line for the log: which calibration is used, or that there is none."""
        calibration = self.calibration
        if calibration is None:
            return f'not calibrated: no {self.path}; write it with `mixtac calibrate`'
        name = calibration.name
        other = '' if name == self._parameters.camera_name else f', which names the camera {name!r}'
        return f'calibration {self.path}{other}'

    def camera_info_fields(self, *, rectified: bool = False) -> dict[str, Any]:
        """Return the fields of `sensor_msgs/CameraInfo` by name; without calibration none.

        Args:
            rectified: For undistorted topics: no distortion, K from P.
        """
        calibration = self.calibration
        if calibration is None:
            return {}
        if rectified:
            calibration = calibration.rectified()
        return {
            'width': calibration.width,
            'height': calibration.height,
            'distortion_model': calibration.model,
            'd': calibration.distortion.tolist(),
            'k': calibration.camera_matrix.ravel().tolist(),
            'r': calibration.rectification.ravel().tolist(),
            'p': calibration.projection.ravel().tolist(),
        }

    def events(self, events: Events) -> Events:
        """Return the events at undistorted pixels; those outside the rectified image are left out.

        Args:
            events: Raw events on any clock.

        Raises:
            CalibrationError: The parameter `undistort_events` is off.
        """
        tables = self._tables
        if tables is None or tables.events is None:
            raise CalibrationError('events are not undistorted: set undistort_events')
        return tables.events.undistort(events)

    def image(
        self, image: Image, encoding: str = 'mono16', x: int = 0, y: int = 0
    ) -> tuple[Image, str]:
        """Return the undistorted frame of the camera's full size, and its encoding.

        A Bayer mosaic is interpolated to `bgr8` or `bgr16` first.

        Args:
            image: `uint8` or `uint16` [height, width].
            encoding: ROS encoding of the image.
            x: Column of the image's first column in the full image.
            y: Row of its first row.

        Raises:
            CalibrationError: The parameter `undistort_frames` is off, or the image does not fit
                or is an unknown mosaic.
        """
        tables = self._tables
        if tables is None or tables.frames is None:
            raise CalibrationError('frames are not undistorted: set undistort_frames')
        from mixtac_driver.calibration.image_undistortion import without_mosaic

        image, encoding = without_mosaic(image, encoding)
        return tables.frames.undistort(image, x, y), encoding

    def save(
        self,
        *,
        width: int,
        height: int,
        distortion_model: str,
        d: Sequence[float],
        k: Sequence[float],
        r: Sequence[float],
        p: Sequence[float],
    ) -> Path:
        """Check a calibration, write it to its file and use it from now on.

        Args:
            width: Columns of the full image.
            height: Rows of the full image.
            distortion_model: One of `distortion.MODELS`.
            d: Coefficients.
            k: K, 9 numbers row by row.
            r: R, 9 numbers.
            p: P, 12 numbers.

        Returns:
            The file.

        Raises:
            CalibrationError: It describes no camera, or another one, or cannot be written.
        """
        calibration = CameraCalibration(
            name=self._parameters.camera_name,
            width=width,
            height=height,
            model=distortion_model,
            distortion=np.array(d, np.float64),
            camera_matrix=np.array(k, np.float64).reshape(3, 3),
            rectification=np.array(r, np.float64).reshape(3, 3),
            projection=np.array(p, np.float64).reshape(3, 4),
        )
        self._check_size(calibration)
        write_camera_info(self.path, calibration)
        self._use(calibration)
        return self.path

    def _use(self, calibration: CameraCalibration) -> None:
        self._check_size(calibration)
        wanted = self._parameters
        self._tables = _Tables(
            calibration,
            _image_undistortion(calibration) if wanted.undistort_frames else None,
            EventUndistortion(calibration) if wanted.undistort_events else None,
        )

    def _check_size(self, calibration: CameraCalibration) -> None:
        if calibration.size != self._size:
            raise CalibrationError(
                f'calibration for {calibration.width}x{calibration.height} px, this camera has '
                f'{self._size[0]}x{self._size[1]}: calibrate this one, or name its file in '
                'camerainfo_url'
            )


def _image_undistortion(calibration: CameraCalibration) -> ImageUndistortion:
    # OpenCV takes 0.1 s to load; a driver that only serves camera_info starts without it.
    from mixtac_driver.calibration.image_undistortion import ImageUndistortion

    return ImageUndistortion(calibration)
