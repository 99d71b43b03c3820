# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bundle of `mixtac doctor`: what a user sends to somebody who looks for a fault.

Serial numbers are replaced by hashes, the home folder by `~` and the name of the computer by
`host`, in every file. Equal numbers have equal hashes; who knows the few digits of a serial number
can compute its hash.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import re
import socket
import sys
import tempfile
import zipfile
from dataclasses import asdict
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mixtac_driver.camera import CameraBatch
from mixtac_driver.doctor.computer import HostFiles, read_text
from mixtac_driver.doctor.usb import DEVICES, USBFS_MEMORY
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.usb.capture import MEMBER, CaptureWriter
from mixtac_events.arrays import Events
from mixtac_events.clock_map import ClockMap
from mixtac_events.readings import Frame, InertialSamples
from mixtac_node.files import replacing
from mixtac_node.parameters import parameter_file

CAPTURE_S = 5.0
EVENTS_US = 1_000_000
MOST_EVENTS = 2_000_000
MOST_FRAMES = 25
USB_FIELDS = ('speed', 'version', 'bcdDevice', 'bMaxPower', 'manufacturer', 'product', 'serial')
SYSTEM_FILES = (
    *('/proc/version', '/proc/cpuinfo', '/proc/meminfo', '/etc/os-release', USBFS_MEMORY),
    '/sys/module/usbcore/parameters/autosuspend',
)
SHOWN_CHARACTERS = 4000


def hashed(serial: str) -> str:
    """Return what stands for a serial number: eight characters."""
    return 'h' + hashlib.sha256(f'mixtac {serial}'.encode()).hexdigest()[:7]


class Member(NamedTuple):
    """One file of a bundle: its name, what it holds, and its bytes or where they are."""

    name: str
    about: str
    content: bytes | io.IOBase


