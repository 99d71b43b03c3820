# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""All that can be said of a real camera without opening it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_driver.doctor import access, software, usb_bus

if TYPE_CHECKING:
    from mixtac_driver.doctor.finding import Finding
    from mixtac_driver.doctor.host_files import HostFiles


def check_attached(files: HostFiles, serial: str = '') -> list[Finding]:
    """Return what the system says of the cameras that are plugged in.

    Args:
        files: Files of the operating system.
        serial: Serial number of the wanted camera; empty takes the only one.
    """
    cameras = usb_bus.attached_cameras(files)
    findings = [
        software.check_libusb(),
        software.check_usb_memory(files),
        usb_bus.check_presence(files, cameras, serial),
    ]
    for camera in cameras:
        if serial in {'', camera.serial}:
            findings += [
                usb_bus.check_speed(camera),
                usb_bus.check_release(camera),
                usb_bus.check_power(camera),
                access.check_permission(files, camera),
                access.check_holders(files, camera),
            ]
    return findings
