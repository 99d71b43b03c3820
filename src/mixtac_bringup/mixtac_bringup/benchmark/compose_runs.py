# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""How old the force is at a subscriber: driver and estimator apart, and in one process."""

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
from mixtac_bringup.benchmark.pipeline import Load, camera_command
from mixtac_bringup.compose.process import in_one_process
from mixtac_bringup.errors import GraphError
from mixtac_bringup.graph import sensor_graph

if TYPE_CHECKING:
    from collections.abc import Mapping

NAMESPACE = 'mixtac_bench'
START_TIMEOUT_S = 120.0
SETTLE_S = 3.0


@dataclass(frozen=True, slots=True)
class ForceRun:
    """One run.

    Attributes:
        together: Whether driver and estimator shared a process.
        figures: See `mixtac_bringup.benchmark.force_probe_node.force_figures`.
        cpu: CPU time over time by process.
    """

    together: bool
    figures: Mapping[str, float]
    cpu: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return the run for JSON."""
        return {
            'single_process': self.together,
            **self.figures,
            'cpu': dict(self.cpu),
            'cpu_total': sum(self.cpu.values()),
        }


def run_force(load: Load, seconds: float, *, together: bool) -> ForceRun:
    """Run camera, driver, estimator and subscriber, and measure.

    Args:
        load: What the simulated camera sends; it needs frames.
        seconds: Length of the measurement [s].
        together: Run driver and estimator in one process.

    Raises:
        GraphError: A process did not start, or no force came.
    """
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='mixtac-'))
        env = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        socket = str(Path(folder) / 'usb.sock')
        camera = stack.enter_context(JsonProcess('camera', camera_command(load, socket), env))
        pattern = camera.expect('ready', START_TIMEOUT_S)
        module = 'mixtac_bringup.benchmark.force_probe_node'
        probe = stack.enter_context(JsonProcess('subscriber', [sys.executable, '-m', module], env))
        probe.expect('ready', START_TIMEOUT_S)
        nodes = [n for n in sensor_graph(f'virtual:{socket}') if n.name != 'virtual_sensor']
        nodes = in_one_process(nodes) if together else nodes
        parts = {
            node.name: stack.enter_context(
                JsonProcess(node.name, node.command(NAMESPACE, log_level='warn'), env)
            )
            for node in nodes
        }
        first = camera.expect('origin_ns', START_TIMEOUT_S)
        probe.send(namespace=NAMESPACE, settle_s=SETTLE_S)
        probe.expect('active', START_TIMEOUT_S)
        origin_ns = camera.latest('origin_ns', first)['origin_ns']
        values = {'period_us': pattern['period_us'], 'events': pattern['events']}
        probe.send(pattern={'origin_ns': origin_ns, **values})
        probe.expect('measuring', START_TIMEOUT_S)
        before = {name: process.cpu_s() for name, process in parts.items()}
        began_s = time.monotonic()
        time.sleep(seconds)
        elapsed_s = time.monotonic() - began_s
        cpu = {name: (p.cpu_s() - before[name]) / elapsed_s for name, p in parts.items()}
        probe.stop()
        figures = probe.expect('forces', START_TIMEOUT_S)
    if not figures['forces']:
        raise GraphError('no force came: run `mixtac up --device virtual` and read /diagnostics')
    return ForceRun(together, figures, cpu)
