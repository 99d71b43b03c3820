# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of cameras on the USB, of a running camera, and of this computer.

Checks of the USB need no permission for the camera: they read what the kernel reports (kernel
documentation, ABI/testing/sysfs-bus-usb).
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import time
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
from mixtac_driver.davis346.control import dropped
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
"""Frames that are kept for the focus."""


@dataclass(slots=True)
class Measurement:
    """Counts of the data of a camera.

    Attributes:
        seconds: Duration after the first data, by the camera's clock [s].
        events: Number of events.
        frames: Number of frames.
        samples: Number of inertial samples.
        losses: Data lost or damaged, by kind, as on `/diagnostics`.
        dropped: Events and edges that the camera dropped because they were read too late.
        clock: The map from the camera's clock to the host's, or None without data.
        clock_resets: Resets of the camera's clock that the driver did not request.
        latest: Latest frames.
        counts: Events per pixel, `int64` [rows, columns].
    """

    seconds: float = 0.0
    events: int = 0
    frames: int = 0
    samples: int = 0
    losses: Mapping[str, int] = field(default_factory=dict)
    dropped: int = 0
    clock: ClockEstimate | None = None
    clock_resets: int = 0
    latest: list[Frame] = field(default_factory=list)
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))


MOST_WORDS = 64 << 20
"""Largest raw data that are kept [bytes]."""


@dataclass
class RawData:
    """Data that a camera sent during the measurement.

    Attributes:
        words: Its bytes, as the decoder reads them; the first `MOST_WORDS`.
        registers: Value by `module:parameter`.
    """

    words: bytearray = field(default_factory=bytearray)
    registers: dict[str, int] = field(default_factory=dict)

    def add(self, data: bytes) -> None:
        """Append the data of a transfer."""
        if len(self.words) < MOST_WORDS:
            self.words += data


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
    m = Measurement(counts=np.zeros((height, width), np.int64))
    began_s, began_us, dropped_before = 0.0, 0, 0
    for batch in camera.batches():
        if not began_s:
            # The first call of the decoder may have compiled it while data waited.
            began_s, began_us = time.monotonic(), batch.time_us
            dropped_before = dropped(camera.control.statistics())
            continue
        decoded = batch.decoded
        m.events += len(decoded.events)
        np.add.at(m.counts, (decoded.events.y, decoded.events.x), 1)
        m.frames += len(decoded.frames)
        m.latest = [*m.latest, *decoded.frames][-LATEST_FRAMES:]
        m.samples += len(decoded.imu.t)
        m.seconds = (batch.time_us - began_us) / 1e6
        if time.monotonic() >= began_s + seconds:
            break
    m.dropped = dropped(camera.control.statistics()) - dropped_before
    m.losses = {**camera.status().losses, 'usb stalls': camera.transport_counters.stalls}
    m.clock = camera.clock.estimate() if camera.clock.ready else None
    m.clock_resets = camera.clock_resets
    camera.stop()
    return m


RATE_TOLERANCE = 0.9
"""Least rate of frames and samples, as a share of the rate that the settings ask for."""
MOST_SKEW_PPM = 100.0
"""Largest plausible difference in rate of the clocks of camera and computer."""
SKEW_AFTER_S = 10.0
"""Shortest measurement that gives the skew of the clock [s]."""
CABLE = 'try another cable and port; if it persists, unplug and reconnect the camera'
BUSY = 'use a USB 3 port and close busy programs: the computer reads the camera too late'
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
    values = {'serial': identity.serial, 'chip': identity.chip, 'firmware': firmware}
    return ok('identity', found, **values, logic=logic, master=identity.is_master)


