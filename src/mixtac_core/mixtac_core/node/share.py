# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Paths of the files that packages install beside their modules: parameters, models, messages."""

from __future__ import annotations

import sys
from pathlib import Path

from mixtac_core.events.errors import MixtacError


class ShareError(MixtacError):
    """A package whose files are not installed."""


def share(package: str) -> Path:
    """Return the folder of the files that a package installs, with ROS or without.

    Args:
        package: Name of a package in an ament index, or of one that pip has installed.

    Raises:
        ShareError: The package is not installed.
    """
    installed = Path(sys.prefix) / 'share' / package
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory(package))
    except (ImportError, LookupError, OSError) as error:  # no ROS, or none that has this package
        if installed.is_dir():
            return installed
        raise ShareError(
            f'the files of {package} are not installed',
            remedy='run "make setup", or source the workspace that has it',
        ) from error
