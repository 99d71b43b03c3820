# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The measurement of the simulator's speed."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import starmap

import pytest
import typer
from typer.testing import CliRunner

from mixtac_lab.bench import simulate as simulate_report
from mixtac_lab.bench.simulate import STAGES, Chain, ChainRun, time_by_stage
from mixtac_recordings.dataset import TrialSpec


def test_the_chain_sends_all_events_frames_and_samples():
    run = Chain(TrialSpec('a', 'press', 2.7, 1, 2, 'easy', 'train')).run()
    assert run.simulated_s == pytest.approx(2.7)
    # Two readings of 89960 pixels per frame, 67 frames; at least a word per event; 16 per sample.
    frames = 67 * 2 * 346 * 260 * 2
    assert run.octets > frames + 2 * run.events + 2700 * 32
    assert run.octets < frames * 1.1 + 8 * run.events + 2700 * 64


def test_stages_of_a_bag_and_the_rest_are_the_whole():
    chain = Chain(TrialSpec('a', 'idle', 2.6, 1, 2, 'easy', 'train'))
    shares = time_by_stage(chain.run)
    assert sum(shares.values()) == pytest.approx(1.0, abs=0.02)
    assert set(shares) - {'other'} <= set(STAGES)
    assert {'mechanics', 'event pixels', 'frames', 'USB words'} <= set(shares)
    assert shares['other'] < 0.6


def test_what_is_no_stage_is_other():
    assert time_by_stage(lambda: sum(starmap(max, ((i, 1) for i in range(1000))))) == {'other': 1.0}


def test_factors_are_simulated_over_real_time(monkeypatch, tmp_path):
    online = [ChainRun(10.0, wall, wall / 2, 100, 1000) for wall in (2.0, 4.0, 5.0)]
    stages = {'online': {'mechanics': 0.4, 'other': 0.6}, 'batch': {'bag': 0.2, 'other': 0.8}}
    report = simulate_report.summarise(online, ChainRun(100.0, 10.0, 5.0))
    monkeypatch.setattr(simulate_report, 'measure', lambda *_: report | {'share_of_time': stages})
    app = typer.Typer()
    app.command()(simulate_report.simulate)
    path = tmp_path / 'new' / 'figures.json'
    result = CliRunner().invoke(app, ['--json', str(path)])
    assert result.exit_code == 0, result.output
    figures = json.loads(path.read_text())
    assert figures['realtime_factor'] == {'online': 2.5, 'batch': 10.0}
    assert figures['cpu_factor'] == {'online': 5.0, 'batch': 20.0}
    assert figures['events_per_s'] == pytest.approx(10.0)
    assert figures['share_of_time']['batch']['bag'] == 0.2


def test_processor_time_of_children_counts():
    work = 'import sys, time\nwhile time.process_time() < 0.5: pass\nprint(flush=True)'
    work += '\nsys.stdin.read()'
    pipes = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE}
    before = simulate_report.processor_s()
    with subprocess.Popen([sys.executable, '-c', work], **pipes) as child:
        child.stdout.readline()
        # The kernel counts in ticks of 10 ms, at both ends.
        assert simulate_report.processor_s() - before > 0.475
        child.stdin.close()
