# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the driver needs of the system: libusb, and memory of the kernel for its transfers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_driver.backend import REAL, open_backend
from mixtac_driver.doctor.finding import Finding, Level, ok
from mixtac_driver.errors import UsbError
from mixtac_driver.stream import StreamSettings

if TYPE_CHECKING:
    from mixtac_driver.doctor.host_files import HostFiles

USBFS_MEMORY = '/sys/module/usbcore/parameters/usbfs_memory_mb'
DEFAULT_MEMORY_MB = 16


def check_libusb() -> Finding:
    """Say which libusb serves real cameras."""
    try:
        backend = open_backend(REAL)
    except UsbError as error:
        found, _, remedy = str(error).partition(': ')
        return Finding('libusb', Level.ERROR, found, remedy)
    library = getattr(getattr(backend, 'lib', None), '_name', None)
    return ok('libusb', str(library or 'present'))


def check_usb_memory(files: HostFiles, settings: StreamSettings | None = None) -> Finding:
    """Say whether the kernel lets programs keep enough reads waiting; all USB programs share it."""
    name = 'USB memory'
    settings = settings or StreamSettings()
    limit = files.number(USBFS_MEMORY)
    needed = settings.transfers * settings.transfer_size / (1 << 20)
    if limit is None:
        return ok(name, 'the kernel does not tell')
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
