# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Findings about the USB of this computer and the cameras on it, from what the kernel reports.

No permission for the camera itself is needed. Source of the file names: kernel documentation,
ABI/testing/sysfs-bus-usb.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from mixtac_driver.davis346.model import DAVIS346, camera_models, check_firmware
from mixtac_driver.device import open_backend
from mixtac_driver.doctor.computer import Finding, HostFiles, Level, ok, read_text
from mixtac_driver.errors import UnsupportedCameraError, UsbError
from mixtac_driver.parameters import DriverParameters

USBFS_MEMORY = '/sys/module/usbcore/parameters/usbfs_memory_mb'
DEFAULT_MEMORY_MB = 16


def check_libusb() -> Finding:
    """Report which libusb serves real cameras."""
    try:
        backend = open_backend(DAVIS346.name)
    except UsbError as error:
        return Finding('libusb', Level.ERROR, error.message, error.remedy)
    library = getattr(getattr(backend, 'lib', None), '_name', None)
    return ok('libusb', str(library or 'present'))


def check_usb_memory(files: HostFiles, p: DriverParameters | None = None) -> Finding:
    """Check the kernel's limit of memory for queued reads, which all USB programs share."""
    name = 'USB memory'
    p = p or DriverParameters()
    limit = files.number(USBFS_MEMORY)
    needed = p.usb_transfers * p.usb_transfer_size / (1 << 20)
    if limit is None:
        return ok(name, 'unknown (not reported by the kernel)')
    values = {'limit [MiB]': limit, 'needed [MiB]': needed}
    if limit == 0:
        return Finding(name, Level.OK, 'unlimited', values=values)
    remedy = f'echo {max(DEFAULT_MEMORY_MB, round(8 * needed))} | sudo tee {USBFS_MEMORY}'
    if limit < needed:
        found = f'{limit} MiB, and the driver needs {needed:g} MiB'
        return Finding(name, Level.ERROR, found, remedy, values)
    if limit < 2 * needed:
        found = f'{limit} MiB for all USB programs; this driver alone needs {needed:g} MiB'
        return Finding(name, Level.WARN, found, remedy, values)
    return Finding(name, Level.OK, f'{limit} MiB, {needed:g} MiB needed', values=values)


DEVICES = '/sys/bus/usb/devices'
USB3_MBIT = 5000
USB2_MBIT = 480
NO_CAMERA = (
    'plug the camera in and check that its LED is on; without a camera, use --device virtual'
)
SLOW = 'use a USB 3 port (blue, or marked SS) and a USB 3 cable, without a hub in between'


@dataclass(frozen=True, slots=True)
class AttachedCamera:
    """A supported camera on the USB.

    Attributes:
        port: Bus and port, as in `2-1.3`.
        node: Its device node, as in `/dev/bus/usb/002/005`.
        speed_mbit: Speed that was agreed on [Mb/s], None if unknown.
        release: Device release number (`bcdDevice`): the firmware.
        serial: Serial number, empty if unknown.
    """

    port: str
    node: str
    speed_mbit: float | None
    release: int
    serial: str


def cameras_on_bus(files: HostFiles) -> list[AttachedCamera]:
    """Return every supported camera on the USB, by port."""
    try:
        entries = sorted(files.path(DEVICES).iterdir())
    except OSError:
        return []
    found = [_camera(entry) for entry in entries]
    return [camera for camera in found if camera is not None]


def _camera(entry: Path) -> AttachedCamera | None:
    def text(name: str) -> str:
        return read_text(entry / name) or ''

    try:
        usb_id = int(text('idVendor'), 16), int(text('idProduct'), 16)
        if all(usb_id != model.usb_id for model in camera_models()):
            return None
        node = f'/dev/bus/usb/{int(text("busnum")):03d}/{int(text("devnum")):03d}'
        release = int(text('bcdDevice'), 16)
    except ValueError:  # a hub, an interface, or a device that is just going away
        return None
    speed = text('speed')
    return AttachedCamera(
        port=entry.name,
        node=node,
        speed_mbit=float(speed) if speed.replace('.', '', 1).isdigit() else None,
        release=release,
        serial=text('serial'),
    )


