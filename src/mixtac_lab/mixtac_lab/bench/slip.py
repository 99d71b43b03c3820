# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip control: held objects, latency, limits and false alarms, simulated.

The latency is measured over DDS with five processes: a virtual camera that sends knocks over its
USB protocol, driver node, slip control node and virtual arm as shipped (except for a shorter
settling time, so that slip control is ready before the next knock), and a probe that receives
`slip` and the trajectories. All times are on the monotonic clock of the host. The camera counts
it without skew from an origin that it reports, so the onset of each knock is known to a
microsecond. Latencies end at the arrival at the probe and include the transport.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from mixtac_cli.figures import new_axes, save_figure
from mixtac_cli.options import JsonFile, OptionalPath, Preset
from mixtac_lab.bench.harness import START_TIMEOUT_S, BenchRun
from mixtac_lab.slip.detectors import QUIET, count_alarms, curves
from mixtac_lab.slip.loop import SIDEWAYS, TRANSPORT_S
from mixtac_lab.slip.trials import (
    TrialPlan,
    latency_quantiles,
    load_piece,
    load_row,
    margin_row,
    summary,
    trial_piece,
)
from mixtac_lab.store import Store
from mixtac_node.files import write_json
from mixtac_node.graph import NodeSpec, sensor_graph, slip_control
from mixtac_node.process import GraphError, JsonProcess
from mixtac_slip_control.parameters import SlipControlParameters

NAMESPACE = 'mixtac_slip_bench'
TRAJECTORIES = f'/{NAMESPACE}/joint_trajectory'
JOINTS = f'/{NAMESPACE}/joint_states'
ENABLE_S = 60.0
WARM_UP_S = 5.0
"""Time after the first enabling in which knocks do not count [s]."""
SETTLING_S = 0.1
"""Settling time of slip control [s]."""
HORIZON_NS = 100_000_000
"""Answers later than this after an onset are not matched with it [ns]."""
QUIET_NS = 50_000_000
"""A knock counts for the trajectories only if slip control was enabled and sent none for this time
before it [ns]; otherwise the first one after it may not be its answer."""
STIFFNESSES = (10.0, 5.0, 2.0, 1.0)
"""Stiffnesses of the contact, in turn [N/mm]."""
FIRST_SEED = 70_000
MARGINS = (1.005, 1.02, 1.05, 1.2)
"""Grasp forces over the smallest that holds."""
LOADED_MARGIN = 1.05
"""Grasp force of objects that are loaded, over the smallest that holds them at first."""
FIRST_LOADED = 71_000
QUICK_TRIALS = 6
Force = Literal['estimated', 'true']


def measure(seconds: float, *, together: bool = False) -> dict[str, Any]:
    """Run the processes and measure; there are about 40 knocks in a minute.

    Args:
        seconds: Length of the measurement [s].
        together: Slip control runs in the driver's process.

    Returns:
        What `match_knocks` returns, and `together`.

    Raises:
        GraphError: A process did not start, or slip control could not be enabled.
    """
    with BenchRun() as run:
        device, scene = run.start_camera('knocks')
        probe = run.start_program('probe', 'probe_node')
        probe.expect('ready', START_TIMEOUT_S)
        for name, node in _nodes(device, together=together).items():
            run.start_node(name, node, NAMESPACE)
        camera = run.processes['camera']
        first = camera.expect('monotonic_ns', START_TIMEOUT_S)
        probe.send(probe='slip', namespace=f'/{NAMESPACE}', trajectory_topic=TRAJECTORIES)
        _wait_enabled(probe)
        # A start lets the clock run and then resets it: only the last origin counts.
        origin_ns = int(camera.latest('monotonic_ns', first)['monotonic_ns'])
        run.measure(WARM_UP_S)
        began_ns = time.monotonic_ns()
        elapsed_s, cpu = run.measure(seconds)
        probe.stop()
        noted = probe.expect('slips_ns', START_TIMEOUT_S)
        camera.stop()
        stalls = int(camera.expect('periods_lost', START_TIMEOUT_S)['periods_lost'])
    span_ns = (began_ns, began_ns + int(1e9 * elapsed_s) - HORIZON_NS)
    shares = {name: round(share, 4) for name, share in cpu.items()}
    found = match_knocks(scene, noted, origin_ns, span_ns, stalls, shares)
    return {**found, 'together': together}


