# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control: held objects, latency, limits and false alarms, simulated.

The latency is measured over DDS with five processes: a virtual camera that sends knocks over its
USB protocol, driver node, slip control node and virtual arm as shipped (except for a shorter
settling time, so that slip control is ready before the next knock), and a probe that receives
`slip` and the trajectories. All times are on the monotonic clock of the host. The camera counts
it without skew from an origin that it reports, so the onset of each knock is known to a
microsecond. The time of arrival at the probe counts, transport included.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import numpy as np
import typer

from mixtac_lab.bench.harness import cpu_s
from mixtac_node.graph import config_file, executable, yaml_value
from mixtac_node.process import GraphError, JsonProcess

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from mixtac_lab.slip.trials import TrialPlan, TrialResult
    from mixtac_lab.store import Kept


NAMESPACE = 'mixtac_slip_bench'
TRAJECTORIES = f'/{NAMESPACE}/joint_trajectory'
JOINTS = f'/{NAMESPACE}/joint_states'
START_S = 300.0
ENABLE_S = 60.0
WARM_UP_S = 5.0
"""Knocks that come so soon after the first enabling do not count [s]."""
SETTLING_S = 0.1
"""Settling time of slip control [s]."""
HORIZON_NS = 100_000_000
"""Answers later than this after an onset belong to nothing."""
QUIET_NS = 50_000_000
"""A knock tells of trajectories only where slip control was enabled and sent none for so long
before: otherwise the first one after it need not be its answer."""


@dataclass(frozen=True, slots=True)
class DdsLatency:
    """What was measured.

    Attributes:
        speeds_mm_s: Speed of each knock that fell into the measurement [mm/s].
        detection_ms: From its onset to the arrival of `slip` [ms]; NaN where none came.
        publish_ms: From the onset to the arrival of the first trajectory [ms], for the knocks
            before which slip control was enabled and quiet; NaN where none came.
        not_ready: Knocks before which it was not.
        missed_detections: Knocks without a detection.
        missed_answers: Knocks without a trajectory, of those that `publish_ms` tells of.
        false_alarms: Slips that were seen without one.
        seconds: Length of the measurement [s].
        camera_stalls: Times that the camera's buffer overflowed.
        windows: Windows that slip control reported, of one millisecond each.
        stops: Times that its interlock stopped the arm: on a busy host its watchdogs do.
        cpu_shares: CPU time of each process over the length of the measurement.
    """

    speeds_mm_s: list[float]
    detection_ms: list[float]
    publish_ms: list[float]
    not_ready: int
    missed_detections: int
    missed_answers: int
    false_alarms: int
    seconds: float
    camera_stalls: int
    windows: int
    stops: int
    cpu_shares: dict[str, float]


