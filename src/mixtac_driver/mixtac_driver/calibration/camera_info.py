# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration files in the YAML format of camera_info_manager, and the URLs that name them."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote

import numpy as np
import yaml
from numpy.typing import NDArray

from mixtac_driver.calibration.lens import MODELS, CalibrationError, CameraCalibration, check_model
from mixtac_node.files import FileError, load_yaml, write_text

T = TypeVar('T')
DEFAULT_URL = 'file://${ROS_HOME}/camera_info/${NAME}.yaml'
_VARIABLE = re.compile(r'\$\{(\w*)\}')
_SCHEME = re.compile(r'^(\w+)://')
_NAME = re.compile(r'^\w+$')


def resolve(url: str, camera_name: str) -> Path:
    """Return the file that a URL names; it need not exist.

    Args:
        url: Where the calibration is, see the module.
        camera_name: What `${NAME}` stands for.

    Raises:
        CalibrationError: Unknown scheme, variable or package, a relative `file://` URL, or a name
            with other characters than letters, digits and `_`.
    """
    if not _NAME.match(camera_name):
        raise CalibrationError(
            f'camera_name {camera_name!r}: use letters, digits and _ only, at least one'
        )
    text = _VARIABLE.sub(lambda found: _value(found[1], url, camera_name), url or DEFAULT_URL)
    scheme = _SCHEME.match(text)
    if scheme is None:
        return Path(text).expanduser().absolute()
    rest = unquote(text[scheme.end() :])
    if scheme[1] == 'file':
        if not rest.startswith('/'):
            raise CalibrationError(
                f'camerainfo_url {url!r}: a file URL has three slashes, file:///absolute/path.yaml'
            )
        return Path(rest)
    if scheme[1] == 'package':
        return _in_package(rest, url)
    raise CalibrationError(
        f'camerainfo_url {url!r}: use file:///path, package://name/path or a path'
    )


def _value(variable: str, url: str, camera_name: str) -> str:
    if variable == 'NAME':
        return camera_name
    if variable == 'ROS_HOME':
        return os.environ.get('ROS_HOME') or str(Path.home() / '.ros')
    raise CalibrationError(
        f'camerainfo_url {url!r}: ${{{variable}}} is unknown; use ${{ROS_HOME}} or ${{NAME}}'
    )


def _in_package(rest: str, url: str) -> Path:
    package, _, path = rest.partition('/')
    if not package or not path:
        raise CalibrationError(f'camerainfo_url {url!r}: give package://name/path.yaml')
    try:
        from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
    except ImportError as error:
        raise CalibrationError(
            f'camerainfo_url {url!r}: packages cannot be looked up without ament_index_python; '
            'give a path'
        ) from error
    try:
        return Path(get_package_share_directory(package)) / path
    except (PackageNotFoundError, ValueError) as error:
        raise CalibrationError(
            f'camerainfo_url {url!r}: no package {package}; source its workspace or give a path'
        ) from error


_KEYS = (
    'image_width',
    'image_height',
    'camera_name',
    'camera_matrix',
    'distortion_model',
    'distortion_coefficients',
    'rectification_matrix',
    'projection_matrix',
)
_MAX_BYTES = 1 << 20


def read_camera_info(path: Path) -> CameraCalibration:
    """Return the calibration in a file.

    Args:
        path: YAML file as `ros2 run camera_calibration` and `mixtac calibrate` write it.

    Raises:
        CalibrationError: The file is missing, damaged, or describes no camera; names the file,
            the key and what is wrong with it.
    """
    try:
        return parse_camera_info(_text(path))
    except CalibrationError as error:
        raise CalibrationError(f'{path}: {error.message}', remedy=error.remedy) from error