def _nodes(device: str, *, together: bool) -> dict[str, NodeSpec]:
    """Return the nodes under test by the names of their processes."""
    arm = {'trajectory_topic': TRAJECTORIES, 'joint_state_topic': JOINTS}
    control = {
        'arm': 'fr3',
        'controller_state_topic': 'none',
        'normal_frame': 'base',
        'normal_y': 1.0,
        'normal_z': 0.0,
        'settling_time': SETTLING_S,
    }
    control |= arm
    moved = {'arm': NodeSpec('mixtac_sim', 'virtual_arm_node', 'virtual_arm', overrides=arm)}
    # The probe tells the force.
    if together:
        both = sensor_graph(device, slip=control)
        return moved | {each.name: each for each in both if each.name == 'slip_control'}
    driver = NodeSpec('mixtac_driver', 'driver_node', 'driver', overrides={'device': device})
    return moved | {'slip control': slip_control(control), 'driver': driver}


def _wait_enabled(probe: JsonProcess) -> None:
    """Wait until slip control is enabled.

    Raises:
        GraphError: It could not be enabled; the message holds its reason.
    """
    try:
        probe.expect('enabled', ENABLE_S)
    except GraphError as error:
        probe.stop()
        reason = probe.expect('last_reason', START_TIMEOUT_S)['last_reason']
        raise GraphError(
            f'slip control could not be enabled within {ENABLE_S:g} s: {reason or "no answer"}',
            remedy='end other programs that load the processor',
        ) from error


