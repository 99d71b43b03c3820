# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The closing table of a demo run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from mixtac_bringup.demo import DemoReport


def print_summary(console: Console, report: DemoReport, folder: Path) -> None:
    """Print what a demo measured and where its bag and figure are."""
    table = Table(title='Measured on the virtual sensor (simulated)', title_justify='left')
    table.add_column('figure')
    table.add_column('value', justify='right')
    for name, value in _rows(report):
        table.add_row(name, value)
    console.print(table)
    console.print(f'figure   {folder / "demo.png"}', soft_wrap=True)
    console.print(f'bag      {folder / "bag"}', soft_wrap=True)
    console.print(f'summary  {folder / "demo.json"}', soft_wrap=True)


def _rows(report: DemoReport) -> list[tuple[str, str]]:
    latency = report.latency_ms
    return [
        ('event rate, mean', f'{report.event_rate_mev_s:.3f} Mev/s'),
        ('event rate, highest in 10 ms', f'{report.peak_event_rate_mev_s:.2f} Mev/s'),
        ('event packets', f'{report.packet_hz:.0f} Hz'),
        ('force', f'{report.force_hz:.1f} Hz'),
        ('latency p50 / p99', f'{latency["p50"]:.2f} / {latency["p99"]:.2f} ms'),
        ('error against the reference, MAE / RMSE', f'{report.mae_n:.3f} / {report.rmse_n:.3f} N'),
        ('  best constant guess, MAE', f'{report.constant_mae_n:.3f} N'),
        ('error against the simulated force, MAE', f'{report.truth_mae_n:.3f} N'),
        ('reference clock drift found', f'{report.clock_drift_ppm:.1f} ppm'),
        ('lost: force samples', str(report.lost)),
        ('lost: event packets', str(report.lost_packets)),
        ('dropped inside nodes', str(report.dropped)),
    ]
