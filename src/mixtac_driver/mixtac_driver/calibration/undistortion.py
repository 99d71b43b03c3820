# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The calibration that a node serves: `camera_info`, undistorted frames and events, saving."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_driver.calibration.camera_info import read_camera_info, resolve, write_camera_info
from mixtac_driver.calibration.lens import CalibrationError, CameraCalibration
from mixtac_driver.parameters import DeviceParameters
from mixtac_driver.pixels import event_buffers, move_events
from mixtac_events.arrays import Events

Image = NDArray[np.uint8 | np.uint16]


_BAYER = 'bayer_'
_PATTERNS = ('RGGB', 'GRBG', 'GBRG', 'BGGR')
_NOWHERE = -1
_ROW = 65536
_OUTSIDE_PX = -1e6


class EventUndistortion:
    """Events at the nearest pixel of the rectified camera.

    Rectification spreads the middle of a wide-angle image and crops its rim: some rectified pixels
    never have an event, and raw pixels whose rectified place lies outside the image lose theirs.

    Args:
        calibration: The camera; its R and P define the rectified camera.

    Attributes:
        table: `int32` [height, width], rectified place of each raw pixel as row * 65536 + column,
            -1 where it is outside the image.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        width, height = self._size = calibration.size
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
        ideal = calibration.undistort(np.stack([columns.ravel(), rows.ravel()], axis=1))
        near = np.floor(np.nan_to_num(ideal, nan=_OUTSIDE_PX) + 0.5).clip(_OUTSIDE_PX, -_OUTSIDE_PX)
        inside = ((near >= 0.0) & (near < (width, height))).all(axis=1)
        places = (near[:, 1] * _ROW + near[:, 0]).astype(np.int64).astype(np.int32)
        self.table = np.where(inside, places, np.int32(_NOWHERE)).reshape(height, width)
        self.undistort(Events.empty())  # compile before the first events arrive

    def undistort(self, events: Events) -> Events:
        """Return the events that fall inside the rectified image, in the same order.

        Args:
            events: Raw events; the clock of their times does not matter.

        Returns:
            Events in new arrays; as many are missing as lie outside.
        """
        return move_events(events, self.table, event_buffers(len(events)))


class ImageUndistortion:
    """Frames as the rectified camera would see them (bilinear interpolation, black outside).

    Args:
        calibration: The camera; its R and P define the rectified camera.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        self._size = calibration.size
        width, height = self._size
        rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
        raw = calibration.distort(np.stack([columns.ravel(), rows.ravel()], axis=1))
        maps = np.nan_to_num(raw.T, nan=_OUTSIDE_PX).astype(np.float32).reshape(2, height, width)
        self._full = (maps[0], maps[1])
        self._offset, self._shifted = (0, 0), self._full

    def undistort(
        self, image: NDArray[np.uint8 | np.uint16], x: int = 0, y: int = 0
    ) -> NDArray[np.uint8 | np.uint16]:
        """Return the rectified image, always of the camera's full size.

        Args:
            image: `uint8` or `uint16` [height, width] or [height, width, channels]; no Bayer
                mosaic, whose pattern would be torn.
            x: Column of the image's first column in the full image, where only a region was read.
            y: Row of its first row.

        Raises:
            CalibrationError: The image does not fit into the calibrated size.
        """
        height, width = image.shape[:2]
        if min(x, y) < 0 or x + width > self._size[0] or y + height > self._size[1]:
            raise CalibrationError(
                f'image {width}x{height} at ({x}, {y}) is not inside the calibrated '
                f'{self._size[0]}x{self._size[1]}',
                remedy='calibrate this camera',
            )
        if (x, y) != self._offset:
            self._offset = (x, y)
            self._shifted = (self._full[0] - np.float32(x), self._full[1] - np.float32(y))
        import cv2

        return np.asarray(
            cv2.remap(
                image,
                *self._shifted,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=0,
            ),
            image.dtype,
        )