def check_measurement(m: Measurement, p: CameraParameters, identity: Identity) -> list[Finding]:
    """Compare a measurement with the settings."""
    rate, uncovered = m.events / max(m.seconds, 1e-9), 'take the lens cap off and move something'
    values, problem = {'events [1/s]': round(rate, 1)}, (not m.events, Level.WARN, uncovered)
    findings = [judge('events', f'{rate:,.0f} /s', values, problem)]
    if identity.model.has_frames:
        wanted = 1e6 / max(p.aps_frame_interval, p.aps_exposure, 1)
        findings.append(_check_rate('frames', m.frames, m.seconds, wanted))
    if identity.imu_type:
        wanted = 1000 / (1 + p.imu_sample_rate_divider)
        findings.append(_check_rate('inertial samples', m.samples, m.seconds, wanted))
    return [*findings, _check_losses(m), _check_camera_clock(m), _check_noise(m), _check_focus(m)]


def _check_rate(name: str, count: int, seconds: float, wanted: float) -> Finding:
    rate = count / max(seconds, 1e-9)
    return judge(
        name,
        f'{rate:.1f} /s, {wanted:.0f} /s expected',
        {f'{name} [1/s]': round(rate, 1), 'wanted [1/s]': round(wanted, 1)},
        (not count, Level.ERROR, 'unplug and reconnect the camera'),
        # One more or less depends on the start of the count.
        (count + 1 < RATE_TOLERANCE * wanted * seconds, Level.WARN, CABLE),
    )


def _check_losses(m: Measurement) -> Finding:
    counts = {**m.losses, 'dropped by the camera': m.dropped}
    listed = [f'{count} {name}' for name, count in counts.items() if count]
    problems = (m.dropped > 0, Level.WARN, BUSY), (bool(listed), Level.WARN, CABLE)
    return judge('losses', ', '.join(listed) or 'none', counts, *problems)


def _check_camera_clock(m: Measurement) -> Finding:
    name, clock = 'camera clock', m.clock
    if clock is None:
        return Finding(name, Level.WARN, 'no data to compare with', CABLE)
    known = clock.span_s >= SKEW_AFTER_S
    skew = f'skew {clock.skew_ppm:+.1f} ppm' if known else 'skew unknown: use --seconds 12'
    return judge(
        name,
        f'{skew}; {m.clock_resets} unexpected resets',
        {'skew [ppm]': round(clock.skew_ppm, 2) if known else None, 'resets': m.clock_resets},
        (m.clock_resets > 0, Level.WARN, 'check the synchronisation cable'),
        (abs(clock.skew_ppm) > MOST_SKEW_PPM, Level.WARN, 'synchronise the clock of the computer'),
    )


def _check_noise(m: Measurement) -> Finding:
    """Check the event rate of the median pixel: noise, as long as most of the scene is still."""
    rates = m.counts / max(m.seconds, 1e-9)
    middle = float(np.median(rates)) if rates.size else 0.0
    hot = int((rates > HOT_HZ).sum())
    found = f'{middle:.2f} /s per pixel (median), {hot} pixels above {HOT_HZ:g} /s'
    values = {'median [1/s]': round(middle, 3), 'hot pixels': hot}
    remedy = 'keep the scene still; use a lamp on direct current, or raise the thresholds'
    return judge('noise', found, values, (middle > MOST_NOISE_HZ, Level.WARN, remedy))


def _check_focus(m: Measurement) -> Finding:
    """Compare the detail at one pixel with the detail at four pixels in the latest frames."""
    if len(m.latest) < LATEST_FRAMES:
        return ok('focus', 'too few frames to measure')
    stack = np.array([frame.image for frame in m.latest], np.float64)
    picture = stack.mean(axis=0)
    noise = 2.0 * float(stack.var(axis=0, ddof=1).mean()) / len(stack)
    near, far = (
        float((np.diff(picture[::step, ::step], axis=1) ** 2).mean()) - noise for step in (1, 4)
    )
    if far <= noise:
        return ok('focus', 'no contrast in view')
    sharpness = max(near, 0.0) / far
    remedy = 'turn the focus ring until the markers are sharp'
    problem = (sharpness < LEAST_SHARPNESS, Level.WARN, remedy)
    return judge('focus', f'{sharpness:.2f}', {'sharpness': round(sharpness, 3)}, problem)
