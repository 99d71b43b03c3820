# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Findings, and those about this computer, from what the kernel reports."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

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
SLOW_GOVERNORS = frozenset({'powersave', 'ondemand', 'conservative'})
OWN_GOVERNOR = frozenset({'intel_pstate', 'amd-pstate-epp'})
"""Drivers whose `powersave` lets the processor run at full speed."""
LEAST_CORES = 2
LEAST_DISK_GB = 10.0
UNSYNCHRONISED = 0x40
"""STA_UNSYNC of adjtimex(2)."""
LONG_BYTES = 8
TIMEX_BYTES = 208
"""Size of `struct timex` on 64-bit systems [bytes]."""
TIMEX_ERROR_AT = 24
"""Offset of `esterror` [bytes]."""
TIMEX_STATUS_AT = 40
"""Offset of `status` [bytes]."""


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
        check_disk(folder),
        check_clock(synchronised, error_s),
    ]
