# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of cameras on the USB, of a running camera, and of this computer.

Checks of the USB need no permission for the camera: they read what the kernel reports (kernel
documentation, ABI/testing/sysfs-bus-usb).
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.clock_map import ClockEstimate
from mixtac_core.events.errors import MixtacError
from mixtac_core.events.readings import Frame
from mixtac_driver.camera import Davis346
from mixtac_driver.davis346.model import Identity, camera_models
from mixtac_driver.davis346.settings import CameraParameters
from mixtac_driver.parameters import DriverParameters

Value = str | int | float | bool | None
ROOT = Path('/')


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


def judge(
    name: str, found: str, values: Mapping[str, Value], *problems: tuple[bool, Level, str]
) -> Finding:
    """Return a finding with the level and remedy of the first problem that applies.

    Args:
        name: What was checked.
        found: What was found.
        values: The figures behind it.
        problems: Whether each applies, its level and its remedy.
    """
    for applies, level, remedy in problems:
        if applies:
            return Finding(name, level, found, remedy, values)
    return Finding(name, Level.OK, found, values=values)


def worst(findings: Iterable[Finding]) -> Level:
    """Return the highest level of all, OK where there are none."""
    return max((finding.level for finding in findings), default=Level.OK)


def first_to_do(findings: Iterable[Finding]) -> Finding | None:
    """Return the first of the worst findings, or None if all are OK.

    Checks are ordered by dependence, so the first is the one to fix.
    """
    first = max(findings, key=lambda finding: finding.level, default=None)
    return first if first is not None and first.level > Level.OK else None


def read_text(path: Path) -> str:
    """Return the text of a file without surrounding blanks, or empty if it cannot be read."""
    try:
        return path.read_text(errors='replace').strip()
    except OSError:
        return ''


LEAST_DISK_GB = 10.0
"""Least free space for a recording [GB]."""


def check_disk(folder: Path) -> Finding:
    """Check the free disk space for a recording in this folder."""
    free_gb = shutil.disk_usage(folder).free / 1e9
    remedy = 'record to another disk: a busy scene writes some GB per minute'
    values = {'free [GB]': round(free_gb, 1)}
    found = f'{free_gb:.0f} GB free in {folder}'
    return judge('disk', found, values, (free_gb < LEAST_DISK_GB, Level.WARN, remedy))


def check_clock() -> Finding:
    """Check that the computer's clock is synchronised, as systemd reports it."""
    command = ['timedatectl', 'show', '--property=NTPSynchronized', '--value']
    answer = ''
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=5)
        answer = run.stdout.strip()
    states = {'yes': 'synchronised', 'no': 'not synchronised: machines cannot be compared'}
    remedy = 'where several machines take part: sudo apt-get install chrony'
    found = states.get(answer, 'unknown (not reported by systemd)')
    return judge('real-time clock', found, {}, (answer == 'no', Level.WARN, remedy))


DEVICES = 'sys/bus/usb/devices'
USB3_MBIT = 5000
USB2_MBIT = 480
NO_CAMERA = (
    'plug the camera in and check that its LED is on; without a camera, use --device virtual'
)
SLOW = 'use a USB 3 port (blue, or marked SS) and a USB 3 cable, without a hub in between'
RULE_FILE = Path(__file__).resolve().parent / 'udev/65-mixtac.rules'
"""The udev rule that comes with this package."""


def cameras_on_bus(root: Path = ROOT) -> dict[str, dict[str, str]]:
    """Return every supported camera on the USB by port, with the kernel's files as text."""
    names = ('idVendor', 'idProduct', 'busnum', 'devnum', 'speed', 'serial')
    ids = {f'{model.vendor:04x}:{model.product:04x}' for model in camera_models()}
    found = {}
    for folder in sorted((root / DEVICES).glob('*')):
        camera = {name: read_text(folder / name) for name in names}
        if f'{camera["idVendor"]}:{camera["idProduct"]}' in ids:
            found[folder.name] = camera
    return found


