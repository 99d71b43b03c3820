# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How much faster than real time the virtual sensor runs."""

from __future__ import annotations

import statistics
import struct
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import psutil
import typer
from rich.console import Console
from usb.core import USBTimeoutError

from mixtac.figures import make_table
from mixtac.options import JsonFile, Preset
from mixtac_core.node.files import write_json
from mixtac_core.recordings.dataset import TrialSpec
from mixtac_sim.bags.trial_bag import generate
from mixtac_sim.usb import registers
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.endpoints import DATA_ENDPOINT, serial_number
from mixtac_sim.usb.registers import Module, Mux, Usb
from mixtac_sim.world.plans import describe, plan_profile
from mixtac_sim.world.trial import Stretch, TrialStream

TICK_US: Final = 1_000
"""The virtual sensor submits its data every millisecond [us]."""
READ_BYTES: Final = 1 << 22
_TO_DEVICE, _WRITE_MANY = 0x40, 0xC2
_RUN: Final = (
    (Module.MUX, Mux.RUN_CHIP),
    (Module.USB, Usb.RUN),
    (Module.MUX, Mux.TIMESTAMP_RUN),
    (Module.MUX, Mux.RUN),
    (Module.DVS, registers.Dvs.RUN),
    (Module.APS, registers.Aps.RUN),
    (Module.IMU, registers.Imu.RUN_ACCEL),
    (Module.IMU, registers.Imu.RUN_GYRO),
    (Module.IMU, registers.Imu.RUN_TEMPERATURE),
)


@dataclass(frozen=True, slots=True)
class ChainRun:
    """One run of the chain, or of a batch of bags.

    Attributes:
        simulated_s: Simulated time [s].
        wall_s: Elapsed time [s].
        cpu_s: Processor time [s].
        events: Number of simulated events.
        octets: Number of bytes sent by the camera.
    """

    simulated_s: float
    wall_s: float
    cpu_s: float
    events: int = 0
    octets: int = 0


class Chain:
    """Mechanics, pixels and frames of a trial, sent as USB words by the virtual camera.

    Args:
        spec: The trial.
    """

    def __init__(self, spec: TrialSpec) -> None:
        self._trial = TrialStream(spec)
        self._camera = running_camera(serial_number(spec.device_seed))

    def run(self) -> ChainRun:
        """Run the whole trial and measure the time; only once.

        Raises:
            USBTimeoutError: The camera did not answer.
        """
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        events = octets = last_us = 0
        for stretch in self._trial.stretches():
            octets += self._send(stretch)
            events += len(stretch.sensor.events)
            last_us = stretch.end_us
        wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
        return ChainRun(1e-6 * last_us, wall_s, cpu_s, events, octets)

    def _send(self, stretch: Stretch) -> int:
        camera, octets = self._camera, 0
        camera.submit(stretch.sensor.events, stretch.sensor.frames, stretch.readings)
        for now_us in range(stretch.start_us + TICK_US, stretch.end_us + 1, TICK_US):
            camera.advance(now_us)
            try:
                octets += len(camera.read_bulk(DATA_ENDPOINT, READ_BYTES, 0.0))
            except USBTimeoutError:
                continue
        return octets


def running_camera(serial: str) -> VirtualDavis346:
    """Return a virtual camera with everything on and its clock at zero."""
    camera = VirtualDavis346(serial, clock=lambda: 0)
    settings: Sequence[tuple[int, int, int]] = [
        *((int(module), int(param), 1) for module, param in _RUN),
        (int(Module.USB), int(Usb.EARLY_PACKET_DELAY), 0),
    ]
    data = b''.join(struct.pack('>BBI', *setting) for setting in settings)
    camera.control(_TO_DEVICE, _WRITE_MANY, len(settings), 0, data)
    return camera


PROFILE: Final = 'dynamic'
ONLINE_RUNS: Final = 3
BATCH_JOBS: Final = 2
BATCH_TRIALS: Final = 4
WARM_UP_S: Final = 3.0


def simulate(
    json: JsonFile = None,
    seconds: Annotated[float, typer.Option(min=5, max=600, help='Length of a trial (s).')] = 25.0,
    preset: Preset = 'paper_like',
) -> None:
    """Measure the speed of the virtual sensor: full chain with USB on one core, bags on two."""
    console = Console(markup=False)
    with console.status('simulating'):
        figures = measure(seconds, preset)
    factors = [
        (f'{what}{how}', f'{figures[key][name]:.2f}')
        for what, name in (
            ('online: full chain, USB words, one core', 'online'),
            (f'batch: bags, {BATCH_JOBS} processes', 'batch'),
        )
        for how, key in (('', 'realtime_factor'), (', by processor time', 'cpu_factor'))
    ]
    title = f'{PROFILE}, {preset}, {seconds:g} s trials'
    console.print(make_table(title, ('what', 'times real time'), factors))
    write_json(json, figures)


def measure(seconds: float, preset: str) -> dict[str, Any]:
    """Measure both outputs of the simulator, camera and bags, and return the figures for JSON.

    Args:
        seconds: Length of a trial [s].
        preset: Difficulty preset of the virtual sensor.
    """
    specs = plan_profile(PROFILE, BATCH_TRIALS, seconds, preset=preset)
    warm = plan_profile(PROFILE, BATCH_JOBS, WARM_UP_S, preset=preset)
    Chain(warm[0]).run()
    online = [Chain(spec).run() for spec in specs[:ONLINE_RUNS]]
    with tempfile.TemporaryDirectory(prefix='mixtac-bench-') as name:
        folder = Path(name)
        _batch(warm, folder / 'warm')
        begin, busy = time.perf_counter(), processor_s()
        _batch(specs, folder / 'bags')
        wall_s, cpu_s = time.perf_counter() - begin, (processor_s() - busy) / BATCH_JOBS
    batch = ChainRun(seconds * BATCH_TRIALS, wall_s, cpu_s)
    return summarise(online, batch)


def summarise(online: Sequence[ChainRun], batch: ChainRun) -> dict[str, Any]:
    """Return the factors and rates for JSON.

    Args:
        online: Runs of the full chain on one core; the factors are their medians.
        batch: The batch of bags, with the processor time per process.
    """
    simulated_s = sum(run.simulated_s for run in online)
    return {
        'realtime_factor': {
            'online': statistics.median(run.simulated_s / run.wall_s for run in online),
            'batch': batch.simulated_s / batch.wall_s,
        },
        'cpu_factor': {
            'online': statistics.median(run.simulated_s / run.cpu_s for run in online),
            'batch': batch.simulated_s / batch.cpu_s,
        },
        'events_per_s': sum(run.events for run in online) / simulated_s,
        'usb_bytes_per_s': sum(run.octets for run in online) / simulated_s,
    }


def processor_s() -> float:
    """Return the processor time of this process and its running children [s]."""
    this = psutil.Process()
    times = [process.cpu_times() for process in (this, *this.children(recursive=True))]
    return float(sum(each.user + each.system for each in times))


def _batch(specs: list[TrialSpec], folder: Path) -> None:
    preset = specs[0].preset
    plan = describe(PROFILE, 0, preset, 'trial', specs)
    generate(plan, folder, jobs=BATCH_JOBS)


if __name__ == '__main__':
    typer.run(simulate)
