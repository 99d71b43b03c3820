# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The calibration of a camera as in `sensor_msgs/CameraInfo`, its files, and undistorted events.

Files are YAML as camera_info_manager and `camera_calibration` write them. Calibrations of OpenCV
(`%YAML:1.0`) and camchains of Kalibr are read as well. OpenCV evaluates the lens models.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import yaml
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events, Floats
from mixtac_core.node.files import ShareError, share, write_text
from mixtac_driver.errors import DriverError
from mixtac_driver.parameters import DeviceParameters
from mixtac_driver.pixels import move_events

EQUIDISTANT = 'equidistant'
PLUMB_BOB = 'plumb_bob'
RATIONAL = 'rational_polynomial'
MODELS = {
    PLUMB_BOB: ('k1', 'k2', 'p1', 'p2', 'k3'),
    RATIONAL: ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6'),
    EQUIDISTANT: ('k1', 'k2', 'k3', 'k4'),
}
"""Names of the coefficients by distortion model."""
KALIBR_MODELS = {'radtan': PLUMB_BOB, 'equidistant': EQUIDISTANT}
"""Distortion model by its name in a camchain of Kalibr."""


class CalibrationError(DriverError):
    """A calibration that is missing, damaged, or of another camera."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """The lens and geometry of one camera, and the virtual camera of rectified images.

    Attributes:
        name: Name of the camera.
        width: Columns of the full image.
        height: Rows of the full image.
        model: Distortion model, one of `MODELS`.
        distortion: Coefficients of the model [n].
        camera_matrix: K [3, 3], focal lengths and principal point [px].
        rectification: R [3, 3], rotation from the camera to the rectified camera.
        projection: P [3, 4], the rectified camera [px].

    Raises:
        CalibrationError: The values are implausible.
    """

    name: str
    width: int
    height: int
    model: str
    distortion: Floats
    camera_matrix: Floats
    rectification: Floats
    projection: Floats

    def __post_init__(self) -> None:
        """Raise if the values are implausible."""
        if min(self.width, self.height) <= 0:
            raise CalibrationError(
                f'image size {self.width}x{self.height}: give the columns and rows of the camera'
            )
        check_model(self.model)
        if self.distortion.shape != (len(MODELS[self.model]),):
            raise CalibrationError(
                f'distortion_coefficients: {self.distortion.size} given, '
                f'{self.model} has {len(MODELS[self.model])}'
            )
        for field in fields(self)[4:]:
            if not np.isfinite(getattr(self, field.name)).all():
                raise CalibrationError(f'{field.name} is not finite', remedy='recalibrate')
        for name, matrix in (('camera', self.camera_matrix), ('projection', self.projection)):
            if min(matrix[0, 0], matrix[1, 1]) <= 0.0:
                raise CalibrationError(
                    f'{name}_matrix: focal lengths {matrix[0, 0]:g} and {matrix[1, 1]:g} px must '
                    'be positive'
                )

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.width, self.height

    def undistort(self, points: Floats) -> Floats:
        """Return the rectified pixels of raw pixels [n, 2]."""
        import cv2  # slow to import; a driver without a calibration starts without it

        lens = (self.camera_matrix, self.distortion)
        rectified: dict[str, Any] = {'R': self.rectification, 'P': self.projection}
        given = np.asarray(points, np.float64)[:, None]
        if self.model == EQUIDISTANT:
            return np.asarray(cv2.fisheye.undistortPoints(given, *lens, **rectified)[:, 0])
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)
        return np.asarray(cv2.undistortPoints(given, *lens, **rectified, criteria=stop)[:, 0])


def check_model(model: str) -> None:
    """Raise if a name is not a lens model.

    Raises:
        CalibrationError: It is not in `MODELS`.
    """
    if model not in MODELS:
        raise CalibrationError(f'distortion model {model!r} is unknown: use {", ".join(MODELS)}')


DEFAULT_URL = 'file://${ROS_HOME}/camera_info/${NAME}.yaml'


def resolve(url: str, camera_name: str) -> Path:
    """Return the file that a URL names; it need not exist.

    Args:
        url: `file:///path` or a path, with `${NAME}` and `${ROS_HOME}`; empty for `DEFAULT_URL`.
        camera_name: Value of `${NAME}`.

    Raises:
        CalibrationError: Unknown scheme or variable, or a name with other characters than letters,
            digits and `_`.
    """
    if not re.fullmatch(r'\w+', camera_name):
        raise CalibrationError(f'camera_name {camera_name!r}: use letters, digits and _ only')
    home = os.environ.get('ROS_HOME') or str(Path.home() / '.ros')
    text = (url or DEFAULT_URL).replace('${NAME}', camera_name).replace('${ROS_HOME}', home)
    if '${' in text:
        raise CalibrationError(f'camerainfo_url {url!r}: use the variables ROS_HOME and NAME only')
    scheme, separator, rest = text.partition('://')
    if not separator:
        return Path(text).expanduser().absolute()
    if scheme == 'file' and rest.startswith('/'):
        return Path(unquote(rest))
    if scheme == 'package':
        package, _, place = unquote(rest).partition('/')
        try:
            return share(package) / place
        except (ShareError, ValueError) as error:
            raise CalibrationError(
                f'camerainfo_url {url!r}: no package {package!r}; source its workspace or give a '
                'path'
            ) from error
    raise CalibrationError(
        f'camerainfo_url {url!r}: use file:///path, package://name/path or a path'
    )


def read_camera_info(path: Path) -> CameraCalibration:
    """Return the calibration in a file; keys that are not needed are ignored.

    Raises:
        CalibrationError: The file is missing, damaged, or describes no camera; names the file and
            the key.
    """
    try:
        return parse_camera_info(path.read_text(encoding='utf-8'), path.stem)
    except FileNotFoundError as error:
        raise CalibrationError(f'{path}: no such file: write it with `mixtac calibrate`') from error
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f'{path}: cannot be read ({error}): check the path') from error
    except CalibrationError as error:
        raise CalibrationError(f'{path}: {error.message}', remedy=error.remedy) from error


def parse_camera_info(text: str, name: str = 'camera') -> CameraCalibration:
    """Return the calibration in the text of a file.

    Args:
        text: Text of the file.
        name: Name of the camera where the file has none.

    Raises:
        CalibrationError: As `read_camera_info`.
    """
    # OpenCV writes a directive and tags that YAML does not know.
    text = re.sub(r'^%YAML:1\.0\s*(---)?', '', text).replace('!!opencv-matrix', '')
    try:
        document = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise CalibrationError(f'not valid YAML: {reason}', remedy='recalibrate') from error
    if not isinstance(document, dict):
        raise CalibrationError('no camera_info: it must be a mapping with the key image_width')
    if 'cam0' in document:
        document = _of_kalibr(document['cam0'])
    matrix = _matrix(document, 'camera_matrix', (3, 3))
    coefficients = _matrix(document, 'distortion_coefficients').ravel()
    model = str(document.get('distortion_model', RATIONAL if len(coefficients) == 8 else PLUMB_BOB))
    if model == PLUMB_BOB and len(coefficients) == 4:
        coefficients = np.append(coefficients, 0.0)
    # Both may be absent: then nothing is rectified.
    document.setdefault('rectification_matrix', _block(np.eye(3)))
    document.setdefault('projection_matrix', _block(np.hstack([matrix, np.zeros((3, 1))])))
    return CameraCalibration(
        name=str(document.get('camera_name', name)),
        width=_whole(document, 'image_width'),
        height=_whole(document, 'image_height'),
        model=model,
        distortion=coefficients,
        camera_matrix=matrix,
        rectification=_matrix(document, 'rectification_matrix', (3, 3)),
        projection=_matrix(document, 'projection_matrix', (3, 4)),
    )


def _of_kalibr(camera: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the first camera of a camchain with the keys of camera_info_manager."""
    try:
        fx, fy, cx, cy = camera['intrinsics']
        width, height = camera['resolution']
        model, coefficients = camera['distortion_model'], camera['distortion_coeffs']
        return {
            'distortion_model': KALIBR_MODELS.get(model, model),
            'image_width': width,
            'image_height': height,
            'camera_matrix': _block(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])),
            'distortion_coefficients': _block(np.array([coefficients])),
        }
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f'cam0 of this camchain lacks {error}; recalibrate') from error