class Bundle:
    """Collects what the doctor sees of a camera, and writes it.

    Args:
        keep_serials: Leave serial numbers as they are.

    Attributes:
        capture: Takes the USB traffic.
    """

    def __init__(self, *, keep_serials: bool = False) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the bundle
        self._names: dict[str, str] = {}
        self._keep = keep_serials
        self.capture = CaptureWriter(self._file, self._rename)
        self._events: list[Events] = []
        self._count = 0
        self._since_us = -1
        self._frames: list[Frame] = []
        self._samples: list[InertialSamples] = []
        self._arrivals: list[tuple[int, int]] = []
        self._clock = ClockMap()

    def watch(self, batch: CameraBatch) -> None:
        """Keep the first second of events, the first frames and samples, and all arrivals."""
        decoded = batch.decoded
        if self._since_us < 0:
            self._since_us = decoded.time_us
        self._arrivals.append((decoded.time_us, batch.arrival_ns))
        self._clock.add(decoded.time_us, batch.arrival_ns)
        if decoded.time_us < self._since_us + EVENTS_US and self._count < MOST_EVENTS:
            self._events.append(decoded.events.copy())
            self._count += len(decoded.events)
            self._samples.append(decoded.imu)
        self._frames += decoded.frames[: MOST_FRAMES - len(self._frames)]

    def members(self, report: dict[str, Any], files: HostFiles, device: str) -> list[Member]:
        """Return the files of the bundle.

        Args:
            report: The doctor's findings.
            files: Files of the operating system.
            device: Device string.
        """
        usb = usb_tree(files, self._rename)
        # All serial numbers are known now, also that of a simulated camera.
        for finding in report.get('findings', ()):
            if serial := finding['values'].get('serial'):
                self._rename(str(serial))
        times, arrivals = zip(*self._arrivals, strict=True) if self._arrivals else ((), ())
        frames = {f'frame_{k}': frame.image for k, frame in enumerate(self._frames)}
        exposures = [
            (f.frame_start_us, f.exposure_start_us, f.exposure_end_us, f.frame_end_us)
            for f in self._frames
        ]
        clock = asdict(self._clock.estimate()) if self._clock.ready else None
        events, imu = Events.concatenate(self._events), self._samples
        samples = {
            name: np.concatenate([getattr(each, name) for each in imu] or [np.empty(0)])
            for name in ('t', 'acceleration', 'angular_velocity', 'temperature')
        }
        texts = [
            ('findings.json', 'what mixtac doctor found', _json(report)),
            ('versions.json', 'versions of Python and of the installed packages', _versions()),
            ('computer.txt', 'kernel, processor, memory, limits of USB', _computer(files)),
            ('usb.txt', 'devices on the USB', usb),
            (
                'parameters.yaml',
                'settings of the camera',
                parameter_file('driver', DriverParameters(device=device)),
            ),
            ('clock.json', 'clock of the camera against the host', _json(clock)),
        ]
        members = [Member(n, about, self._private(text).encode()) for n, about, text in texts]
        self._file.seek(0)
        arrays = (
            (
                'clock.npz',
                'camera time [us] and arrival [ns] of each read',
                {
                    'camera_us': np.array(times, np.int64),
                    'arrival_ns': np.array(arrivals, np.int64),
                },
            ),
            (
                'events.npz',
                f'{len(events)} events of about a second',
                {'t': events.t, 'x': events.x, 'y': events.y, 'polarity': events.polarity},
            ),
            (
                'frames.npz',
                f'{len(frames)} frames; their times [us]: start, exposure, end',
                frames | {'times': np.array(exposures).reshape(-1, 4)},
            ),
            ('imu.npz', f'{len(samples["t"])} inertial samples', samples),
        )
        members += [Member(name, about, _npz(content)) for name, about, content in arrays]
        counted = ', '.join(f'{count} {name}' for name, count in self.capture.counts.items())
        members.append(Member(MEMBER, f'all USB traffic: {counted}', self._file))
        return members

    def write(self, path: Path, members: list[Member], console: Console) -> None:
        """List the files of the bundle, ask where somebody can answer, and write it.

        Raises:
            typer.Abort: The answer was no.
            FileError: It cannot be written.
        """
        table = Table(title=escape(f'{path} will hold'), title_justify='left', show_header=False)
        table.add_column(no_wrap=True)
        table.add_column(justify='right', no_wrap=True)
        table.add_column(overflow='fold')
        for name, about, content in members:
            table.add_row(name, f'{_size(content):,}', escape(about))
        console.print(table)
        kept = 'as they are' if self._keep else 'replaced'
        console.print(f'serial numbers, home folder and host name: {kept}', soft_wrap=True)
        if sys.stdin.isatty():
            typer.confirm('Write it?', default=True, abort=True)
        listing = ''.join(f'{name}: {about}\n' for name, about, _ in members)
        with (
            replacing(path) as scratch,
            zipfile.ZipFile(scratch, 'w', zipfile.ZIP_DEFLATED) as archive,
        ):
            archive.writestr('README.txt', f'Written by mixtac doctor --bundle.\n\n{listing}')
            for name, _, content in members:
                if isinstance(content, bytes):
                    archive.writestr(name, content)
                    continue
                with archive.open(name, 'w', force_zip64=True) as member:
                    while block := content.read(1 << 20):
                        member.write(block)

    def _rename(self, serial: str) -> str:
        if self._keep or not serial:
            return serial
        return self._names.setdefault(serial, hashed(serial))

    def _private(self, text: str) -> str:
        if self._keep:
            return text
        for serial, name in self._names.items():
            text = text.replace(serial, name)
        home = Path.home()
        # A user without an account, as in a container, has the root as home.
        if home != Path(home.anchor):
            text = text.replace(str(home), '~')
        return re.sub(rf'\b{re.escape(socket.gethostname())}\b', 'host', text)


def usb_tree(files: HostFiles, rename: Any) -> str:  # noqa: ANN401
    """Return the devices on the USB, one a line, as far as the kernel shows them.

    Args:
        files: Files of the operating system.
        rename: Returns what to write instead of a serial number.
    """
    folder = files.path(DEVICES)
    if not folder.is_dir():
        return f'{DEVICES} is missing: this machine or container has no USB\n'
    lines = []
    for entry in sorted(folder.iterdir()):
        ids = [read_text(entry / name) for name in ('idVendor', 'idProduct')]
        if None in ids:
            continue
        fields = {name: read_text(entry / name) or '' for name in USB_FIELDS}
        fields['serial'] = rename(fields['serial'])
        shown = ', '.join(f'{name} {value}' for name, value in fields.items() if value)
        lines.append(f'{entry.name} {ids[0]}:{ids[1]} {shown}\n')
    return ''.join(lines) or 'no devices\n'


def _computer(files: HostFiles) -> str:
    parts = [f'{platform.system()} {platform.release()} {platform.machine()}']
    parts += [
        f'\n== {name}\n{(files.text(name) or "not readable")[:SHOWN_CHARACTERS]}'
        for name in SYSTEM_FILES
    ]
    return '\n'.join(parts) + '\n'


def _versions() -> str:
    installed = {each.name: each.version for each in distributions() if each.name}
    return _json({'python': sys.version, 'packages': dict(sorted(installed.items()))})


def _json(data: object) -> str:
    return json.dumps(data, indent=2) + '\n'


def _npz(arrays: dict[str, Any]) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def _size(content: bytes | io.IOBase) -> int:
    if isinstance(content, bytes):
        return len(content)
    here = content.tell()
    size = content.seek(0, io.SEEK_END)
    content.seek(here)
    return size
