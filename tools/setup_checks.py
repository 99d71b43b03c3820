# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What this machine has: Python, compilers, perhaps a ROS 2 installation."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from setup_steps import ROOT, SetupError

SUPPORTED_PYTHON = ((3, 10), (3, 13))
SUPPORTED_DISTROS = ('jazzy', 'kilted', 'lyrical', 'rolling')
NEEDED_MB = 1200
"""What an environment without optional parts takes on the disk [MB]."""
LINKS = ('src/mixtac_bringup/config', 'src/mixtac_bringup/launch', 'src/mixtac_fger/models')
"""Symbolic links of the sources."""


def full_ros() -> str:
    """Return the distro of a sourced ROS 2 installation, or an empty string for wheels.

    Raises:
        SetupError: A ROS version too old is sourced.
    """
    distro = os.environ.get('ROS_DISTRO', '')
    prefixes = [p for p in os.environ.get('AMENT_PREFIX_PATH', '').split(':') if p]
    outside = [p for p in prefixes if not Path(p).resolve().is_relative_to(ROOT)]
    if not distro or not outside:
        return ''
    if distro not in SUPPORTED_DISTROS:
        raise SetupError(
            f'ROS {distro} is sourced; Mixtac needs one of {", ".join(SUPPORTED_DISTROS)}. Open a '
            'shell without it (ROS 2 Jazzy is then set up here by itself) or source a newer one.'
        )
    return distro


def check_python() -> None:
    """Refuse a Python without wheels of ROS 2.

    Raises:
        SetupError: Version not supported.
    """
    low, high = SUPPORTED_PYTHON
    if not low <= sys.version_info[:2] <= high:
        found = '.'.join(map(str, sys.version_info[:3]))
        raise SetupError(
            f'Python {found} is not supported: use {low[0]}.{low[1]} to {high[0]}.{high[1]}, for '
            'example `make test PYTHON=python3.11`.'
        )


def check_system() -> None:
    """Refuse a machine without space, or without what pip cannot bring.

    Raises:
        SetupError: Names what is missing and the remedy.
    """
    if (free_mb := shutil.disk_usage(ROOT).free // 1_000_000) < NEEDED_MB:
        raise SetupError(
            f'{free_mb} MB are free on the disk of {ROOT}, and {NEEDED_MB} MB are needed: free some'
        )
    missing = {}
    if not shutil.which('make'):
        missing['make'] = 'make'
    if not (shutil.which('cc') and shutil.which('c++')):
        missing['a C and C++ compiler'] = 'build-essential'
    if not (Path(sysconfig.get_paths()['include']) / 'Python.h').exists():
        missing['the Python headers'] = 'python3-dev'
    if subprocess.run(
        [sys.executable, '-c', 'import ensurepip'], capture_output=True, check=False
    ).returncode:
        missing['venv'] = 'python3-venv'
    if missing:
        raise SetupError(
            f'missing: {", ".join(missing)}. Install with: sudo apt-get install -y '
            + ' '.join(missing.values())
        )


def check_place(distro: str) -> None:
    """Refuse a folder or a processor on which the build is known to fail.

    Args:
        distro: ROS installation that is sourced, empty where ROS comes as wheels.

    Raises:
        SetupError: Names the folder or the processor and what to do.
    """
    if any(character.isspace() for character in str(ROOT)):
        raise SetupError(
            f'the path {str(ROOT)!r} contains white space, which the build of ROS packages cannot '
            'handle: move the clone to a path without.'
        )
    for link in LINKS:
        if not (ROOT / link).is_dir():
            raise SetupError(
                f'{link} is no folder: the copy of the sources has lost its symbolic links, as zip '
                'files on Windows do. Clone them with git.'
            )
    machine = platform.machine()
    if not distro and machine != 'x86_64':
        raise SetupError(
            f'the wheels of ROS 2 exist for x86_64 only, this machine is {machine}: install ROS 2 '
            'Jazzy or newer, source it, and run the same command again.'
        )
