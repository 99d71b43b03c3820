# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a demo: computed from its bag, drawn, and printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from mixtac_alignment.align import align
from mixtac_alignment.bags import read_recording
from mixtac_alignment.errors import AlignmentError
from mixtac_cli.demo.drawing import draw_run
from mixtac_cli.demo.evaluation import (
    compare,
    event_rate,
    host_time,
    lost_windows,
    mae,
    mean_rate_hz,
    peak_error,
    phases,
    read_streams,
    truth_mae,
)
from mixtac_cli.figures import make_table
from mixtac_node.topics import DEFAULT_NAMESPACE

BAG: Final = 'bag'
PRESET: Final = 'paper_like'
"""What the shipped model was trained for."""
MAX_FORCE_GAP_S: Final = 2.0
"""A busy host may lose reference samples [s]; here their clock is known to be a single one."""


@dataclass(frozen=True)
class Run:
    """What was measured while the graph ran.

    Attributes:
        gain: Factor of the force that the calibration found; 1 if it was refused.
        dropped: Transfers, words, frames and messages that nodes dropped.
        computed_s: Time for which simulated time stopped to compute the scenario [s].
        waited_s: Time for which it stopped later [s].
        clock_pairs: (host, camera) clock pairs [ns] of the scenario, shape (N, 2), int64.
        arrival_ns: Arrival of each force, host clock [ns], int64.
        stamp_ns: Stamp of each force, camera clock [ns], int64.
    """

    gain: float
    dropped: int
    computed_s: float
    waited_s: float
    clock_pairs: NDArray[np.int64]
    arrival_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]


def evaluate(out: Path, run: Run, seconds: float, seed: int, device_seed: int) -> dict[str, Any]:
    """Compare the recorded force with the aligned reference, and draw the run.

    Returns:
        The figures for JSON; simulated sensor, real processes and middleware.

        `seconds`: Length of the scenario [s].
        `seed`: Seed of the scenario.
        `device_seed`: Seed of the virtual sensor's build.
        `force_hz`: Rate of `/mixtac/force` at a subscriber in another process.
        `lost`: Force samples missing at that subscriber, by their stamps.
        `invalid`: Force samples marked as not valid; they are published and count in all figures.
        `latency_ms`: From the end of a window to its force at the subscriber, p50 and p99; from the
            arrival of the window's last packet if simulated time stopped (`waited_s`).
        `mae_n`: Mean absolute error against the reference, aligned as by `mixtac align` and less
            its zero; None, as `rmse_n`, `constant_mae_n`, `reference_zero_n` and `clock_drift_ppm`,
            if the alignment was refused.
        `rmse_n`: Root mean square error against the same.
        `mae_uncalibrated_n`: What `mae_n` would be without the calibration.
        `gain`: Factor of the force that the calibration found; 1 if it was refused.
        `peak_error`: Relative error of the peak of the impact; None if it is not known.
        `reference_zero_n`: What the reference showed without a load, before and after [N].
        `constant_mae_n`: Error of the best constant guess on the same samples.
        `truth_mae_n`: Mean absolute error against the simulated force itself.
        `event_rate_mev_s`: Mean event rate.
        `peak_event_rate_mev_s`: Highest event rate in 10 ms.
        `packet_hz`: Rate of event packets.
        `lost_packets`: Event packets missing in the recording.
        `computed_s`: Time for which simulated time stopped to compute the scenario [s].
        `waited_s`: Time for which it stopped later, because the host was too slow [s].
        `dropped`: Transfers, words, frames and messages dropped inside nodes .
        `clock_drift_ppm`: Drift of the reference clock found by the alignment.
        `aligned_by`: Method of the alignment.
        `refused`: Why the alignment was refused, or empty.
    """
    streams = read_streams(out / BAG, DEFAULT_NAMESPACE)
    comparison, refused = None, ''
    try:
        fit = align(read_recording(out / BAG), max_gap_s=MAX_FORCE_GAP_S)
        comparison = compare(streams, fit)
    except AlignmentError as error:
        refused = str(error)
    pairs = run.clock_pairs if run.waited_s == 0.0 else None
    latency = (run.arrival_ns - host_time(streams, run.stamp_ns, pairs)) / 1e6
    rate = event_rate(streams, comparison)
    shown = phases(seconds, seed)
    report: dict[str, Any] = {
        'seconds': seconds,
        'seed': seed,
        'device_seed': device_seed,
        'force_hz': mean_rate_hz(run.arrival_ns),
        'lost': lost_windows(run.stamp_ns),
        'invalid': streams.invalid,
        'latency_ms': {
            'p50': float(np.quantile(latency, 0.5)),
            'p99': float(np.quantile(latency, 0.99)),
        },
        'mae_n': mae(comparison) if comparison else None,
        'rmse_n': comparison.rmse_n if comparison else None,
        'mae_uncalibrated_n': mae(comparison, 1.0 / run.gain) if comparison else None,
        'gain': run.gain,
        'peak_error': peak_error(comparison, shown) if comparison else None,
        'reference_zero_n': comparison.zeros_n if comparison else None,
        'constant_mae_n': comparison.constant_mae_n if comparison else None,
        'truth_mae_n': truth_mae(streams, pairs),
        'event_rate_mev_s': float(rate[1].mean() / 1e6),
        'peak_event_rate_mev_s': float(rate[1].max() / 1e6),
        'packet_hz': len(streams.complete_us) / (np.ptp(streams.force_ns) / 1e9),
        'lost_packets': streams.lost_packets,
        'computed_s': run.computed_s,
        'waited_s': run.waited_s,
        'dropped': run.dropped,
        'clock_drift_ppm': comparison.fit.drift_ppm if comparison else None,
        'aligned_by': comparison.fit.method if comparison else None,
        'refused': refused,
    }
    if comparison is not None:
        title = (
            f'Virtual sensor (simulated), seed {seed}: MAE {report["mae_n"]:.3f} N against the '
            f'aligned reference, {report["force_hz"]:.1f} Hz, {report["lost"]} lost'
        )
        draw_run(out / 'demo.png', comparison, rate, shown, title)
    return report


