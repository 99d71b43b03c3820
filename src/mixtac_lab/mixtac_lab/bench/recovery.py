# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random faults on a running driver: how often and how fast it recovers, and what it leaks.

Camera object and supervisor are those of the driver node; the camera is virtual, behind a socket.
"""

from __future__ import annotations

import gc
import math
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from random import Random
from typing import Annotated, Any

import numpy as np
import psutil
import typer
from rich.console import Console

from mixtac_cli.figures import make_table, progress_bar
from mixtac_cli.options import JsonFile
from mixtac_driver.camera import CameraBatch, Davis346
from mixtac_driver.davis346.writes import register_writes
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.supervisor import State, Supervisor
from mixtac_events.arrays import Events
from mixtac_lab.bench.harness import quantiles
from mixtac_node.files import write_json
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.faults import Fault, FaultKind
from mixtac_sim.usb.server import UsbServer
from mixtac_sim.usb.words import ImuReading

Outage = Callable[[VirtualDavis346, Random], float]


SHORTEST_S, LONGEST_S = 0.05, 1.0
_SEEDS = 1 << 32


def _lasting(kind: FaultKind) -> Outage:
    """Return a fault of the running camera that lasts for a random time."""

    def outage(device: VirtualDavis346, rng: Random) -> float:
        seconds = rng.uniform(SHORTEST_S, LONGEST_S)
        device.inject(Fault(kind, seconds=seconds, seed=rng.randrange(_SEEDS)))
        return time.monotonic() + seconds

    return outage


def _at_once(kind: FaultKind, largest: int) -> Outage:
    """Return a fault of the running camera that ends at once."""

    def outage(device: VirtualDavis346, rng: Random) -> float:
        size, seed = rng.randint(1, largest), rng.randrange(_SEEDS)
        device.inject(Fault(kind, count=1, size=size, seed=seed))
        return time.monotonic()

    return outage


def _after_plugging(kind: FaultKind) -> Outage:
    """Return a fault that follows unplugging and plugging in, and lasts for a random time."""

    def outage(device: VirtualDavis346, rng: Random) -> float:
        device.unplug()
        time.sleep(rng.uniform(SHORTEST_S, LONGEST_S))
        device.plug_in()
        seconds, delay = rng.uniform(SHORTEST_S, LONGEST_S), rng.uniform(0.01, 0.1)
        device.inject(Fault(kind, seconds=seconds, delay=delay, seed=rng.randrange(_SEEDS)))
        return time.monotonic() + seconds

    return outage


def _replaced(device: VirtualDavis346, rng: Random) -> float:
    seconds = rng.uniform(SHORTEST_S, LONGEST_S)
    serial = f'V{rng.randrange(10**7):07d}'
    device.inject(Fault(FaultKind.UNPLUG, seconds=seconds, serial=serial))
    return time.monotonic() + seconds


def _held_by_another(device: VirtualDavis346, rng: Random) -> float:
    device.unplug()
    time.sleep(rng.uniform(SHORTEST_S, LONGEST_S))
    device.plug_in()
    device.claim('another program')
    time.sleep(rng.uniform(SHORTEST_S, LONGEST_S))
    device.release('another program')
    return time.monotonic()


OUTAGES: dict[str, Outage] = {
    'unplugged': _lasting(FaultKind.UNPLUG),
    'replaced by another': _replaced,
    'held by another program': _held_by_another,
    'data endpoint stalls once': _at_once(FaultKind.STALL_DATA, 1),
    'data endpoint stalls for long': _lasting(FaultKind.STALL_DATA),
    'requests stall': _after_plugging(FaultKind.STALL_CONTROL),
    'requests time out': _after_plugging(FaultKind.TIMEOUT_CONTROL),
    'requests answered late': _after_plugging(FaultKind.DELAY_CONTROL),
    'registers read as garbage': _after_plugging(FaultKind.GARBAGE_REGISTERS),
    'short and odd reads': _lasting(FaultKind.SHORT_READS),
    'bytes lost': _at_once(FaultKind.DROP_BYTES, 1 << 16),
    'garbage in the data': _at_once(FaultKind.GARBAGE_WORDS, 1 << 13),
    'silent for a while': _lasting(FaultKind.FREEZE),
    'silent until restarted': _at_once(FaultKind.FREEZE, 1),
    'reads hang': _lasting(FaultKind.HANG_READS),
    'babble': _at_once(FaultKind.BABBLE, 1),
    'bus error': _at_once(FaultKind.READ_ERROR, 1),
    'clock reset by the cable': _at_once(FaultKind.CLOCK_RESET, 1),
}
"""Faults by name: functions that disturb a camera and return the time at which it works again [s,
monotonic clock]; they may block until then.

