# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Findings about this computer and the cameras on its USB, from what the kernel reports.

No permission for the camera itself is needed. Source of the file names: kernel documentation,
ABI/testing/sysfs-bus-usb.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

from mixtac_driver.davis346.model import DAVIS346, camera_models, check_firmware
from mixtac_driver.device import open_backend
from mixtac_driver.errors import UnsupportedCameraError, UsbError
from mixtac_driver.parameters import DriverParameters

Value = str | int | float | bool | None


class Level(IntEnum):
    """Severity, ordered."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of a check.

    Attributes:
        name: What was checked, in a few words.
        level: Severity.
        found: What was found.
        remedy: What to do about it, or empty.
        values: The figures behind it, by name with unit.
    """

    name: str
    level: Level
    found: str
    remedy: str = ''
    values: Mapping[str, Value] = field(default_factory=dict)


def ok(name: str, found: str, **values: Value) -> Finding:
    """Return a finding that needs no action."""
    return Finding(name, Level.OK, found, values=values)


def worst(findings: Iterable[Finding]) -> Level:
    """Return the highest level of all, OK where there are none."""
    return max((finding.level for finding in findings), default=Level.OK)


def first_to_do(findings: Iterable[Finding]) -> Finding | None:
    """Return the first of the worst findings, or None if all are OK.

    Checks are ordered by dependence, so the first is the one to fix.
    """
    found = list(findings)
    level = worst(found)
    return next((f for f in found if f.level is level), None) if level > Level.OK else None


@dataclass(frozen=True, slots=True)
class HostFiles:
    """The files of the operating system.

    Attributes:
        root: The root folder; another one only in tests.
    """

    root: Path = Path('/')

    def path(self, absolute: str) -> Path:
        """Return the location of a path like `/sys/bus`."""
        return self.root / absolute.lstrip('/')

    def text(self, absolute: str) -> str | None:
        """Return the text of a file without surrounding blanks, or None if it cannot be read."""
        return read_text(self.path(absolute))

    def number(self, absolute: str) -> int | None:
        """Return the number in a file, or None if there is none."""
        text = self.text(absolute)
        return int(text) if text is not None and text.lstrip('-').isdigit() else None

    def may_use(self, absolute: str) -> bool:
        """Return whether this process may read and write a file."""
        return os.access(self.path(absolute), os.R_OK | os.W_OK)


def read_text(path: Path) -> str | None:
    """Return the text of a file without surrounding blanks, or None if it cannot be read."""
    try:
        return path.read_text(errors='replace').strip()
    except OSError:
        return None


CPUS = '/sys/devices/system/cpu'
RECEIVE_LIMIT = '/proc/sys/net/core/rmem_max'
FRAGMENT_MEMORY = '/proc/sys/net/ipv4/ipfrag_high_thresh'
FRAGMENT_TIME = '/proc/sys/net/ipv4/ipfrag_time'
SLOW_GOVERNORS = frozenset({'powersave', 'ondemand', 'conservative'})
OWN_GOVERNOR = frozenset({'intel_pstate', 'amd-pstate-epp'})
"""Drivers whose `powersave` lets the processor run at full speed."""
LEAST_CORES = 2
LEAST_DISK_GB = 10.0
BURST_BYTES = 1_400_000
"""A frame of 16 bits (180 kB) and 10 ms of events at the sensor's limit of 12 million per second
(480 kB), twice because the kernel counts its bookkeeping too."""
MOST_FRAGMENT_TIME_S = 3
"""A datagram of 64 kB that lost a fragment is kept so long; of those of a lossy network, 40 frames
a second fill the memory for all others."""
LOST_PER_S = 40 * 65536
UNSYNCHRONISED = 0x40
"""STA_UNSYNC of adjtimex(2)."""
LONG_BYTES, TIMEX_BYTES, TIMEX_STATUS_AT, TIMEX_ERROR_AT = 8, 208, 40, 24


def check_processor(files: HostFiles) -> Finding:
    """Check the number of cores and their frequency governor."""
    cores = len(os.sched_getaffinity(0))
    settings = sorted(files.path(CPUS).glob('cpu[0-9]*/cpufreq/scaling_governor'))
    governors = {path.read_text().strip() for path in settings}
    driver = files.text(f'{CPUS}/cpu0/cpufreq/scaling_driver') or ''
    listed = ', '.join(sorted(governors)) or 'not visible'
    values: dict[str, Value] = {'cores': cores, 'governor': listed}
    found = f'{cores} cores, frequency governor {listed}'
    if cores < LEAST_CORES:
        remedy = f'give the process {LEAST_CORES} cores or more: USB and decoding are two threads'
        return Finding('processor', Level.WARN, found, remedy, values)
    if governors & SLOW_GOVERNORS and driver not in OWN_GOVERNOR:
        remedy = 'for steady latency: sudo cpupower frequency-set -g performance'
        return Finding('processor', Level.WARN, found, remedy, values)
    return Finding('processor', Level.OK, found, values=values)


def check_kernel(files: HostFiles) -> Finding:
    """Report the kernel and whether it is a real-time one."""
    realtime = files.text('/sys/kernel/realtime') == '1'
    release = f'{platform.system()} {platform.release()}'
    return ok('kernel', release + (', real-time' if realtime else ''), realtime=realtime)