def _whole(document: dict[str, Any], key: str) -> int:
    value = document.get(key)
    if type(value) is not int:
        raise CalibrationError(f'{key}: {value!r} is not a whole number; recalibrate')
    return value


def _matrix(document: dict[str, Any], key: str, shape: tuple[int, int] | None = None) -> Floats:
    try:
        block: Any = document[key]
        # The C++ writer omits the point of 1e-05, which YAML 1.1 then reads as text.
        found = np.array([float(each) for each in block['data']])
        found = found.reshape(int(block['rows']), int(block['cols']))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f'{key}: it must have rows, cols and data ({error})') from error
    if shape is not None and found.shape != shape:
        raise CalibrationError(f'{key}: it is {found.shape}, it must be {shape}')
    return found


def _block(matrix: Floats) -> dict[str, Any]:
    rows, columns = matrix.shape
    return {'rows': rows, 'cols': columns, 'data': matrix.ravel().tolist()}


def write_camera_info(path: Path, calibration: CameraCalibration, comment: str = '') -> None:
    """Write a file, and its folder if necessary; readers never see a partial file.

    Args:
        path: File to write; an existing file is replaced.
        calibration: The calibration.
        comment: Lines to put at the top, without `#`.

    Raises:
        FileError: The file cannot be written.
    """
    document = {
        'image_width': calibration.width,
        'image_height': calibration.height,
        'camera_name': calibration.name,
        'camera_matrix': _block(calibration.camera_matrix),
        'distortion_model': calibration.model,
        'distortion_coefficients': _block(calibration.distortion[None, :]),
        'rectification_matrix': _block(calibration.rectification),
        'projection_matrix': _block(calibration.projection),
    }
    lines = [f'# {line}\n' for line in comment.splitlines()]
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    write_text(path, ''.join(lines) + text)


