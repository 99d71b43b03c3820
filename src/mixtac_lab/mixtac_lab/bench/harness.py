# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shared parts of benchmarks: child processes, ages of received packets, quantiles, reports.

`BenchRun` starts a camera, nodes and subscribers as processes and measures their CPU time.
`Arrivals` counts lost events and measures the age of events at a subscriber.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from mixtac_events.arrays import Events
from mixtac_events.sequence import SequenceCounter
from mixtac_lab.bench.pattern import MARKER, MARKER_US
from mixtac_node.graph import NodeSpec
from mixtac_node.process import JsonProcess

START_TIMEOUT_S = 300.0
"""Time to wait for a process to start [s]; on a loaded machine a start takes long."""


class BenchRun(contextlib.ExitStack):
    """The processes of a benchmark, in a `with` block that ends them, the last one first.

    Attributes:
        folder: Temporary folder for sockets.
        processes: Processes by name, in the order of their start.
        environment: Their environment.
    """

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(self.enter_context(tempfile.TemporaryDirectory(prefix='mixtac-')))
        self.processes: dict[str, JsonProcess] = {}
        self.environment = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}

    def start(self, name: str, command: list[str]) -> JsonProcess:
        """Start a process under a name."""
        process = self.enter_context(JsonProcess(name, command, self.environment))
        self.processes[name] = process
        return process

    def start_node(self, name: str, node: NodeSpec, namespace: str) -> JsonProcess:
        """Start a node under a name."""
        return self.start(name, node.command(namespace, log_level='warn'))

    def start_program(self, name: str, module: str, *arguments: str) -> JsonProcess:
        """Start a module of `mixtac_lab.bench.programs` under a name."""
        module = f'mixtac_lab.bench.programs.{module}'
        return self.start(name, [sys.executable, '-m', module, *arguments])

    def start_camera(self, kind: str, **options: object) -> tuple[str, dict[str, Any]]:
        """Start a virtual camera in a process named `camera`, see `programs.camera`.

        Returns:
            Its device name for the driver, and its description of what it sends.
        """
        socket = self.folder / 'usb.sock'
        flags = [f'--{name.replace("_", "-")}={value}' for name, value in options.items()]
        camera = self.start_program('camera', 'camera', kind, f'--socket={socket}', *flags)
        return f'virtual:{socket}', camera.expect('ready', START_TIMEOUT_S)

    def measure(
        self, seconds: float, progress: Callable[[float], None] = lambda _seconds: None
    ) -> tuple[float, dict[str, float]]:
        """Wait while the processes run.

        Args:
            seconds: Length of the measurement [s].
            progress: Called repeatedly with the elapsed seconds.

        Returns:
            Its real length [s], and the CPU time of each process over it.
        """
        before = {name: cpu_s(process) for name, process in self.processes.items()}
        started_s = time.monotonic()
        while (elapsed_s := time.monotonic() - started_s) < seconds:
            time.sleep(min(0.5, seconds - elapsed_s))
            progress(time.monotonic() - started_s)
        elapsed_s = time.monotonic() - started_s
        used = {name: (cpu_s(self.processes[name]) - start) for name, start in before.items()}
        return elapsed_s, {name: each / elapsed_s for name, each in used.items()}


def cpu_s(process: JsonProcess) -> float:
    """Return the CPU time that a running process has used [s]."""
    times = psutil.Process(process.pid).cpu_times()
    return float(times.user + times.system)


def send(**values: object) -> None:
    """Write one JSON object to standard output, for the `JsonProcess` of the parent."""
    print(json.dumps(values), flush=True)


def stop_event() -> threading.Event:
    """Return an event that is set by SIGTERM and SIGINT."""
    event = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: event.set())
    return event


def quantiles(values: Iterable[float], levels: tuple[float, ...] = (0.5, 0.99)) -> dict[str, float]:
    """Return quantiles of values by names such as `p50`; `max` is the level 1."""
    names = ['max' if level == 1.0 else f'p{1e3 * level:g}'.removesuffix('0') for level in levels]
    found = np.quantile(list(values), levels).tolist()
    return dict(zip(names, found, strict=True))


BIN_US = 5
BINS = 200_000
"""Ages up to one second."""


class Arrivals:
    """Statistics of packets of a pattern, in order of arrival.

    The time of an event is the camera's count plus the driver's estimate of the host time at which
    that count was zero. The markers show the error of the estimate, which is removed, so the ages
    are true.

    Args:
        origin_ns: True host time at which the camera's clock was zero [ns since the Unix epoch].
        period_us: Length of the pattern [us].
        events: Events per period.
    """

    def __init__(self, origin_ns: int, period_us: int, events: int) -> None:
        self._origin_us = origin_ns // 1000
        self._period_us, self._expected = period_us, events
        self._histogram = np.zeros(BINS, np.int64)
        self._error_us: int | None = None
        self._packets = SequenceCounter()
        self._since_marker: int | None = None
        self._periods = self._events = self._marker_us = 0
        self._last_us = 0
        self._backwards = 0

    @property
    def packets(self) -> int:
        """Number of packets received so far."""
        return self._packets.received

    def add(self, seq: int, events: Events, arrival_ns: int) -> None:
        """Take a packet.

        Args:
            seq: Its number.
            events: Its events.
            arrival_ns: Host time of arrival [ns since the Unix epoch].
        """
        self._packets.update(seq)
        if not len(events):
            return
        self._backwards += int(events.t[0]) < self._last_us
        self._last_us = int(events.t[-1])
        self._count(events)
        if self._error_us is not None and self._periods:
            ages = arrival_ns // 1000 - (events.t - self._error_us)
            np.add.at(self._histogram, np.clip(ages // BIN_US, 0, BINS - 1), 1)

    def _count(self, events: Events) -> None:
        markers = np.flatnonzero((events.x == MARKER[0]) & (events.y == MARKER[1]))
        done = 0
        for at in markers.tolist():
            if self._since_marker is not None:
                got = self._since_marker + at - done
                elapsed = int(events.t[at]) - self._marker_us
                self._periods += round(elapsed / self._period_us)
                self._events += got
            self._since_marker, done = 0, at
            self._marker_us = int(events.t[at])
            phase = self._marker_us - MARKER_US - self._origin_us
            half = self._period_us // 2
            self._error_us = (phase + half) % self._period_us - half
        if self._since_marker is not None:
            self._since_marker += len(events) - done

    def summary(self) -> dict[str, float]:
        """Return the figures: ages [ms], counts, and the error of the clock's origin [us]."""
        total = int(self._histogram.sum())
        cumulated = np.cumsum(self._histogram)

        def age_ms(quantile: float) -> float:
            at = np.searchsorted(cumulated, quantile * total)
            return float((int(at) + 0.5) * BIN_US / 1000) if total else float('nan')

        return {
            'age_p50_ms': age_ms(0.5),
            'age_p99_ms': age_ms(0.99),
            'age_p999_ms': age_ms(0.999),
            'age_max_ms': age_ms(1.0),
            'packets': self._packets.received,
            'packets_lost': self._packets.lost,
            'events': self._events,
            'events_lost': self._periods * self._expected - self._events,
            'periods': self._periods,
            'backwards': self._backwards,
            'origin_error_us': float(self._error_us or 0),
        }