def check_presence(cameras: Mapping[str, Mapping[str, str]], serial: str, root: Path) -> Finding:
    """Check that the wanted camera is attached."""
    listed = ', '.join(f'{c["serial"] or "no serial number"} at {p}' for p, c in cameras.items())
    models = ', '.join(f'{m.name} (USB {m.vendor:04x}:{m.product:04x})' for m in camera_models())
    wanted = [c for c in cameras.values() if serial in {'', c['serial']}]
    in_container = 'in a container, pass /sys and /dev/bus/usb in; else use --device virtual'
    return judge(
        'camera on the USB',
        listed or f'no {models} is attached',
        {'cameras': len(cameras)},
        (not (root / DEVICES).is_dir(), Level.ERROR, in_container),
        (not cameras, Level.ERROR, NO_CAMERA),
        (len(wanted) != 1, Level.ERROR, 'choose one of them with --serial'),
    )


def check_speed(camera: Mapping[str, str]) -> Finding:
    """Check that the port is fast enough for the camera at full rate."""
    speed = camera['speed']
    mbit = float(speed) if speed.replace('.', '', 1).isdigit() else float('inf')
    return judge(
        'USB speed',
        f'{speed or "unknown"} Mb/s',
        {'speed [Mb/s]': mbit},
        (mbit < USB2_MBIT, Level.ERROR, SLOW),
        (mbit < USB3_MBIT, Level.WARN, f'events of a busy scene will be lost: {SLOW}'),
    )


def check_permission(camera: Mapping[str, str], root: Path = ROOT) -> Finding:
    """Check the permission of the device node."""
    node = f'dev/bus/usb/{int(camera["busnum"]):03d}/{int(camera["devnum"]):03d}'
    there, usable = (root / node).exists(), os.access(root / node, os.R_OK | os.W_OK)
    state = 'may be opened' if usable else 'may not be opened' if there else 'is missing'
    in_container = 'in a container, pass it in: docker run --device=/dev/bus/usb'
    rule = (
        f'sudo cp {RULE_FILE} /etc/udev/rules.d/ && sudo udevadm control --reload && '
        'sudo udevadm trigger --subsystem-match=usb, then reconnect the camera; over ssh, join the '
        'group plugdev as well: sudo usermod -aG plugdev "$USER", then log in again'
    )
    problems = (not there, Level.ERROR, in_container), (not usable, Level.ERROR, rule)
    return judge('permission', f'/{node} {state}', {}, *problems)


def check_attached(serial: str = '', root: Path = ROOT) -> list[Finding]:
    """Return the findings about the cameras on the USB.

    Args:
        serial: Serial number of the wanted camera; empty for the only one.
        root: Root of the file system.
    """
    cameras = cameras_on_bus(root)
    findings = [check_presence(cameras, serial, root)]
    for camera in cameras.values():
        if serial in {'', camera['serial']}:
            findings += [check_speed(camera), check_permission(camera, root)]
    return findings


LATEST_FRAMES = 5
"""Frames that are kept for the focus and the zero."""


@dataclass(slots=True)
class Measurement:
    """Counts of the data of a camera.

    Attributes:
        seconds: Duration after the first data, by the camera's clock [s].
        elapsed_s: The same by the host's clock, when the last data were decoded [s].
        events: Number of events.
        frames: Number of frames.
        samples: Number of inertial samples.
        size: Bytes over USB.
        losses: Data lost or damaged, by kind, as on `/diagnostics`.
        stalls: Stalls of the data endpoint.
        clock: The map from the camera's clock to the host's, or None without data.
        clock_resets: Resets of the camera's clock that the driver did not request.
        latest: Latest frames.
        counts: Events per pixel, `int64` [rows, columns].
    """

    seconds: float = 0.0
    elapsed_s: float = 0.0
    events: int = 0
    frames: int = 0
    samples: int = 0
    size: int = 0
    losses: Mapping[str, int] = field(default_factory=dict)
    stalls: int = 0
    clock: ClockEstimate | None = None
    clock_resets: int = 0
    latest: deque[Frame] = field(default_factory=lambda: deque(maxlen=LATEST_FRAMES))
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))

    def rate(self, count: int) -> float:
        """Return a count per second of the camera's clock."""
        return count / self.seconds if self.seconds else 0.0


MOST_WORDS = 64 << 20
"""Largest raw data that are kept [bytes]."""


@dataclass
class RawData:
    """Data that a camera sent during the measurement.

    Attributes:
        words: Its bytes, as the decoder reads them; the first `MOST_WORDS`.
        registers: Value by `module:parameter`.
    """

    words: io.BytesIO = field(default_factory=io.BytesIO)
    registers: dict[str, int] = field(default_factory=dict)

    def add(self, data: bytes) -> None:
        """Append the data of a transfer."""
        if self.words.tell() < MOST_WORDS:
            self.words.write(data)