def kernel_clock() -> tuple[bool, float]:
    """Return whether the kernel's clock is synchronised, and the greatest error it assumes [s].

    Raises:
        OSError: The kernel does not report it.
    """
    if ctypes.sizeof(ctypes.c_long) != LONG_BYTES:
        raise OSError('the layout of timex is known for 64-bit systems only')
    library = ctypes.CDLL(None, use_errno=True)
    state = ctypes.create_string_buffer(TIMEX_BYTES)  # modes = 0: nothing is set
    if library.adjtimex(state) < 0:
        raise OSError(ctypes.get_errno(), 'adjtimex')
    status = int.from_bytes(state.raw[TIMEX_STATUS_AT : TIMEX_STATUS_AT + 4], 'little')
    error_us = int.from_bytes(state.raw[TIMEX_ERROR_AT : TIMEX_ERROR_AT + 8], 'little')
    return not status & UNSYNCHRONISED, error_us / 1e6


def check_clock(synchronised: bool | None, error_s: float) -> Finding:
    """Check that the computer's clock is synchronised.

    Args:
        synchronised: As `kernel_clock` returns it, or None if unknown.
        error_s: Greatest error that the kernel assumes [s].
    """
    name = 'real-time clock'
    if synchronised is None:
        return ok(name, 'unknown (not reported by the kernel)')
    if synchronised:
        return ok(name, f'synchronised, at most {error_s * 1e3:.1f} ms off', error_s=error_s)
    found = 'not synchronised: times of several machines cannot be compared'
    remedy = 'where several machines take part: sudo apt-get install chrony'
    return Finding(name, Level.WARN, found, remedy)


def check_disk(folder: Path) -> Finding:
    """Check the free disk space for a recording in this folder."""
    free_gb = shutil.disk_usage(folder).free / 1e9
    values = {'free [GB]': round(free_gb, 1)}
    found = f'{free_gb:.0f} GB free in {folder}'
    if free_gb < LEAST_DISK_GB:
        remedy = 'record to another disk: a busy scene writes some GB per minute'
        return Finding('disk', Level.WARN, found, remedy, values)
    return Finding('disk', Level.OK, found, values=values)


def check_receive_buffer(files: HostFiles) -> Finding:
    """Check that bursts fit the receive buffers of DDS between machines."""
    limit = files.number(RECEIVE_LIMIT)
    if limit is None:
        return ok('network buffers', 'unknown (not reported by the kernel)')
    values = {'limit [bytes]': limit, 'needed [bytes]': BURST_BYTES}
    if limit >= BURST_BYTES:
        return Finding('network buffers', Level.OK, f'{limit} bytes', values=values)
    found = f'{limit} bytes; a frame and a burst of events need {BURST_BYTES} between machines'
    remedy = 'on the receiving machine: sudo sysctl -w net.core.rmem_max=4194304'
    return Finding('network buffers', Level.WARN, found, remedy, values)


def check_fragments(files: HostFiles) -> Finding:
    """Check that incomplete datagrams of a lossy network leave room for others."""
    name = 'IP fragments'
    memory, seconds = files.number(FRAGMENT_MEMORY), files.number(FRAGMENT_TIME)
    if memory is None or seconds is None:
        return ok(name, 'unknown (not reported by the kernel)')
    values = {'memory [bytes]': memory, 'time [s]': seconds}
    found = f'incomplete datagrams are kept for {seconds} s in up to {memory} bytes'
    if seconds <= MOST_FRAGMENT_TIME_S or memory >= 2 * LOST_PER_S * seconds:
        return Finding(name, Level.OK, found, values=values)
    remedy = (
        'where frames cross a lossy network, on the receiving machine: '
        f'sudo sysctl -w net.ipv4.ipfrag_time={MOST_FRAGMENT_TIME_S}'
    )
    return Finding(name, Level.OK, found, remedy, values)


def check_computer(files: HostFiles, folder: Path) -> list[Finding]:
    """Return all findings about the computer.

    Args:
        files: Files of the operating system.
        folder: Where recordings would go.
    """
    synchronised, error_s = None, 0.0
    with contextlib.suppress(OSError, AttributeError):
        synchronised, error_s = kernel_clock()
    return [
        check_processor(files),
        check_kernel(files),
        check_disk(folder),
        check_receive_buffer(files),
        check_fragments(files),
        check_clock(synchronised, error_s),
    ]


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
        power: Power management: `on` or `auto`, empty if unknown.
    """

    port: str
    node: str
    speed_mbit: float | None
    release: int
    serial: str
    power: str


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
        power=text('power/control'),
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


def check_power(camera: AttachedCamera) -> Finding:
    """Report whether the kernel may suspend the camera; it does not while a program uses it."""
    name = 'USB power management'
    reported = {'auto': 'may sleep while no program has it open', 'on': 'never sleeps'}
    found = reported.get(camera.power, 'unknown (not reported by the kernel)')
    return ok(name, found, **({'control': 'auto'} if camera.power == 'auto' else {}))


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
                check_power(camera),
                check_permission(files, camera),
                check_holders(files, camera),
            ]
    return findings
