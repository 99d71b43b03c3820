# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where a calibration file is: the URLs that camera_info_manager knows.

`file:///absolute/path.yaml`, `package://package/path.yaml`, a plain path, and in each of them
`${ROS_HOME}` and `${NAME}` (the camera's name). Empty stands for DEFAULT_URL.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from urllib.parse import unquote

from mixtac_driver.calibration.errors import CalibrationError

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
        return _absolute(rest, url)
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


def _absolute(path: str, url: str) -> Path:
    if not path.startswith('/'):
        raise CalibrationError(
            f'camerainfo_url {url!r}: a file URL has three slashes, file:///absolute/path.yaml'
        )
    return Path(path)


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
