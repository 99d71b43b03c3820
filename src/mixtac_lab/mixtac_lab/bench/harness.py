# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What benchmarks of running nodes share: child processes and the figures of received packets.

`JsonProcess` runs a program that writes one JSON object per line; `Arrivals` counts lost events
and measures their age at a subscriber.
"""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from mixtac_node.process import GraphError, ending_with_parent
from mixtac_sim.usb.pattern import MARKER, MARKER_US

if TYPE_CHECKING:
    from types import TracebackType

    from mixtac_events.arrays import Events


STOP_TIMEOUT_S = 10.0
POLL_S = 0.1


class JsonProcess:
    """Starts a process; ends it by its pid, or with its parent.

    Args:
        name: What it is, for messages.
        command: Command line.
        env: Environment.
    """

    def __init__(self, name: str, command: list[str], env: dict[str, str]) -> None:
        self._name = name
        self._process = subprocess.Popen(
            ending_with_parent(command),
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._lines: queue.Queue[dict[str, Any]] = queue.Queue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def __enter__(self) -> JsonProcess:
        """Return the process."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it if it still runs."""
        self.stop()

    def send(self, **values: object) -> None:
        """Send one line."""
        assert self._process.stdin is not None  # noqa: S101  (always piped)
        self._process.stdin.write(json.dumps(values) + '\n')
        self._process.stdin.flush()

    def expect(self, key: str, timeout_s: float) -> dict[str, Any]:
        """Return the next line that has a key.

        Raises:
            GraphError: None came in time.
        """
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            ended = not self._thread.is_alive()
            with contextlib.suppress(queue.Empty):
                line = self._lines.get(timeout=POLL_S)
                if key in line:
                    return line
                continue
            if ended:
                break
        code = self._process.poll()
        state = 'still runs' if code is None else f'ended with status {code}'
        raise GraphError(f'{self._name} said nothing of {key!r} within {timeout_s:g} s; it {state}')

    def latest(self, key: str, line: dict[str, Any]) -> dict[str, Any]:
        """Return the newest line with a key among those said so far, or the one given."""
        with contextlib.suppress(queue.Empty):
            while True:
                said = self._lines.get_nowait()
                line = said if key in said else line
        return line

    def cpu_s(self) -> float:
        """Return the CPU time it used so far [s]."""
        times = psutil.Process(self._process.pid).cpu_times()
        return float(times.user + times.system)

    def stop(self) -> None:
        """End it: SIGTERM, then SIGKILL after a grace time. What it said can still be read."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._thread.join(1.0)

    def _read(self) -> None:
        assert self._process.stdout is not None  # noqa: S101  (always piped)
        for line in self._process.stdout:
            with contextlib.suppress(ValueError):
                self._lines.put(json.loads(line))


BIN_US = 5
BINS = 200_000
"""Ages up to one second."""


class Arrivals:
    """Takes packets in order of arrival.

    The times of the packets are the camera's count plus the host time at which the driver believes
    that the count was zero. The error of that belief is seen at the markers and taken out again, so
    that ages are true ones.

    Args:
        origin_ns: True host time [ns since the Unix epoch] at which the camera's clock read zero.
        period_us: Length of the pattern [us].
        events: Events per period.
    """

    def __init__(self, origin_ns: int, period_us: int, events: int) -> None:
        self._origin_us = origin_ns // 1000
        self._period_us, self._expected = period_us, events
        self._histogram = np.zeros(BINS, np.int64)
        self._error_us: int | None = None
        self._next_seq: int | None = None
        self._packets = self._packets_lost = 0
        self._since_marker: int | None = None
        self._periods = self._events = self._marker_us = 0
        self._last_us = 0
        self._backwards = 0

    def add(self, seq: int, events: Events, arrival_ns: int) -> None:
        """Take a packet.

        Args:
            seq: Its number.
            events: Its events.
            arrival_ns: Host time of arrival [ns since the Unix epoch].
        """
        self._packets += 1
        if self._next_seq is not None:
            self._packets_lost += seq - self._next_seq
        self._next_seq = seq + 1
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
            'packets': self._packets,
            'packets_lost': self._packets_lost,
            'events': self._events,
            'events_lost': self._periods * self._expected - self._events,
            'periods': self._periods,
            'backwards': self._backwards,
            'origin_error_us': float(self._error_us or 0),
        }
