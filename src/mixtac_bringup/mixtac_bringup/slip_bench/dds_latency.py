# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From the onset of a slip to its detection and to the trajectory, over real DDS.

Five processes: a virtual camera that sends knocks over its USB protocol, the driver node, the slip
control node and the virtual arm as they are shipped, and a probe that receives `slip` and the
trajectories. All times are the host's; the probe's time of arrival counts, transport included.
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

import numpy as np

from mixtac_bringup.benchmark.json_process import JsonProcess
from mixtac_bringup.errors import GraphError
from mixtac_bringup.graph import config_file, executable, yaml_value

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

NAMESPACE = 'mixtac_slip_bench'
TRAJECTORIES = f'/{NAMESPACE}/joint_trajectory'
JOINTS = f'/{NAMESPACE}/joint_states'
START_S = 300.0
ENABLE_S = 60.0
HORIZON_NS = 100_000_000
"""Answers later than this after an onset belong to nothing."""


@dataclass(frozen=True, slots=True)
class DdsLatency:
    """What was measured.

    Attributes:
        speeds_mm_s: Speed of each knock that fell into the measurement [mm/s].
        detection_ms: From its onset to the arrival of `slip` [ms]; NaN where none came.
        publish_ms: From its onset to the arrival of the first trajectory [ms].
        false_alarms: Slips that were seen without one.
        seconds: Length of the measurement [s].
        camera_stalls: Times that the camera's buffer overflowed.
    """

    speeds_mm_s: list[float]
    detection_ms: list[float]
    publish_ms: list[float]
    false_alarms: int
    seconds: float
    camera_stalls: int


def measure(
    seconds: float,
    seed: int = 0,
    speeds_mm_s: tuple[float, float] = (30.0, 100.0),
    progress: Callable[[float], None] = lambda _seconds: None,
) -> DdsLatency:
    """Run the processes and measure.

    Args:
        seconds: Length of the measurement [s].
        seed: Draws sensor, day, times and speeds.
        speeds_mm_s: Range of the speeds.
        progress: Called now and then with the seconds measured so far.

    Raises:
        GraphError: A process did not start, or slip control could not be enabled.
    """
    env = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix='mixtac-'))
        socket = str(Path(folder) / 'usb.sock')

        def start(name: str, command: list[str]) -> JsonProcess:
            return stack.enter_context(JsonProcess(name, command, env))

        camera = start('camera', _camera(socket, seed, speeds_mm_s))
        scene = camera.expect('ready', START_S)
        probe = start('probe', [sys.executable, '-m', f'{__package__}.slip_probe_node'])
        probe.expect('ready', START_S)
        start('arm', _arm())
        start('slip control', _slip_control())
        start('driver', _driver(socket))
        first = camera.expect('origin_ns', START_S)
        probe.send(namespace=f'/{NAMESPACE}', trajectory_topic=TRAJECTORIES)
        _wait_enabled(probe)
        # A start sets the clock going and then resets it: only the last origin counts.
        origin_ns = int(camera.latest('origin_ns', first)['origin_ns'])
        began_ns = time.time_ns()
        while (elapsed_s := 1e-9 * (time.time_ns() - began_ns)) < seconds:
            time.sleep(min(0.5, seconds - elapsed_s))
            progress(elapsed_s)
        ended_ns = time.time_ns()
        probe.stop()
        noted = probe.expect('slips_ns', START_S)
        camera.stop()
        stalls = int(camera.expect('periods_lost', START_S)['periods_lost'])
    return _match(scene, noted, origin_ns, (began_ns, ended_ns - HORIZON_NS), stalls)


def _wait_enabled(probe: JsonProcess) -> None:
    """Wait until slip control runs.

    Raises:
        GraphError: It could not be enabled; says why not.
    """
    try:
        probe.expect('enabled', ENABLE_S)
    except GraphError as error:
        probe.stop()
        reason = probe.expect('last_reason', START_S)['last_reason']
        raise GraphError(
            f'slip control could not be enabled within {ENABLE_S:g} s: {reason or "no answer"}'
        ) from error


def _match(
    scene: dict[str, Any],
    noted: dict[str, Any],
    origin_ns: int,
    span_ns: tuple[int, int],
    stalls: int,
) -> DdsLatency:
    """Return the latencies of the knocks between two times."""
    period_ns = 1000 * int(scene['period_us'])
    periods = range(
        max((span_ns[0] - origin_ns) // period_ns, 0), (span_ns[1] - origin_ns) // period_ns + 1
    )
    knocks = [
        (origin_ns + k * period_ns + 1000 * onset, speed)
        for k in periods
        for onset, speed in zip(scene['onsets_us'], scene['speeds_mm_s'], strict=True)
    ]
    knocks = [knock for knock in knocks if span_ns[0] <= knock[0] <= span_ns[1]]
    slips = np.array(noted['slips_ns'], np.int64)
    sent = np.array(noted['trajectories_ns'], np.int64)
    seen = slips[(slips >= span_ns[0]) & (slips <= span_ns[1])]
    starts = np.array([at for at, _ in knocks], np.int64)
    return DdsLatency(
        [speed for _, speed in knocks],
        _after(starts, slips),
        _after(starts, sent),
        int(sum(not np.any((at >= starts) & (at - starts < HORIZON_NS)) for at in seen)),
        1e-9 * (span_ns[1] - span_ns[0]),
        stalls,
    )


def _after(starts: np.ndarray[Any, np.dtype[np.int64]], times: Any) -> list[float]:  # noqa: ANN401
    """Return the time from each start to the first of some times after it [ms], or NaN."""
    found = []
    for start in starts:
        k = int(np.searchsorted(times, start))
        near = k < len(times) and times[k] - start < HORIZON_NS
        found.append(1e-6 * float(times[k] - start) if near else float('nan'))
    return found


def _camera(socket: str, seed: int, speeds: tuple[float, float]) -> list[str]:
    options = {'socket': socket, 'seed': seed, 'slowest': speeds[0], 'fastest': speeds[1]}
    flags = [f'--{name}={value}' for name, value in options.items()]
    return [sys.executable, '-m', f'{__package__}.slip_camera', *flags]


def _driver(socket: str) -> list[str]:
    return _node(
        [str(executable('mixtac_driver', 'driver_node'))], 'driver', device=f'virtual:{socket}'
    )


def _slip_control() -> list[str]:
    return _node(
        [str(executable('mixtac_slip_control', 'slip_control_node'))],
        'slip_control',
        arm='fr3',
        trajectory_topic=TRAJECTORIES,
        joint_state_topic=JOINTS,
        normal_frame='base',
        normal_y=1.0,
        normal_z=0.0,
    )


def _arm() -> list[str]:
    return _node(
        [sys.executable, '-m', 'mixtac_sim.virtual_arm_node'],
        'virtual_arm',
        trajectory_topic=TRAJECTORIES,
        joint_state_topic=JOINTS,
    )


def _node(program: Sequence[str], name: str, **values: object) -> list[str]:
    """Return a node's command line with its shipped parameters and some others."""
    given = (
        part for key, value in values.items() for part in ('-p', f'{key}:={yaml_value(value)}')
    )
    shipped = config_file(f'{name}.yaml')
    files = ['--params-file', str(shipped)] if shipped.exists() else []
    return [
        *program,
        '--ros-args',
        '-r',
        f'__ns:=/{NAMESPACE}',
        '--log-level',
        'warn',
        *files,
        *given,
    ]