def print_summary(console: Console, report: Mapping[str, Any], folder: Path) -> None:
    """Print the results of a demo and where its bag and figure are."""
    title = 'Measured on the virtual sensor (simulated)'
    console.print(make_table(title, ('figure', 'value'), _rows(report)))
    if report['refused']:
        console.print(
            f'no error against the reference and no figure: {report["refused"]}', soft_wrap=True
        )
    else:
        console.print(f'figure   {folder / "demo.png"}', soft_wrap=True)
    console.print(f'bag      {folder / BAG}', soft_wrap=True)
    console.print(f'summary  {folder / "demo.json"}', soft_wrap=True)


def _rows(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    latency = report['latency_ms']
    return [
        ('event rate, mean', f'{report["event_rate_mev_s"]:.3f} Mev/s'),
        ('event rate, highest in 10 ms', f'{report["peak_event_rate_mev_s"]:.2f} Mev/s'),
        ('event packets', f'{report["packet_hz"]:.0f} Hz'),
        ('force', f'{report["force_hz"]:.1f} Hz'),
        ('latency p50 / p99', f'{latency["p50"]:.2f} / {latency["p99"]:.2f} ms'),
        (
            'error against the reference, MAE / RMSE',
            f'{_figure(report["mae_n"])} / {_figure(report["rmse_n"])} N',
        ),
        ('  before the calibration, MAE', f'{_figure(report["mae_uncalibrated_n"])} N'),
        ('  best constant guess, MAE', f'{_figure(report["constant_mae_n"])} N'),
        ('error against the simulated force, MAE', f'{report["truth_mae_n"]:.3f} N'),
        ("error of the impact's peak", _percent(report['peak_error'])),
        ('reference clock drift found', f'{_figure(report["clock_drift_ppm"], 1)} ppm'),
        ('lost: force samples', str(report['lost'])),
        ('lost: event packets', str(report['lost_packets'])),
        ('forces marked as not valid', str(report['invalid'])),
        ('dropped inside nodes', str(report['dropped'])),
        ('simulated time stopped for a slow host', f'{report["waited_s"]:.2f} s'),
    ]


def _figure(value: float | None, digits: int = 3) -> str:
    return '-' if value is None else f'{value:.{digits}f}'


def _percent(value: float | None, sign: str = '+') -> str:
    return '-' if value is None else f'{100 * value:{sign}.1f} %'
