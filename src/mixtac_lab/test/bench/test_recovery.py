# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A few random faults on a streaming virtual camera; the full run is `mixtac bench recovery`."""

from __future__ import annotations

import json
import math
import random

import pytest
import typer

from mixtac_lab.bench import recovery

KINDS = (
    'unplugged',
    'data endpoint stalls for long',
    'requests time out',
    'registers read as garbage',
    'short and odd reads',
    'garbage in the data',
    'silent until restarted',
    'bus error',
)


@pytest.fixture
def short_faults(monkeypatch):
    monkeypatch.setattr(recovery, 'LONGEST_S', 0.2)
    # On a busy machine recovery takes longer.
    monkeypatch.setattr(recovery, 'LONGEST_RECOVERY_S', 300.0)
    monkeypatch.setattr(recovery, 'LONGEST_ENDING_S', 300.0)
    monkeypatch.setattr(recovery, 'OUTAGES', {name: recovery.OUTAGES[name] for name in KINDS})


def test_driver_recovers_from_every_fault_and_leaks_nothing(short_faults):
    report = recovery.run_recovery_benchmark(faults=len(KINDS), seed=1)
    assert list(report['by_fault']) == sorted(KINDS)
    assert report['recoveries'] == len(KINDS), report
    assert report['time_went_back'] == 0
    # A camera that vanished, one that failed on the bus, one that fell silent, and so on.
    assert report['reconnects'] >= 4
    assert report['after']['threads'] <= report['before']['threads']
    assert report['after']['descriptors'] <= report['before']['descriptors']


def test_plan_brings_all_kinds_equally_often():
    plan = list(recovery.fault_names(3 * len(recovery.OUTAGES), random.Random(3)))
    assert all(plan.count(name) == 3 for name in recovery.OUTAGES)


def report_of(*restored: bool) -> dict[str, object]:
    resources = {'threads': 8, 'descriptors': 11, 'memory_mib': 170.0}
    recoveries = [
        recovery.Recovery('unplugged', seconds, restored=each)
        for seconds, each in zip((0.2, 0.4, 0.3), restored, strict=True)
    ]
    return recovery.summarise(recoveries) | {
        'seed': 0,
        'time_went_back': 0,
        'reconnects': 3,
        'before': resources,
        'after': resources,
    }


def test_report_is_written_and_printed(monkeypatch, tmp_path, capsys):
    report = report_of(True, True, True)
    monkeypatch.setattr(recovery, 'run_recovery_benchmark', lambda *_args, **_kwargs: report)
    recovery.recovery(json=tmp_path / 'report.json')
    written = json.loads((tmp_path / 'report.json').read_text())
    assert written['recoveries'] == 3
    assert written['recovery_s'] == {'count': 3, 'failed': 0, 'p50': 0.3, 'p95': 0.39, 'max': 0.4}
    printed = capsys.readouterr().out
    assert '3 of 3 recovered' in printed
    assert 'unplugged' in printed


def test_faults_that_lasted_are_counted_beside_the_times_of_the_others():
    times = {'unplugged': (0.2, math.nan, 0.4), 'babble': (math.nan,)}
    found = recovery.summarise(
        [
            recovery.Recovery(name, seconds, restored=math.isfinite(seconds))
            for name, each in times.items()
            for seconds in each
        ]
    )
    assert (found['faults'], found['recoveries']) == (4, 2)
    assert found['recovery_s'] == {'count': 4, 'failed': 2, 'p50': 0.3, 'p95': 0.39, 'max': 0.4}
    none = {'p50': None, 'p95': None, 'max': None}
    assert found['by_fault']['babble'] == {'count': 1, 'failed': 1, **none}


@pytest.mark.parametrize(
    'report', [report_of(True, False, True), report_of(True, True, True) | {'time_went_back': 1}]
)
def test_command_fails_where_a_fault_lasted_or_time_went_back(monkeypatch, tmp_path, report):
    monkeypatch.setattr(recovery, 'run_recovery_benchmark', lambda *_args, **_kwargs: report)
    with pytest.raises(typer.Exit) as ended:
        recovery.recovery(json=tmp_path / 'report.json')
    assert ended.value.exit_code == 1
    assert json.loads((tmp_path / 'report.json').read_text())['faults'] == 3
