# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The pipeline benchmark really runs its three processes and counts what arrives."""

from __future__ import annotations

import json

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_lab.bench import pipeline as pipeline_report
from mixtac_lab.bench.pipeline import Load, full_load, is_clean, run_force, run_pipeline


@pytest.mark.dds
def test_a_short_run_measures_ages_and_counts_losses(
    ros_domain: dict[str, str], monkeypatch: pytest.MonkeyPatch
):
    for name, value in ros_domain.items():
        monkeypatch.setenv(name, value)
    told: list[float] = []
    load = Load(200_000, per_row=2.0, frame_interval=50_000, reading_interval=2000)
    figures = run_pipeline(load, 3.0, progress=told.append)
    assert figures['periods'] > 0
    assert figures['events'] > 0
    assert figures['backwards'] == 0
    # A busy machine loses packets; without that every event arrives.
    assert is_clean(figures) or figures['camera_stalls'] or figures['packets_lost'], figures
    assert 0.0 < figures['age_p50_ms'] <= figures['age_p99_ms'] <= figures['age_max_ms']
    assert figures['driver_cpu'] > 0.0
    assert told == sorted(told)
    json.dumps(figures)


@pytest.mark.dds
def test_forces_of_the_composed_graph_arrive(
    ros_domain: dict[str, str], monkeypatch: pytest.MonkeyPatch
):
    for name, value in ros_domain.items():
        monkeypatch.setenv(name, value)
    figures = run_force(full_load(100_000.0), 2.0, together=True)
    assert figures['single_process']
    assert figures['forces'] > 0
    assert 0.0 < figures['force_age_p50_ms'] <= figures['force_age_p99_ms']


def run_of(rate: float, *, lost: int = 0, stalls: int = 0) -> dict[str, float]:
    return {
        'rate_mev_s': rate / 1e6,
        'age_p50_ms': 0.9,
        'age_p99_ms': 1.9,
        'events_lost': lost,
        'packets_lost': 0,
        'periods': 9,
        'camera_stalls': stalls,
        'driver_cpu_per_mev_s': 0.5,
    }


def test_the_largest_rate_is_the_last_one_without_any_loss(monkeypatch: pytest.MonkeyPatch):
    outcomes = {5e6: {}, 12e6: {}, 20e6: {'stalls': 1}, 30e6: {'lost': 4}}

    def fake(load: Load, _seconds: float, progress: object = None) -> dict[str, float]:
        return run_of(load.rate, **outcomes.get(load.rate, {}))

    monkeypatch.setattr(pipeline_report, 'run_pipeline', fake)
    runs = pipeline_report.measure(1.0, 1.0, lambda _name, _length: lambda _done: None)
    assert [run['rate_mev_s'] for run in runs] == [1.0, 5.0, 5.0, 12.0, 20.0]
    report = pipeline_report.summarise_pipeline(*runs)
    assert report['max_rate_mev_s'] == 12.0
    assert report['age_ms'] == {'p50': 0.9, 'p99': 1.9}