def measure(
    seconds: float,
    seed: int = 0,
    speeds_mm_s: tuple[float, float] = (30.0, 100.0),
    progress: Callable[[float], None] = lambda _seconds: None,
) -> DdsLatency:
    """Run the processes and measure; there are about 40 knocks in a minute.

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
        started: dict[str, JsonProcess] = {}

        def start(name: str, command: list[str]) -> JsonProcess:
            started[name] = stack.enter_context(JsonProcess(name, command, env))
            return started[name]

        camera = start('camera', _camera(socket, seed, speeds_mm_s))
        scene = camera.expect('ready', START_S)
        probe = start('probe', [sys.executable, '-m', f'{__package__}.programs.slip_probe_node'])
        probe.expect('ready', START_S)
        start('arm', _arm())
        start('slip control', _slip_control())
        start('driver', _driver(socket))
        first = camera.expect('origin_ns', START_S)
        probe.send(namespace=f'/{NAMESPACE}', trajectory_topic=TRAJECTORIES)
        _wait_enabled(probe)
        # A start sets the clock going and then resets it: only the last origin counts.
        origin_ns = int(camera.latest('origin_ns', first)['origin_ns'])
        _wait(WARM_UP_S)
        before = {name: cpu_s(process) for name, process in started.items()}
        began_ns = time.monotonic_ns()
        _wait(seconds, progress)
        ended_ns = time.monotonic_ns()
        used = {name: cpu_s(process) - before[name] for name, process in started.items()}
        probe.stop()
        noted = probe.expect('slips_ns', START_S)
        camera.stop()
        stalls = int(camera.expect('periods_lost', START_S)['periods_lost'])
    span_s = 1e-9 * (ended_ns - began_ns)
    shares = {name: round(s / span_s, 4) for name, s in used.items()}
    return _match(scene, noted, origin_ns, (began_ns, ended_ns - HORIZON_NS), stalls, shares)


def _wait(seconds: float, progress: Callable[[float], None] = lambda _seconds: None) -> None:
    began_s = time.monotonic()
    while (elapsed_s := time.monotonic() - began_s) < seconds:
        time.sleep(min(0.5, seconds - elapsed_s))
        progress(elapsed_s)


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
    shares: dict[str, float],
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
    ready = np.array([_ready(at, noted['enabled_spans_ns'], sent) for at in starts], np.bool_)
    detection_ms, publish_ms = _after(starts, slips), _after(starts[ready], sent)
    return DdsLatency(
        speeds_mm_s=[speed for _, speed in knocks],
        detection_ms=detection_ms,
        publish_ms=publish_ms,
        not_ready=int(np.count_nonzero(~ready)),
        missed_detections=int(np.count_nonzero(np.isnan(detection_ms))),
        missed_answers=int(np.count_nonzero(np.isnan(publish_ms))),
        false_alarms=int(
            sum(not np.any((at >= starts) & (at - starts < HORIZON_NS)) for at in seen)
        ),
        seconds=1e-9 * (span_ns[1] - span_ns[0]),
        camera_stalls=stalls,
        windows=int(noted['windows']),
        stops=int(noted['stops']),
        cpu_shares=shares,
    )


def _ready(at_ns: int, spans_ns: Sequence[Sequence[int]], sent_ns: Any) -> bool:  # noqa: ANN401
    """Tell whether slip control was enabled and quiet before a time."""
    enabled = any(start <= at_ns - QUIET_NS and at_ns <= end for start, end in spans_ns)
    return enabled and not np.any((sent_ns > at_ns - QUIET_NS) & (sent_ns < at_ns))


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
    return [sys.executable, '-m', f'{__package__}.programs.knock_camera', *flags]


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
        settling_time=SETTLING_S,
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


OptionalPath = Optional[Path]  # noqa: UP045  (typer evaluates this under Python 3.10)
STIFFNESSES = (10.0, 5.0, 2.0, 1.0)
"""Stiffness of the contact in turns [N/mm]."""


def slip(
    trials: Annotated[int, typer.Option(min=4, help='Trials with the box.')] = 200,
    knock: Annotated[float, typer.Option(help='Speed after the blow (mm/s).')] = 50.0,
    margin: Annotated[float, typer.Option(help='Grasp force over the least that holds.')] = 1.05,
    lag: Annotated[float, typer.Option(help='Time constant of the arm (s).')] = 3.5e-3,
    quiet_minutes: Annotated[float, typer.Option(help='Of each quiet scene (min).')] = 30.0,
    curve_trials: Annotated[int, typer.Option(help='Slips per speed for the curves.')] = 40,
    dds_seconds: Annotated[float, typer.Option(help='Over real DDS (s); 0 for none.')] = 330.0,
    preset: Annotated[str, typer.Option(help='How hard the sensors are.')] = 'paper_like',
    keep: Annotated[
        OptionalPath, typer.Option(help='Keep finished parts in this file and go on from them.')
    ] = None,
    report: Annotated[OptionalPath, typer.Option('--json', help='Write the result.')] = None,
    figure: Annotated[OptionalPath, typer.Option(help='Draw the curves there (PNG).')] = None,
) -> None:
    """Measure slip control: held objects, latency, limits, false alarms. Simulated results."""
    from rich.console import Console

    from mixtac_lab.slip.loop import ArmSetup
    from mixtac_lab.slip.trials import TrialPlan
    from mixtac_lab.store import Kept
    from mixtac_sim.arm.plant import Tracking
    from mixtac_slip_control.parameters import SlipControlParameters

    console, kept = Console(), Kept(keep)
    settings = SlipControlParameters()
    arm = ArmSetup(Tracking(lag))
    plan = TrialPlan(margin=margin, knock_mm_s=knock, preset=preset, arm=arm, settings=settings)
    results = _box_trials(console, plan, trials, kept)
    latency = _over_dds(console, dds_seconds) if dds_seconds > 0.0 else None
    quiet = _quiet(console, quiet_minutes, plan, kept) if quiet_minutes > 0.0 else []
    outcome = _outcome(results, latency, quiet)
    outcome['conditions'] = {
        'margin': margin,
        'knock_mm_s': knock,
        'arm_lag_s': lag,
        'preset': preset,
        'normal': list(plan.arm.normal),
        'transport': asdict(plan.transport),
    }
    if curve_trials > 0:
        from mixtac_lab.slip.detectors import curves

        outcome['curves'] = curves(curve_trials, settings, preset)
        if figure is not None:
            from mixtac_lab.slip.trials import draw_curves

            draw_curves(figure, outcome['curves'])
    if report is not None:
        report.write_text(json.dumps(outcome, indent=2) + '\n', encoding='utf-8')
    shown = {k: v for k, v in outcome.items() if k != 'curves'}
    console.print_json(data=shown)


def _box_trials(console: Console, plan: TrialPlan, trials: int, kept: Kept) -> list[TrialResult]:
    """Run the trials with the box, at each stiffness in turn."""
    from dataclasses import replace

    from rich.progress import track

    from mixtac_lab.slip.trials import kept_trial

    results = []
    for k in track(range(trials), 'box trials', console=console):
        stiffness = STIFFNESSES[k % len(STIFFNESSES)]
        each = replace(plan, seed=70_000 + k, stiffness_n_per_mm=stiffness)
        results.append(kept_trial(each, kept)[0])
    return results


def _over_dds(console: Console, seconds: float) -> Any:  # noqa: ANN401

    with console.status('slips over real DDS'):
        return measure(seconds)


def _quiet(console: Console, minutes: float, plan: TrialPlan, kept: Kept) -> list[dict[str, Any]]:
    from rich.progress import track

    from mixtac_lab.slip.detectors import QUIET, count_alarms

    seconds, names = 60.0 * minutes, track(QUIET, 'quiet scenes', console=console)
    found = [count_alarms(name, seconds, plan.settings, plan.preset, kept) for name in names]
    return [asdict(alarms) for alarms in found]


def _outcome(
    results: list[TrialResult],
    latency: Any,  # noqa: ANN401
    quiet: list[dict[str, Any]],
) -> dict[str, Any]:
    """Return everything but the curves; the latencies are those over DDS where measured."""
    from mixtac_lab.slip.trials import quantiles, summary

    box = summary(results)
    outcome: dict[str, Any] = {
        'simulated': True,
        'detection_ms': box['detection_ms'],
        'publish_ms': box['publish_ms'],
        'latency_from': 'lock-step loop with assumed transport',
        'limit_violations': box['limit_violations'],
        'held_fraction': box['held_fraction'],
        'false_alarms': box['false_alarms'] + sum(each['flow'] for each in quiet),
        'box': box,
        'box_by_stiffness': {
            f'{k:g}': summary([r for r in results if abs(r.stiffness_n_per_mm - k) < 0.02 * k])
            for k in STIFFNESSES
        },
        'quiet': quiet,
    }
    if latency is not None:
        outcome['detection_ms'] = quantiles(latency.detection_ms)
        outcome['publish_ms'] = quantiles(latency.publish_ms)
        outcome['latency_from'] = 'real DDS, measured at a subscriber'
        outcome['dds'] = asdict(latency)
        outcome['false_alarms'] += latency.false_alarms
    return outcome
