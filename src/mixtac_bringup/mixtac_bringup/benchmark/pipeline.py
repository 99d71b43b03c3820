# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How old events are when they reach another process, and at which rates none is lost.

Three processes: a virtual camera that sends a pattern over its USB protocol, the driver node as it
is shipped, and a subscriber. The age of an event is the host time at which its packet arrives at
the subscriber less the true time at which the camera stamped it.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mixtac_bringup.benchmark.json_process import JsonProcess
from mixtac_bringup.graph import config_file, executable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

NAMESPACE = 'mixtac_bench'
START_TIMEOUT_S = 30.0
SETTLE_S = 2.0


@dataclass(frozen=True, slots=True)
class Load:
    """What the camera sends.

    Attributes:
        rate: Events per second.
        per_row: Mean events per row.
        frame_interval_us: Time between frames [us], 0 for none.
        reading_interval_us: Time between inertial samples [us], 0 for none.
    """

    rate: float
    per_row: float = 1.0
    frame_interval_us: int = 0
    reading_interval_us: int = 0


@dataclass(frozen=True, slots=True)
class PipelineRun:
    """One run.

    Attributes:
        load: What the camera sent.
        seconds: Length of the measurement [s].
        figures: See `mixtac_bringup.benchmark.arrivals.Arrivals.summary`.
        camera_stalls: Times that the camera's buffer overflowed.
        driver_cpu: CPU time of the driver over time.
        probe_cpu: CPU time of the subscriber over time.
    """

    load: Load
    seconds: float
    figures: Mapping[str, float]
    camera_stalls: int
    driver_cpu: float
    probe_cpu: float

    @property
    def lost(self) -> int:
        """Events that did not arrive."""
        return int(self.figures['events_lost'])

    @property
    def clean(self) -> bool:
        """Whether everything sent has arrived."""
        nothing = not self.lost and not self.figures['packets_lost'] and not self.camera_stalls
        return nothing and self.figures['periods'] > 0

    def as_dict(self) -> dict[str, Any]:
        """Return the run for JSON."""
        rate = self.load.rate / 1e6
        return {
            'rate_mev_s': rate,
            'seconds': self.seconds,
            **self.figures,
            'camera_stalls': self.camera_stalls,
            'driver_cpu': self.driver_cpu,
            'driver_cpu_per_mev_s': self.driver_cpu / rate,
            'subscriber_cpu': self.probe_cpu,
        }


def run_pipeline(
    load: Load,
    seconds: float,
    parameters: Mapping[str, object] | None = None,
    progress: Callable[[float], None] = lambda _seconds: None,
) -> PipelineRun:
    """Run the three processes and measure.

    Args:
        load: What the camera sends.
        seconds: Length of the measurement [s].
        parameters: Driver parameters that differ from the shipped ones.
        progress: Called now and then with the seconds measured so far.

    Raises:
        GraphError: A process did not start.
    """
    env = dict(os.environ)
    env['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='mixtac-'))
        socket = str(Path(folder) / 'usb.sock')
        camera = stack.enter_context(JsonProcess('camera', camera_command(load, socket), env))
        pattern = camera.expect('ready', START_TIMEOUT_S)
        module = 'mixtac_bringup.benchmark.arrival_probe_node'
        probe = stack.enter_context(JsonProcess('subscriber', [sys.executable, '-m', module], env))
        probe.expect('ready', START_TIMEOUT_S)
        command = _driver_command(socket, parameters or {})
        driver = stack.enter_context(JsonProcess('driver', command, env))
        first = camera.expect('origin_ns', START_TIMEOUT_S)
        time.sleep(SETTLE_S)
        # A start sets the clock going and then resets it: only the last origin counts.
        origin_ns = camera.latest('origin_ns', first)['origin_ns']
        probe.send(
            topic=f'/{NAMESPACE}/events',
            pattern={
                'origin_ns': origin_ns,
                'period_us': pattern['period_us'],
                'events': pattern['events'],
            },
        )
        began_s, driver_s, probe_s = time.monotonic(), driver.cpu_s(), probe.cpu_s()
        while (elapsed_s := time.monotonic() - began_s) < seconds:
            time.sleep(min(0.5, seconds - elapsed_s))
            progress(time.monotonic() - began_s)
        elapsed_s = time.monotonic() - began_s
        driver_s, probe_s = driver.cpu_s() - driver_s, probe.cpu_s() - probe_s
        probe.stop()
        figures = probe.expect('events_lost', START_TIMEOUT_S)
        driver.stop()
        camera.stop()
        stalls = int(camera.expect('periods_lost', START_TIMEOUT_S)['periods_lost'])
    return PipelineRun(load, elapsed_s, figures, stalls, driver_s / elapsed_s, probe_s / elapsed_s)


def camera_command(load: Load, socket: str) -> list[str]:
    """Return the command line of the camera that sends a load on a socket."""
    options = {
        'socket': socket,
        'rate': load.rate,
        'per-row': load.per_row,
        'frame-interval': load.frame_interval_us,
        'reading-interval': load.reading_interval_us,
    }
    flags = [f'--{name}={value}' for name, value in options.items()]
    return [sys.executable, '-m', 'mixtac_bringup.benchmark.pattern_server', *flags]


def _driver_command(socket: str, parameters: Mapping[str, object]) -> list[str]:
    values = {'device': f'virtual:{socket}', **parameters}
    arguments = [f'{name}:={value}' for name, value in values.items()]
    return [
        *(str(executable('mixtac_driver', 'driver_node')), '--ros-args'),
        *('-r', f'__ns:=/{NAMESPACE}', '--log-level', 'warn'),
        *('--params-file', str(config_file('driver.yaml'))),
        *(part for argument in arguments for part in ('-p', argument)),
    ]
