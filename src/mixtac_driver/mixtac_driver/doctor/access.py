# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""May the camera be opened, and does another program have it open?"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from mixtac_driver.doctor.finding import Finding, Level, ok
from mixtac_driver.doctor.host_files import read_text

if TYPE_CHECKING:
    from mixtac_driver.doctor.host_files import HostFiles
    from mixtac_driver.doctor.usb_bus import AttachedCamera

RULE = '65-mixtac.rules'
RULES_FOLDERS = ('/etc/udev/rules.d', '/usr/lib/udev/rules.d', '/lib/udev/rules.d')


def rule_file() -> Path:
    """Return the udev rule that comes with this package."""
    beside = Path(__file__).resolve().parents[2] / 'udev' / RULE
    if beside.exists():
        return beside
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory('mixtac_driver')) / RULE
    except (ImportError, LookupError):
        return beside


def installation() -> str:
    """Return the commands that install the udev rule."""
    return (
        f'sudo cp {rule_file()} /etc/udev/rules.d/ && sudo udevadm control --reload && '
        'sudo udevadm trigger --subsystem-match=usb'
    )


def check_permission(files: HostFiles, camera: AttachedCamera) -> Finding:
    """Say whether the device node may be opened, and which rule to install where not."""
    name = 'permission'
    if not files.path(camera.node).exists():
        remedy = 'in a container, pass it in: docker run --device=/dev/bus/usb'
        return Finding(name, Level.ERROR, f'{camera.node} is missing', remedy)
    if files.may_use(camera.node):
        return ok(name, f'{camera.node} may be opened')
    installed = any(files.path(f'{folder}/{RULE}').exists() for folder in RULES_FOLDERS)
    found = f'{camera.node} may not be opened'
    if installed:
        found += f', although the udev rule {RULE} is installed'
        remedy = (
            'plug the camera in again; over ssh, join the group plugdev as well: '
            'sudo usermod -aG plugdev "$USER", then log in again'
        )
        return Finding(name, Level.ERROR, found, remedy)
    return Finding(name, Level.ERROR, found, f'{installation()}, then plug the camera in again')


def check_holders(files: HostFiles, camera: AttachedCamera) -> Finding:
    """Say which other programs have the camera open, as far as this user may look."""
    name = 'used by others'
    holders = _holders(files, camera.node)
    if not holders:
        return ok(name, 'no program of this user has it open')
    listed = ', '.join(f'{program} (process {pid})' for pid, program in holders)
    return Finding(
        name,
        Level.WARN,
        f'{listed} has it open',
        'end that program first; two cannot use one camera',
        {'process': holders[0][0]},
    )


def _holders(files: HostFiles, node: str) -> list[tuple[int, str]]:
    found = []
    for folder in files.path('/proc').glob('[0-9]*'):
        pid = int(folder.name)
        if pid != os.getpid() and _has_open(folder / 'fd', node):
            found.append((pid, read_text(folder / 'comm') or 'a program'))
    return sorted(found)


def _has_open(descriptors: Path, node: str) -> bool:
    try:
        return any(str(link.readlink()) == node for link in descriptors.iterdir())
    except OSError:  # it ended meanwhile, or belongs to another user
        return False