def match_knocks(
    scene: dict[str, Any],
    noted: dict[str, Any],
    origin_ns: int,
    span_ns: tuple[int, int],
    stalls: int,
    shares: dict[str, float],
) -> dict[str, Any]:
    """Return the latencies of the knocks between two times, for JSON.

    Args:
        scene: Description by the camera: `period_us`, `onsets_us`, `speeds_mm_s`.
        noted: Figures of the slip probe.
        origin_ns: Start of the first period.
        span_ns: First and last time.
        stalls: Number of buffer overflows of the camera.
        shares: CPU time of each process over time.

    Returns:
        `speeds_mm_s` of all knocks; `detection_ms`, the time from the onset of each to the arrival
        of `slip` [ms]; `publish_ms`, the time to the arrival of the first trajectory [ms], for
        knocks before which slip control was enabled and quiet, None for none; `not_ready`, the
        number of knocks before which it was not; `missed_detections` and `missed_answers`, the
        numbers of None; `false_alarms`, the number of reported slips without a knock; `seconds`,
        the length of the measurement [s]; `camera_stalls`; `windows` of 1 ms that slip control
        reported; `stops`, the number of interlock stops, of which the watchdogs cause some on a
        busy host; `cpu_shares`.
    """
    period_ns = 1000 * int(scene['period_us'])
    early = max(span_ns[0] - HORIZON_NS - origin_ns, 0) // period_ns
    every = [
        (origin_ns + k * period_ns + 1000 * onset, speed)
        for k in range(early, (span_ns[1] - origin_ns) // period_ns + 1)
        for onset, speed in zip(scene['onsets_us'], scene['speeds_mm_s'], strict=True)
    ]
    knocks = [knock for knock in every if span_ns[0] <= knock[0] <= span_ns[1]]
    slips = np.array(noted['slips_ns'], np.int64)
    sent = np.array(noted['trajectories_ns'], np.int64)
    seen = slips[(slips >= span_ns[0]) & (slips <= span_ns[1])]
    starts = np.array([at for at, _ in knocks], np.int64)
    ready = np.array([_ready(at, noted['enabled_spans_ns'], sent) for at in starts], np.bool_)
    detection_ms, publish_ms = _after(starts, slips), _after(starts[ready], sent)
    alarms = [not any(0 <= at - start < HORIZON_NS for start, _ in every) for at in seen]
    return {
        'speeds_mm_s': [speed for _, speed in knocks],
        'detection_ms': _known(detection_ms),
        'publish_ms': _known(publish_ms),
        'not_ready': int(np.count_nonzero(~ready)),
        'missed_detections': int(np.count_nonzero(np.isnan(detection_ms))),
        'missed_answers': int(np.count_nonzero(np.isnan(publish_ms))),
        'false_alarms': sum(alarms),
        'seconds': 1e-9 * (span_ns[1] - span_ns[0]),
        'camera_stalls': stalls,
        'windows': noted['windows'],
        'stops': noted['stops'],
        'cpu_shares': shares,
    }


def _ready(at_ns: int, spans_ns: Sequence[Sequence[int]], sent_ns: NDArray[np.int64]) -> bool:
    """Return whether slip control was enabled and quiet before a time."""
    enabled = any(start <= at_ns - QUIET_NS and at_ns <= end for start, end in spans_ns)
    return enabled and not np.any((sent_ns > at_ns - QUIET_NS) & (sent_ns < at_ns))


def _after(starts: NDArray[np.int64], times: NDArray[np.int64]) -> list[float]:
    """Return the delay from each start to the next of some times [ms]; NaN for none."""
    found = []
    for start in starts:
        k = int(np.searchsorted(times, start))
        near = k < len(times) and times[k] - start < HORIZON_NS
        found.append(1e-6 * float(times[k] - start) if near else float('nan'))
    return found


def _known(values: Sequence[float]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values]


def slip(
    trials: Annotated[
        int, typer.Option(min=4, help='Number of trials with the box at each margin.')
    ] = 100,
    knock: Annotated[
        float, typer.Option(help='Speed of the object after the knock (mm/s).')
    ] = 50.0,
    margin: Annotated[
        float | None,
        typer.Option(
            help='Ratio of the grasp force to the smallest force that holds; by default each of '
            '1.005, 1.02, 1.05 and 1.2.'
        ),
    ] = None,
    wait: Annotated[
        float, typer.Option(help='Time that the grip margin has to act before the knock (s).')
    ] = 0.0,
    off_axis: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=4.0,
            help='Distance of the contact from the optical axis (mm); by default that of the day.',
        ),
    ] = None,
    force: Annotated[
        Force, typer.Option(help="The sensor's own force, or the true one with noise of 30 mN.")
    ] = 'estimated',
    lag: Annotated[
        float, typer.Option(help='Time constant with which the arm follows its commands (s).')
    ] = 3.5e-3,
    lead: Annotated[
        float,
        typer.Option(
            min=2e-3, max=0.2, help='Lead of the trajectories (s); below 0.006 the arm reports.'
        ),
    ] = SlipControlParameters.lead,
    quiet_minutes: Annotated[
        float, typer.Option(help='Length of each scene without slip (min); 0 for none.')
    ] = 30.0,
    loads: Annotated[
        int,
        typer.Option(help='Cups that 10 g are added to each second until they are twice as heavy.'),
    ] = 0,
    curve_trials: Annotated[
        int, typer.Option(help='Slips per speed for the latency curves; 0 for none.')
    ] = 40,
    dds_seconds: Annotated[
        float, typer.Option(help='Length of the measurement over DDS (s); 0 for none.')
    ] = 330.0,
    together: Annotated[
        bool,
        typer.Option('--together', help="Over DDS: slip control in the driver's process."),
    ] = False,
    preset: Preset = 'paper_like',
    keep: Annotated[
        OptionalPath,
        typer.Option(help='Folder for finished parts; an interrupted run continues there.'),
    ] = None,
    jobs: Annotated[int, typer.Option(min=0, help='Number of processes; 0: one per core.')] = 1,
    quick: Annotated[
        bool, typer.Option('--quick', help='Six trials at each margin, and nothing else.')
    ] = False,
    report: JsonFile = None,
    figure: Annotated[
        OptionalPath, typer.Option(help='Draw the latency curves to this PNG file.')
    ] = None,
) -> None:
    """Measure slip control: held objects, latency, limits, false alarms. Simulated results."""
    console, store, jobs = Console(markup=False), Store(keep), jobs or os.cpu_count() or 1
    if quick:
        trials, quiet_minutes, curve_trials, dds_seconds, loads = QUICK_TRIALS, 0.0, 0, 0.0, 0
    margins = MARGINS if margin is None else (margin,)
    plan = TrialPlan(
        knock_mm_s=knock,
        preset=preset,
        lag_s=lag,
        settings=SlipControlParameters(lead=lead),
        wait_s=wait,
        off_axis_mm=off_axis,
        estimated=force == 'estimated',
    )
    # All margins of a sensor in a row, so that it is calibrated once.
    plans = [
        replace(plan, seed=FIRST_SEED + k, margin=each, stiffness_n_per_mm=stiffness)
        for k, stiffness in zip(range(trials), cycle(STIFFNESSES), strict=False)
        for each in margins
    ]
    results = store.run_shown('box trials', [trial_piece(each) for each in plans], console, jobs)
    by_margin = {
        f'{each:g}': margin_row(
            [r for p, r in zip(plans, results, strict=True) if p.margin == each]
        )
        for each in margins
    }
    cup = replace(plan, name='cup', margin=LOADED_MARGIN)
    loaded = [load_piece(replace(cup, seed=FIRST_LOADED + k)) for k in range(loads)]
    loads_found = store.run_shown('slow loads', loaded, console, jobs) if loaded else []
    told: dict[str, Any] = {'margins': by_margin, 'force': force}
    if loads_found:
        told['load'] = load_row(loads_found)
    told['conditions'] = {
        'margin': list(margins),
        'wait_s': wait,
        'off_axis_mm': off_axis,
        'knock_mm_s': knock,
        'arm_lag_s': lag,
        'lead_s': lead,
        'preset': preset,
        'normal': list(SIDEWAYS),
        'transport': TRANSPORT_S,
    }
    # Written after each part: the later ones take long, and need an idle host.
    write_json(report, summarise(results, None, []) | told)
    latency = None
    if dds_seconds > 0.0:
        with console.status('slips over DDS'):
            latency = measure(dds_seconds, together=together)
        write_json(report, summarise(results, latency, []) | told)
    quiet = []
    if quiet_minutes > 0.0:
        seconds = 60.0 * quiet_minutes
        quiet = [count_alarms(name, seconds, preset, store, console, jobs) for name in QUIET]
    outcome = summarise(results, latency, quiet) | told
    console.print_json(data=outcome)
    write_json(report, outcome)
    if curve_trials > 0:
        outcome['curves'] = curves(curve_trials, preset)
        if figure is not None:
            draw_curves(figure, outcome['curves'])
        write_json(report, outcome)