def without_mosaic(
    image: NDArray[np.uint8 | np.uint16], encoding: str
) -> tuple[NDArray[np.uint8 | np.uint16], str]:
    """Return a frame whose pixels may be moved, and its encoding.

    A Bayer mosaic is interpolated to `bgr8` or `bgr16`; everything else is returned as it is.

    Args:
        image: `uint8` or `uint16` [height, width].
        encoding: ROS encoding of the image.

    Raises:
        CalibrationError: A mosaic of an unknown pattern.
    """
    if not encoding.startswith(_BAYER):
        return image, encoding
    import cv2

    pattern, bits = encoding[len(_BAYER) :][:4].upper(), encoding[len(_BAYER) :][4:]
    if pattern not in _PATTERNS:
        raise CalibrationError(
            f'encoding {encoding!r} is not supported',
            remedy=f'use a mosaic of {", ".join(_PATTERNS)}',
        )
    colour = cv2.cvtColor(image, getattr(cv2, f'COLOR_Bayer{pattern}2BGR'))
    return np.asarray(colour, image.dtype), f'bgr{bits}'


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
        parameters: Location and use of the calibration.
        size: Columns and rows of the camera.

    Attributes:
        path: File of the calibration, whether or not it exists.

    Raises:
        CalibrationError: The file is damaged or of a camera of another size, or missing
            although undistortion is enabled.
    """

    def __init__(self, parameters: DeviceParameters, size: tuple[int, int]) -> None:
        self._parameters = parameters
        self._size = size
        self._tables: _Tables | None = None
        self.path: Path = resolve(parameters.camerainfo_url, parameters.camera_name)
        if self.path.exists():
            self._use(read_camera_info(self.path))
        elif parameters.undistort_frames or parameters.undistort_events:
            raise CalibrationError(
                f'undistortion needs a calibration, and {self.path} does not exist',
                remedy='write it with `mixtac calibrate`, or set camerainfo_url',
            )

    @property
    def calibration(self) -> CameraCalibration | None:
        """Return the calibration, or None."""
        tables = self._tables
        return tables.calibration if tables else None

    def describe(self) -> str:
        """Return one line for the log: the calibration in use, or that there is none."""
        calibration = self.calibration
        if calibration is None:
            return f'not calibrated: no {self.path}; write it with `mixtac calibrate`'
        name = calibration.name
        other = '' if name == self._parameters.camera_name else f', which names the camera {name!r}'
        return f'calibration {self.path}{other}'

    def camera_info_fields(self) -> dict[str, Any]:
        """Return the fields of `sensor_msgs/CameraInfo` by name; none without calibration."""
        calibration = self.calibration
        if calibration is None:
            return {}
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
            raise CalibrationError('events are not undistorted', remedy='set undistort_events')
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
            raise CalibrationError('frames are not undistorted', remedy='set undistort_frames')
        image, encoding = without_mosaic(image, encoding)
        return tables.frames.undistort(image, x, y), encoding

    def save(self, info: Any) -> Path:  # noqa: ANN401
        """Check a calibration, write it to its file and use it from now on.

        Args:
            info: A `sensor_msgs/CameraInfo`, or anything with these fields.

        Returns:
            The file.

        Raises:
            CalibrationError: It is implausible, of another camera, or cannot be written.
        """
        calibration = CameraCalibration(
            name=self._parameters.camera_name,
            width=info.width,
            height=info.height,
            model=info.distortion_model,
            distortion=np.array(info.d, np.float64),
            camera_matrix=np.array(info.k, np.float64).reshape(3, 3),
            rectification=np.array(info.r, np.float64).reshape(3, 3),
            projection=np.array(info.p, np.float64).reshape(3, 4),
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
            ImageUndistortion(calibration) if wanted.undistort_frames else None,
            EventUndistortion(calibration) if wanted.undistort_events else None,
        )

    def _check_size(self, calibration: CameraCalibration) -> None:
        if calibration.size != self._size:
            raise CalibrationError(
                f'calibration for {calibration.width}x{calibration.height} px, this camera has '
                f'{self._size[0]}x{self._size[1]}',
                remedy='calibrate this camera, or name its file in camerainfo_url',
            )