def check_presence(files: HostFiles, cameras: list[AttachedCamera], serial: str) -> Finding:
    """Check that the wanted camera is attached."""
    name = 'camera on the USB'
    if not files.path(DEVICES).is_dir():
        found = f'{DEVICES} is missing: this machine or container has no USB'
        remedy = 'in a container, pass /sys and /dev/bus/usb in; else use --device virtual'
        return Finding(name, Level.ERROR, found, remedy)
    if not cameras:
        models = ', '.join(
            f'{model.name} (USB {model.vendor:04x}:{model.product:04x})'
            for model in camera_models()
        )
        return Finding(name, Level.ERROR, f'no {models} is attached', NO_CAMERA)
    listed = ', '.join(f'{c.serial or "no serial number"} at {c.port}' for c in cameras)
    if serial and all(camera.serial != serial for camera in cameras):
        remedy = 'correct --serial, or plug in that camera'
        return Finding(name, Level.ERROR, f'{serial} is not attached; there is {listed}', remedy)
    if len(cameras) > 1 and not serial:
        remedy = 'choose one with --serial'
        return Finding(name, Level.ERROR, f'{len(cameras)} are attached: {listed}', remedy)
    return ok(name, listed, cameras=len(cameras))


def check_speed(camera: AttachedCamera) -> Finding:
    """Check that the port is fast enough for the camera at full rate."""
    name, speed = 'USB speed', camera.speed_mbit
    if speed is None:
        return ok(name, 'unknown (not reported by the kernel)')
    values = {'speed [Mb/s]': speed}
    if speed >= USB3_MBIT:
        return Finding(name, Level.OK, f'{speed:g} Mb/s', values=values)
    if speed < USB2_MBIT:
        return Finding(name, Level.ERROR, f'{speed:g} Mb/s, USB 1', SLOW, values)
    found = f'{speed:g} Mb/s, USB 2: too slow for a busy scene with frames; events will be lost'
    return Finding(name, Level.WARN, found, SLOW, values)


def check_release(camera: AttachedCamera) -> Finding:
    """Check that the driver supports the firmware."""
    try:
        major, minor = check_firmware(camera.release)
    except UnsupportedCameraError as error:
        return Finding('camera firmware', Level.ERROR, error.message, error.remedy)
    return ok('camera firmware', f'{major}.{minor}')


RULE = '65-mixtac.rules'
RULES_FOLDERS = ('/etc/udev/rules.d', '/usr/lib/udev/rules.d', '/lib/udev/rules.d')


def rule_file() -> Path:
    """Return the udev rule that comes with this package."""
    return Path(__file__).resolve().parents[1] / 'udev' / RULE


def installation() -> str:
    """Return the commands that install the udev rule."""
    return (
        f'sudo cp {rule_file()} /etc/udev/rules.d/ && sudo udevadm control --reload && '
        'sudo udevadm trigger --subsystem-match=usb'
    )


def check_permission(files: HostFiles, camera: AttachedCamera) -> Finding:
    """Check the permission of the device node."""
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
            'reconnect the camera; over ssh, join the group plugdev as well: '
            'sudo usermod -aG plugdev "$USER", then log in again'
        )
        return Finding(name, Level.ERROR, found, remedy)
    return Finding(name, Level.ERROR, found, f'{installation()}, then reconnect the camera')


def check_holders(files: HostFiles, camera: AttachedCamera) -> Finding:
    """Report which other programs of this user have the camera open."""
    name = 'used by others'
    holders = sorted(
        (int(folder.name), read_text(folder / 'comm') or 'a program')
        for folder in files.path('/proc').glob('[0-9]*')
        if int(folder.name) != os.getpid() and _has_open(folder / 'fd', camera.node)
    )
    if not holders:
        return ok(name, 'no program of this user has it open')
    listed = ', '.join(f'{program} (process {pid})' for pid, program in holders)
    return Finding(
        name,
        Level.WARN,
        f'{listed} has it open',
        'end that program first: two programs cannot share a camera',
        {'process': holders[0][0]},
    )


def _has_open(descriptors: Path, node: str) -> bool:
    try:
        return any(str(link.readlink()) == node for link in descriptors.iterdir())
    except OSError:  # it ended meanwhile, or belongs to another user
        return False


def check_attached(files: HostFiles, serial: str = '') -> list[Finding]:
    """Return the findings about the cameras on the USB.

    Args:
        files: Files of the operating system.
        serial: Serial number of the wanted camera; empty takes the only one.
    """
    cameras = cameras_on_bus(files)
    findings = [
        check_libusb(),
        check_usb_memory(files),
        check_presence(files, cameras, serial),
    ]
    for camera in cameras:
        if serial in {'', camera.serial}:
            findings += [
                check_speed(camera),
                check_release(camera),
                check_permission(files, camera),
                check_holders(files, camera),
            ]
    return findings