def measure(camera: Davis346, seconds: float) -> Measurement:
    """Start an open camera, count its data, and stop it.

    Args:
        camera: An open camera.
        seconds: Duration, from the first data on [s].

    Raises:
        UsbError: A request failed or the camera went away.
        StreamError: No data came, or the stream died.
    """
    camera.start()
    width, height = camera.identity.geometry.event_size
    result = Measurement(counts=np.zeros((height, width), np.int64))
    began_s, began_us, size_before = 0.0, 0, 0
    for batch in camera.batches():
        if not began_s:
            # The first call of the decoder may have compiled it while data waited.
            began_s, began_us = time.monotonic(), batch.time_us
            size_before = camera.transport_counters.size
            continue
        decoded = batch.decoded
        result.events += len(decoded.events)
        np.add.at(result.counts, (decoded.events.y, decoded.events.x), 1)
        result.frames += len(decoded.frames)
        result.latest.extend(decoded.frames)
        result.samples += len(decoded.imu.t)
        result.elapsed_s = time.monotonic() - began_s
        result.seconds = (batch.time_us - began_us) / 1e6
        if result.elapsed_s >= seconds:
            break
    result.size = camera.transport_counters.size - size_before
    result.stalls = camera.transport_counters.stalls
    result.losses = camera.status().losses
    result.clock = camera.clock.estimate() if camera.clock.ready else None
    result.clock_resets = camera.clock_resets
    camera.stop()
    return result


RATE_TOLERANCE = 0.9
MOST_SKEW_PPM = 100.0
MOST_RESIDUAL_US = 1000.0
SKEW_AFTER_S = 10.0
"""Shortest measurement that gives the skew of the clock [s]."""
MOST_BEHIND_S = 0.2
CABLE = 'try another cable and port; if it persists, unplug and reconnect the camera'
BUSY = 'close busy programs: the computer reads the camera too late'
HOT_HZ = 10.0
"""Event rate of a hot pixel in a still scene [1/s]."""
MOST_NOISE_HZ = 1.0
"""Largest median event rate of a pixel in a still scene [1/s]."""
LEAST_SHARPNESS = 0.12
"""Least ratio of the mean square difference of neighbours to that of pixels four apart."""


def check_running(
    p: DriverParameters,
    seconds: float,
    raw: RawData | None = None,
    backend: Any = None,  # noqa: ANN401
) -> Iterator[Finding]:
    """Open a camera, count its data, and yield findings one by one.

    Args:
        p: Device, serial number and settings.
        seconds: Duration of the count [s].
        raw: Receives the data of the camera.
        backend: A pyusb backend to use instead of the one that the device string names.
    """
    on_transfer = None if raw is None else raw.add
    camera, name = Davis346(p, backend=backend, on_transfer=on_transfer), 'opening the camera'
    try:
        camera.open()
        yield check_identity(camera.identity)
        name = 'data stream'
        if raw is not None:
            raw.registers = camera.control.registers()
        yield from check_measurement(measure(camera, seconds), p, camera.identity)
    except MixtacError as error:
        yield Finding(name, Level.ERROR, error.message, error.remedy or CABLE)
    finally:
        camera.close()


def check_identity(identity: Identity) -> Finding:
    """Report what the camera is."""
    firmware, logic = ('.'.join(map(str, v)) for v in (identity.firmware, identity.logic))
    found = f'{identity.chip}, {identity.serial or "no serial number"}, firmware {firmware}, '
    found += f'logic {logic}, {"own" if identity.is_master else "external"} clock'
    values: dict[str, Value] = {
        'serial': identity.serial,
        'chip': identity.chip,
        'firmware': firmware,
        'logic': logic,
        'color_filter': identity.color_filter,
        'imu_type': identity.imu_type,
        'master': identity.is_master,
    }
    return Finding('identity', Level.OK, found, values=values)


def check_measurement(r: Measurement, p: CameraParameters, identity: Identity) -> list[Finding]:
    """Compare a measurement with the settings."""
    rate, uncovered = r.rate(r.events), 'take the lens cap off and move something in view'
    values, problem = {'events [1/s]': round(rate, 1)}, (not r.events, Level.WARN, uncovered)
    findings = [judge('events', f'{rate:,.0f} /s', values, problem)]
    if identity.model.has_frames:
        wanted = 1e6 / max(p.aps_frame_interval, p.aps_exposure, 1)
        findings.append(_check_rate('frames', r, r.frames, wanted))
    if identity.imu_type:
        wanted = 1000 / (1 + p.imu_sample_rate_divider)
        findings.append(_check_rate('inertial samples', r, r.samples, wanted))
    return [*findings, _check_losses(r), _check_camera_clock(r), _check_noise(r), _check_focus(r)]


