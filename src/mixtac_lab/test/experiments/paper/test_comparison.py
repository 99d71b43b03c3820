# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sizes of the paper's network, and the table of sensors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from rich.progress import Progress

from mixtac_lab.experiments.paper import model as size
from mixtac_lab.experiments.paper.comparison import _table
from mixtac_lab.experiments.paper.model import _paper_rows
from mixtac_lab.experiments.sizes import QUICK
from mixtac_learning.judge.estimators import TrialEstimate


def test_paper_network_is_counted_and_timed():
    parameters, operations, interval, packet = _paper_rows()
    assert parameters.ours.mean == pytest.approx(parameters.paper, rel=0.005)
    assert operations.ours.mean == pytest.approx(operations.paper, rel=0.01)
    assert not parameters.simulated
    assert interval.ours.mean > 0.0
    assert packet.ours.mean > 0.0
    assert interval.ours.count == packet.ours.count == 10


def test_steps_have_a_median_and_a_percentile_of_their_own_number(monkeypatch):
    found = {
        'windows': 4910,
        'step_ms': {'p50': 0.2, 'p99': 0.5},
        'flops_per_cycle': 5e6,
        'frames': 241,
        'frame_ms': {'p50': 0.9, 'p99': 1.1},
        'parameters': 69_065,
    }
    monkeypatch.setattr(size, 'measure', lambda *_: found)
    monkeypatch.setattr(size, 'REPETITIONS', 1)
    context = SimpleNamespace(sizes=QUICK, progress=Progress(disable=True))
    steps = [row for row in size.model.run(context).rows if ' step' in row.name]
    assert [row.ours.mean for row in steps] == [0.2, 0.5, 0.9, 1.1]
    assert {row.ours.spread for row in steps} == {0.0}
    assert [row.paper for row in steps] == [size.LATENCY_MS, None, None, None]
    assert all('4910' in row.conditions for row in steps[:2])
    assert all('241' in row.conditions for row in steps[2:])


def test_table_of_sensors_is_the_papers_with_our_lines():
    t_us = 2000 * np.arange(1000)
    known = np.linspace(0.0, 1.2, 1000)
    trial = TrialEstimate('t', 'dynamic', 'd', t_us, known + 0.05, known, None)
    lines = _table({'ours': {0: [trial]}, 'fger': {0: [trial]}}, simulated=True)
    assert [line[0] for line in lines[1:6]] == [
        'Insight',
        'ViTacTip',
        'E-BTS',
        'GelEvent',
        'Mixtac (paper)',
    ]
    assert lines[5][2:] == ('500', '0.04', '1')
    assert lines[6][2:] == ('500', '0.05', '1.2')
    assert all('simulated' in line[0] for line in lines[6:])
    assert len({len(line) for line in lines}) == 1
