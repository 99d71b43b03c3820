# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where models are found: a path, or a name among those that come with the package."""

from __future__ import annotations

from pathlib import Path

DEFAULT_MODEL = 'fger_small'
SUFFIX = '.safetensors'


def shipped_models() -> Path:
    """Return the folder of the models that come with the package."""
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory('mixtac_fger')) / 'models'
    except (ImportError, LookupError, OSError):  # no ROS, or none that knows this package
        return Path(__file__).resolve().parents[1] / 'models'


def find_model(name: str) -> Path:
    """Return the file that `name` means; it may not exist (`load_model` says so).

    Args:
        name: A path (with a folder or the suffix `.safetensors`), or a name like `fger_small`.
    """
    path = Path(name).expanduser()
    if path.suffix == SUFFIX or len(path.parts) > 1:
        shipped = shipped_models() / path
        return shipped if len(path.parts) == 1 and not path.exists() else path
    return shipped_models() / (name + SUFFIX)
