# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cameras on the USB, as the kernel lists them; needs no permission for the camera itself.

Source of the file names: kernel documentation, ABI/testing/sysfs-bus-usb.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_driver.backend import PRODUCT, VENDOR
from mixtac_driver.doctor.finding import Finding, Level, ok
from mixtac_driver.doctor.host_files import read_text
from mixtac_driver.errors import UnsupportedCameraError
from mixtac_driver.identity import check_firmware

if TYPE_CHECKING:
    from pathlib import Path

    from mixtac_driver.doctor.host_files import HostFiles

DEVICES = '/sys/bus/usb/devices'
USB3_MBIT = 5000
USB2_MBIT = 480
NO_CAMERA = 'plug the camera in and look whether its lamp is on; without one, use --device virtual'
SLOW = 'use a USB 3 port (blue, or marked SS) and a USB 3 cable, without a hub in between'


@dataclass(frozen=True, slots=True)
class AttachedCamera:
    """A DAVIS346 that is plugged in.

    Attributes:
        port: Bus and port, as in `2-1.3`.
        node: Its device node, as in `/dev/bus/usb/002/005`.
        speed_mbit: Speed that was agreed on [Mb/s], None where the kernel does not tell.
        release: Device release number (`bcdDevice`): the firmware.
        serial: Serial number, empty where the kernel does not tell.
        power: Power management: `on` or `auto`, empty where the kernel does not tell.
    """

    port: str
    node: str
    speed_mbit: float | None
    release: int
    serial: str
    power: str


def attached_cameras(files: HostFiles) -> list[AttachedCamera]:
    """Return every DAVIS346 on the USB, by port."""
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
        if (int(text('idVendor'), 16), int(text('idProduct'), 16)) != (VENDOR, PRODUCT):
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
        power=text('power/control'),
    )


def check_presence(files: HostFiles, cameras: list[AttachedCamera], serial: str) -> Finding:
    """Say which cameras are attached, and whether the wanted one is among them."""
    name = 'camera on the USB'
    if not files.path(DEVICES).is_dir():
        found = f'{DEVICES} is missing: this machine or container has no USB'
        remedy = 'in a container, pass /sys and /dev/bus/usb in; else use --device virtual'
        return Finding(name, Level.ERROR, found, remedy)
    if not cameras:
        found = f'no DAVIS346 (USB {VENDOR:04x}:{PRODUCT:04x}) is attached'
        return Finding(name, Level.ERROR, found, NO_CAMERA)
    listed = ', '.join(f'{c.serial or "no serial number"} at {c.port}' for c in cameras)
    if serial and all(camera.serial != serial for camera in cameras):
        remedy = 'correct --serial, or plug that camera in'
        return Finding(name, Level.ERROR, f'{serial} is not attached; there is {listed}', remedy)
    if len(cameras) > 1 and not serial:
        remedy = 'choose one with --serial'
        return Finding(name, Level.ERROR, f'{len(cameras)} are attached: {listed}', remedy)
    return ok(name, listed, cameras=len(cameras))


def check_speed(camera: AttachedCamera) -> Finding:
    """Say whether the port is fast enough for the camera at its busiest."""
    name, speed = 'USB speed', camera.speed_mbit
    if speed is None:
        return ok(name, 'the kernel does not tell')
    values = {'speed [Mb/s]': speed}
    if speed >= USB3_MBIT:
        return Finding(name, Level.OK, f'{speed:g} Mb/s', values=values)
    if speed < USB2_MBIT:
        return Finding(name, Level.ERROR, f'{speed:g} Mb/s, USB 1', SLOW, values)
    found = f'{speed:g} Mb/s, USB 2: too slow for a busy scene with frames; events will be lost'
    return Finding(name, Level.WARN, found, SLOW, values)


def check_release(camera: AttachedCamera) -> Finding:
    """Say whether the firmware is one that the driver speaks to."""
    try:
        major, minor = check_firmware(camera.release)
    except UnsupportedCameraError as error:
        found, _, remedy = str(error).partition('; ')
        return Finding('camera firmware', Level.ERROR, found, remedy)
    return ok('camera firmware', f'{major}.{minor}')


def check_power(camera: AttachedCamera) -> Finding:
    """Say whether the kernel may put the camera to sleep; it does not while a program has it."""
    name = 'USB power management'
    if camera.power == 'auto':
        return ok(name, 'may sleep while no program has it open', control=camera.power)
    return ok(name, 'never sleeps' if camera.power == 'on' else 'the kernel does not tell')