def summarise(
    results: Sequence[dict[str, Any]],
    latency: dict[str, Any] | None,
    quiet: Sequence[dict[str, Any]],
) -> dict[str, Any]:
    """Return the results for JSON; the latencies are those over DDS if they were measured."""
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
            f'{k:g}': summary([r for r in results if abs(r['stiffness_n_per_mm'] - k) < 0.02 * k])
            for k in STIFFNESSES
        },
        'quiet': list(quiet),
    }
    if latency is not None:
        outcome['detection_ms'] = latency_quantiles(latency['detection_ms'])
        outcome['publish_ms'] = latency_quantiles(latency['publish_ms'])
        outcome['latency_from'] = 'DDS, measured at a subscriber'
        outcome['dds'] = latency
        outcome['false_alarms'] += latency['false_alarms']
    return outcome


def draw_curves(path: Path, curves: Mapping[str, Any]) -> None:
    """Draw latency against false alarms of both detectors, one panel per speed.

    Args:
        path: Image file.
        curves: Result of `mixtac_lab.slip.detectors.curves`.
    """
    figure, axes = new_axes(columns=len(curves), width=4.0 * len(curves), height=3.6)
    for ax, (speed, both) in zip(axes, curves.items(), strict=True):
        for name, curve in both.items():
            late = np.array(curve['latency_ms'], np.float64)
            (line,) = ax.plot(np.array(curve['false_alarms_per_min']) + 0.01, late, label=name)
            shipped = curve['shipped']
            if shipped['latency_p50_ms'] is not None:
                at = shipped['false_alarms_per_min'] + 0.01, shipped['latency_p50_ms']
                ax.plot(*at, 'o', color=line.get_color(), label=f'{name}, shipped')
        ax.set(xscale='log', xlabel='false alarms per minute + 0.01', ylabel='median latency [ms]')
        ax.set_title(f'{speed.replace("_mm_s", " mm/s")}, simulated')
        ax.legend()
    save_figure(figure, path)