A camera that is silent until restarted counts as working: detecting that is part of the recovery.
"""
SERIAL = 'V0000346'
PERIOD_S = 0.002
EVENTS_PER_S = 50_000
READING_INTERVAL_US = 1000


class RecoveryScene:
    """Feeds the camera from a thread: 50,000 events and 1,000 inertial samples per second.

    Args:
        path: Socket to listen on.
        seed: Seed of the events.

    Attributes:
        device: The camera.
    """

    def __init__(self, path: str, seed: int) -> None:
        self._began_ns = time.monotonic_ns()
        self.device = VirtualDavis346(SERIAL, clock=self._now_us)
        self._server = UsbServer(self.device, path)
        self._rng = np.random.default_rng(seed)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='scene', daemon=True)

    def __enter__(self) -> RecoveryScene:
        """Start the clock."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the clock and remove the camera."""
        self._stopping.set()
        self._thread.join()
        self._server.close()

    def _now_us(self) -> int:
        return (time.monotonic_ns() - self._began_ns) // 1000

    def _run(self) -> None:
        done_us = 0
        while not self._stopping.wait(PERIOD_S):
            until_us = self._now_us()
            readings = self._readings(done_us, until_us)
            self.device.submit(self._events(done_us, until_us), readings=readings)
            self.device.advance(until_us)
            done_us = until_us

    def _events(self, start_us: int, end_us: int) -> Events:
        rng, count = self._rng, (end_us - start_us) * EVENTS_PER_S // 1_000_000
        return Events(
            np.sort(rng.integers(start_us, end_us, count)),
            rng.integers(0, WIDTH, count, np.uint16),
            rng.integers(0, HEIGHT, count, np.uint16),
            rng.random(count) < 0.5,
        )

    def _readings(self, start_us: int, end_us: int) -> list[ImuReading]:
        first_us = -(-start_us // READING_INTERVAL_US) * READING_INTERVAL_US
        times = range(first_us, end_us, READING_INTERVAL_US)
        return [ImuReading(t, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 30.0) for t in times]


SILENCE_S = 0.5
STEADY_S = 0.7
"""Time without failure or gap after which a stream has recovered [s]; longer than SILENCE_S."""
GAP_S = 0.2
"""Pause between data that ends a stream [s]; the camera sends its time every 33 ms."""
LONGEST_RECOVERY_S = 20.0
LONGEST_ENDING_S = 10.0


@dataclass(frozen=True, slots=True)
class Recovery:
    """Recovery from one fault.

    Attributes:
        fault: Name of the fault.
        seconds: Time from the end of the fault to the first data of the stream that lasted [s]; NaN
            for none.
        restored: Whether all settings were restored in the camera.
    """

    fault: str
    seconds: float
    restored: bool


class _Driver:
    """A camera under a supervisor, and statistics of its stream."""

    def __init__(self, path: str) -> None:
        self.parameters = DriverParameters(device=f'virtual:{path}', stream_timeout=SILENCE_S)
        self.camera = Davis346(self.parameters)
        self.supervisor = Supervisor(
            self.camera, on_start=_nothing, on_batch=self._on_batch, on_error=_nothing
        )
        self.went_back = 0
        self._time_us = 0
        self._works_s = 0.0
        self._failures = 0
        self._first_s: float | None = None
        self._latest_s = 0.0

    def expect(self, works_s: float) -> None:
        """Wait for a stream from now on; the camera works from a time on [s, monotonic clock]."""
        self._first_s, self._works_s = None, works_s

    def recovery_s(self) -> float:
        """Return the time from the end of the fault to the stream that lasts [s], or NaN."""
        deadline_s = self._works_s + LONGEST_RECOVERY_S
        while time.monotonic() < deadline_s:
            first_s = self._first_s
            now_s = time.monotonic()
            lasted = first_s is not None and now_s - first_s > STEADY_S
            if now_s - self._latest_s > GAP_S:
                lasted = False
            if first_s is not None and lasted and self._failures == self.supervisor.failures:
                return first_s - self._works_s
            time.sleep(0.01)
        return float('nan')

    def _on_batch(self, batch: CameraBatch) -> None:
        self.went_back += batch.time_us < self._time_us
        self._time_us = batch.time_us
        now_s = time.monotonic()
        gap, self._latest_s = now_s - self._latest_s > GAP_S, now_s
        fresh = self._first_s is None or self._failures != self.supervisor.failures or gap
        if fresh and now_s >= self._works_s:
            self._failures, self._first_s = self.supervisor.failures, now_s


def run_recovery_benchmark(
    faults: int = 100, seed: int = 0, *, on_fault: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Inject one fault after another into a streaming camera; return the figures for JSON.

    Args:
        faults: Number of faults; all kinds occur equally often, in random order.
        seed: Seed of their order, lengths and contents.
        on_fault: Called after each fault.
    """
    rng = Random(seed)  # noqa: S311 - not for secrets
    with tempfile.TemporaryDirectory() as folder:
        path = f'{folder}/camera.sock'
        with RecoveryScene(path, seed) as scene:
            driver = _Driver(path)
            driver.supervisor.start()
            driver.expect(time.monotonic())
            driver.recovery_s()
            before = _resources()
            recoveries = []
            for name in fault_names(faults, rng):
                recoveries.append(_recover_from(name, scene, driver, rng))
                on_fault()
            after = _resources(before)
            driver.supervisor.stop()
    return summarise(recoveries) | {
        'seed': seed,
        'time_went_back': driver.went_back,
        'reconnects': driver.supervisor.reconnects,
        'before': before,
        'after': after,
    }


def summarise(recoveries: Sequence[Recovery]) -> dict[str, Any]:
    """Return numbers and times [s] of recoveries; all with restored settings count as recovered."""
    by_fault = {
        name: _quantiles([each for each in recoveries if each.fault == name])
        for name in sorted({each.fault for each in recoveries})
    }
    return {
        'faults': len(recoveries),
        'recoveries': sum(each.restored for each in recoveries),
        'recovery_s': _quantiles(recoveries),
        'by_fault': by_fault,
    }


def recovery(
    json: JsonFile = None,
    faults: Annotated[int, typer.Option(min=1, help='Number of faults.')] = 100,
    seed: Annotated[int, typer.Option(min=0, help='Random seed of the faults.')] = 0,
) -> None:
    """Inject random faults into a streaming virtual camera; measure how the driver recovers."""
    console = Console(markup=False)
    with progress_bar('faults', faults, console) as advance:
        report = run_recovery_benchmark(faults, seed, on_fault=advance)
    rows = {**report['by_fault'], 'all': report['recovery_s']}
    headings = ('fault', 'count', 'failed', 'p50', 'p95', 'max')
    values = [
        (name, *('' if value is None else f'{value:g}' for value in row.values()))
        for name, row in rows.items()
    ]
    console.print(make_table('time to recover [s]', headings, values))
    console.print(
        f'{report["recoveries"]} of {report["faults"]} recovered with all settings, '
        f'{report["reconnects"]} reconnects, time went back {report["time_went_back"]} times'
    )
    before, after = report['before'], report['after']
    console.print(
        f'threads {before["threads"]} -> {after["threads"]}, '
        f'file descriptors {before["descriptors"]} -> {after["descriptors"]}, '
        f'memory {before["memory_mib"]:.0f} -> {after["memory_mib"]:.0f} MiB'
    )
    write_json(json, report)
    if report['recoveries'] < report['faults'] or report['time_went_back']:
        raise typer.Exit(1)


def fault_names(faults: int, rng: Random) -> Iterator[str]:
    """Yield names of faults in random order, each kind equally often."""
    names: list[str] = []
    for _ in range(faults):
        if not names:
            names = rng.sample(list(OUTAGES), len(OUTAGES))
        yield names.pop()


def _recover_from(name: str, scene: RecoveryScene, driver: _Driver, rng: Random) -> Recovery:
    camera = driver.camera
    exposure_us = rng.randrange(1000, 20_000)
    camera.apply(replace(driver.parameters, aps_exposure=exposure_us))
    driver.expect(float('inf'))
    driver.expect(OUTAGES[name](scene.device, rng))
    seconds = driver.recovery_s()
    lasted = math.isfinite(seconds) and driver.supervisor.state is State.STREAMING
    return Recovery(name, seconds, lasted and _is_restored(scene, camera))


def _is_restored(scene: RecoveryScene, camera: Davis346) -> bool:
    writes = register_writes(camera.control.parameters, camera.identity)
    wanted = {(write.module, write.parameter): write.value for write in writes}
    return all(scene.device.register(*address) == value for address, value in wanted.items())


def _nothing(*_: object) -> None:
    pass


def _resources(before: dict[str, float] | None = None) -> dict[str, float]:
    """Return threads, descriptors and memory in use, once what was closed has ended.

    The other end of a socket notices only later that it was closed: a thread of the virtual camera
    and its descriptor last until then. A leak lasts.

    Args:
        before: Resources to go back to, or None.
    """
    gc.collect()
    process = psutil.Process()
    deadline_s = time.monotonic() + LONGEST_ENDING_S
    time.sleep(1.0)
    while True:
        now = {
            'threads': process.num_threads(),
            'descriptors': process.num_fds(),
            'memory_mib': round(process.memory_info().rss / (1 << 20), 1),
        }
        if before is None or time.monotonic() >= deadline_s:
            return now
        if all(now[name] <= before[name] for name in ('threads', 'descriptors')):
            return now
        time.sleep(0.1)


def _quantiles(recoveries: Sequence[Recovery]) -> dict[str, float | None]:
    """Return numbers, and quantiles of the times of those with a stream; None without any."""
    seconds = [each.seconds for each in recoveries if math.isfinite(each.seconds)]
    found: dict[str, float | None] = dict.fromkeys(('p50', 'p95', 'max'))
    if seconds:
        found |= {k: round(v, 3) for k, v in quantiles(seconds, (0.5, 0.95, 1.0)).items()}
    return {'count': len(recoveries), 'failed': len(recoveries) - len(seconds), **found}