class CalibratedCamera:
    """The calibration that a node serves; there may be none yet.

    Args:
        parameters: Location and use of the calibration.

    Attributes:
        path: File of the calibration, whether or not it exists.
        calibration: The calibration, or None.

    Raises:
        CalibrationError: The file is damaged, or missing although undistortion is enabled.
    """

    def __init__(self, parameters: DeviceParameters) -> None:
        self._p = parameters
        self._size: tuple[int, int] | None = None
        self._table: NDArray[np.int32] | None = None
        self.calibration: CameraCalibration | None = None
        self.path: Path = resolve(parameters.camerainfo_url, parameters.camera_name)
        if self.path.exists():
            self.calibration = read_camera_info(self.path)
        elif parameters.undistort_events:
            raise CalibrationError(
                f'undistortion needs a calibration, and {self.path} does not exist',
                remedy='write it with `mixtac calibrate`, or set camerainfo_url',
            )

    def use_size(self, size: tuple[int, int]) -> None:
        """Check the calibration against a camera that was opened, and prepare undistortion.

        Args:
            size: Columns and rows of the camera.

        Raises:
            CalibrationError: It is of a camera of another size.
        """
        if self.calibration is not None and size != self._size:
            self._check_size(self.calibration, size)
            self._use(self.calibration)
        self._size = size

    def describe(self) -> str:
        """Return one line for the log: the calibration in use, or that there is none."""
        if self.calibration is None:
            return f'not calibrated: no {self.path}; write it with `mixtac calibrate`'
        return f'calibration {self.path} of {self.calibration.name}'

    def complete(self, info: Any) -> Any:  # noqa: ANN401
        """Write the calibration, if any, into a `sensor_msgs/CameraInfo`, and return it."""
        calibration = self.calibration
        if calibration is not None:
            info.width, info.height = calibration.size
            info.distortion_model = calibration.model
            info.d = calibration.distortion.tolist()
            info.k = calibration.camera_matrix.ravel().tolist()
            info.r = calibration.rectification.ravel().tolist()
            info.p = calibration.projection.ravel().tolist()
        return info

    def undistort(self, events: Events) -> Events:
        """Return the events that fall inside the rectified image, at the nearest pixel of it."""
        if self._table is None:
            return Events.empty()
        return move_events(events, self._table, Events.empty(len(events)).fields)

    def save(self, info: Any) -> Path:  # noqa: ANN401
        """Check a calibration, write it to its file, use it from now on, and return the file.

        Args:
            info: A `sensor_msgs/CameraInfo`, or anything with these fields.

        Raises:
            CalibrationError: It is implausible, of another camera, or cannot be written.
        """
        calibration = CameraCalibration(
            name=self._p.camera_name,
            width=info.width,
            height=info.height,
            model=info.distortion_model,
            distortion=np.array(info.d, np.float64),
            camera_matrix=np.array(info.k, np.float64).reshape(3, 3),
            rectification=np.array(info.r, np.float64).reshape(3, 3),
            projection=np.array(info.p, np.float64).reshape(3, 4),
        )
        if self._size is None:
            raise CalibrationError('no camera was opened yet', remedy='attach it and try again')
        self._check_size(calibration, self._size)
        write_camera_info(self.path, calibration)
        self._use(calibration)
        return self.path

    def _use(self, calibration: CameraCalibration) -> None:
        if self._p.undistort_events:
            self._table = undistortion_table(calibration)
            self.undistort(Events.empty())  # compile before the first events arrive
        self.calibration = calibration

    def _check_size(self, calibration: CameraCalibration, size: tuple[int, int]) -> None:
        if calibration.size != size:
            raise CalibrationError(
                f'calibration for {calibration.width}x{calibration.height} px, this camera has '
                f'{size[0]}x{size[1]}',
                remedy='calibrate this camera, or name its file in camerainfo_url',
            )


def undistortion_table(calibration: CameraCalibration) -> NDArray[np.int32]:
    """Return the rectified place of each raw pixel.

    Returns:
        `int32` [height, width], row * 65536 + column, -1 where the place is outside the image.
    """
    width, height = calibration.size
    rows, columns = np.mgrid[0:height, 0:width]
    ideal = calibration.undistort(np.stack([columns.ravel(), rows.ravel()], axis=1))
    near = np.floor(np.nan_to_num(ideal, nan=-1.0).clip(-1.0, 65535.0) + 0.5).astype(np.int32)
    inside = ((near >= 0) & (near < (width, height))).all(axis=1)
    places = near[:, 1] << 16 | near[:, 0]
    return np.where(inside, places, -1).astype(np.int32).reshape(height, width)