def _check_rate(name: str, r: Measurement, count: int, wanted: float) -> Finding:
    rate = r.rate(count)
    return judge(
        name,
        f'{rate:.1f} /s, {wanted:.0f} /s expected',
        {f'{name} [1/s]': round(rate, 1), 'wanted [1/s]': round(wanted, 1)},
        (not count, Level.ERROR, 'unplug and reconnect the camera'),
        # One more or less depends on the start of the count.
        (count + 1 < RATE_TOLERANCE * wanted * r.seconds, Level.WARN, CABLE),
    )


def _check_losses(r: Measurement) -> Finding:
    counts, behind_s = {**r.losses, 'usb stalls': r.stalls}, r.elapsed_s - r.seconds
    busy = behind_s > MOST_BEHIND_S
    listed = [f'{count} {name}' for name, count in counts.items() if count]
    listed += [f'decoding is {behind_s:.1f} s behind'] if busy else []
    rate = r.size / max(r.elapsed_s, 1e-9) / 1e6
    return judge(
        'losses',
        ', '.join(listed) or 'none',
        {**counts, 'usb [MB/s]': round(rate, 3), 'behind [s]': round(behind_s, 3)},
        (busy or bool(counts.get('usb transfers dropped')), Level.WARN, BUSY),
        (bool(listed), Level.WARN, CABLE),
    )


def _check_camera_clock(r: Measurement) -> Finding:
    name, clock = 'camera clock', r.clock
    if clock is None:
        return Finding(name, Level.WARN, 'no data to compare with', CABLE)
    known = clock.span_s >= SKEW_AFTER_S
    skew = f'skew {clock.skew_ppm:+.1f} ppm' if known else 'skew unknown: use --seconds 12'
    return judge(
        name,
        f'{skew}; residual {clock.residual_us:.0f} us; {r.clock_resets} unexpected resets',
        {
            'skew [ppm]': round(clock.skew_ppm, 2) if known else None,
            'residual [us]': round(clock.residual_us, 1),
            'resets': r.clock_resets,
        },
        (r.clock_resets > 0, Level.WARN, 'check the synchronisation cable'),
        (abs(clock.skew_ppm) > MOST_SKEW_PPM, Level.WARN, 'synchronise the clock of the computer'),
        (clock.residual_us > MOST_RESIDUAL_US, Level.WARN, BUSY),
    )


def _check_noise(r: Measurement) -> Finding:
    """Check the event rate of the median pixel: noise, as long as most of the scene is still."""
    rates = r.counts / max(r.seconds, 1e-9)
    middle = float(np.median(rates)) if rates.size else 0.0
    hot = int((rates > HOT_HZ).sum())
    return judge(
        'noise',
        f'{middle:.2f} /s per pixel (median), {hot} pixels above {HOT_HZ:g} /s',
        {'median [1/s]': round(middle, 3), 'hot pixels': hot},
        (
            middle > MOST_NOISE_HZ,
            Level.WARN,
            'keep the scene still; use a lamp on direct current, or raise the thresholds',
        ),
    )


def _check_focus(r: Measurement) -> Finding:
    """Compare the detail at one pixel with the detail at four pixels in the latest frames."""
    shape = r.latest[-1].image.shape if r.latest else ()
    stack = np.array([f.image for f in r.latest if f.image.shape == shape], np.float64)
    if len(stack) < LATEST_FRAMES:
        return ok('focus', 'too few frames to measure')
    picture = stack.mean(axis=0)
    noise = 2.0 * float(stack.var(axis=0, ddof=1).mean()) / len(stack)
    near, far = (
        float((np.diff(picture[::step, ::step], axis=1) ** 2).mean()) - noise for step in (1, 4)
    )
    if far <= noise:
        return ok('focus', 'no contrast in view')
    sharpness = max(near, 0.0) / far
    remedy = 'turn the focus ring until the markers are sharp'
    values = {'sharpness': round(sharpness, 3)}
    found = f'sharpness {sharpness:.2f}'
    return judge('focus', found, values, (sharpness < LEAST_SHARPNESS, Level.WARN, remedy))