def parse_camera_info(text: str) -> CameraCalibration:
    """Return the calibration in the text of a file.

    Raises:
        CalibrationError: As `read_camera_info`.
    """
    try:
        document = load_yaml(text)
    except FileError as error:
        raise CalibrationError(f'{error.message}; recalibrate') from error
    if not isinstance(document, dict):
        raise CalibrationError('no camera_info: it must be a mapping with the key image_width')
    missing = [key for key in _KEYS if key not in document]
    if missing:
        raise CalibrationError(f'key {missing[0]} is missing; recalibrate')
    model = _typed(document, 'distortion_model', str)
    check_model(model)
    return CameraCalibration(
        name=_typed(document, 'camera_name', str),
        width=_typed(document, 'image_width', int),
        height=_typed(document, 'image_height', int),
        model=model,
        distortion=_matrix(document, 'distortion_coefficients', 1, len(MODELS[model])).ravel(),
        camera_matrix=_matrix(document, 'camera_matrix', 3, 3),
        rectification=_matrix(document, 'rectification_matrix', 3, 3),
        projection=_matrix(document, 'projection_matrix', 3, 4),
    )


def format_camera_info(calibration: CameraCalibration, comment: str = '') -> str:
    """Return the text of a file.

    Args:
        calibration: What to write.
        comment: Lines to put at the top, without `#`.
    """
    lines = [f'# {line}'.rstrip() for line in comment.splitlines()]
    name = yaml.safe_dump(calibration.name, default_style="'", width=10_000).strip()
    lines += [
        f'image_width: {calibration.width}',
        f'image_height: {calibration.height}',
        f'camera_name: {name}',
        *_block('camera_matrix', calibration.camera_matrix),
        f'distortion_model: {calibration.model}',
        *_block('distortion_coefficients', calibration.distortion[None, :]),
        *_block('rectification_matrix', calibration.rectification),
        *_block('projection_matrix', calibration.projection),
    ]
    return '\n'.join(lines) + '\n'


def write_camera_info(path: Path, calibration: CameraCalibration, comment: str = '') -> None:
    """Write a file, and its folder if necessary; readers never see a partial file.

    Args:
        path: File to write; an existing calibration is replaced.
        calibration: What to write.
        comment: Lines to put at the top, without `#`.

    Raises:
        CalibrationError: The file is there and is not a calibration.
        FileError: It cannot be written.
    """
    if path.exists():
        try:
            read_camera_info(path)
        except CalibrationError as error:
            raise CalibrationError(
                f'{path} is not a calibration and stays as it is ({error.message})',
                remedy='remove it, or name another file',
            ) from error
    write_text(path, format_camera_info(calibration, comment))


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise CalibrationError('larger than 1 MiB: this is no camera_info file')
        return path.read_text(encoding='utf-8')
    except FileNotFoundError as error:
        raise CalibrationError('no such file: write it with `mixtac calibrate`') from error
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f'cannot be read ({error}): check the path') from error


def _typed(document: dict[Any, Any], key: str, kind: type[T]) -> T:
    value = document[key]
    if type(value) is not kind:
        wanted = 'text' if kind is str else 'a whole number'
        raise CalibrationError(f'{key}: {value!r} is not {wanted}')
    return value


def _matrix(document: dict[Any, Any], key: str, rows: int, columns: int) -> NDArray[np.float64]:
    block = document[key]
    if not isinstance(block, dict) or not {'rows', 'cols', 'data'} <= set(block):
        raise CalibrationError(f'{key}: must have rows, cols and data')
    if (block['rows'], block['cols']) != (rows, columns):
        raise CalibrationError(
            f'{key}: is {block["rows"]}x{block["cols"]}, must be {rows}x{columns}'
        )
    data = block['data']
    if not isinstance(data, list) or len(data) != rows * columns:
        raise CalibrationError(f'{key}: data must be a list of {rows * columns} numbers')
    return np.array([_float(each, key) for each in data]).reshape(rows, columns)


def _float(value: object, key: str) -> float:
    # The C++ writer leaves the point out of 1e-05, which YAML 1.1 then takes for text.
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    raise CalibrationError(f'{key}: {value!r} in data is not a number')


def _block(key: str, matrix: NDArray[np.float64]) -> list[str]:
    rows, columns = matrix.shape
    values = ', '.join(_number(float(each)) for each in matrix.ravel())
    return [f'{key}:', f'  rows: {rows}', f'  cols: {columns}', f'  data: [{values}]']


def _number(value: float) -> str:
    text = repr(value)
    return text.replace('e', '.0e') if 'e' in text and '.' not in text else text
