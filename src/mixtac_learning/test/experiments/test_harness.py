# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows over seeds, against the plain definitions, and the report of them."""

from __future__ import annotations

import json
import math
import statistics
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.progress import Progress

from mixtac_core.events.errors import MixtacError
from mixtac_learning.experiments import harness
from mixtac_learning.experiments.forces import rolling_bins
from mixtac_learning.experiments.harness import PAPER_SIZES, Context, Outcome, Row, Value
from mixtac_learning.experiments.models import error_rows, rate_hz
from mixtac_learning.judge.estimators import TrialEstimate

if TYPE_CHECKING:
    from pathlib import Path


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=20))
def test_mean_and_spread_are_those_of_the_standard_library(values):
    found = Value.of([*values, math.nan])
    assert found.mean == pytest.approx(statistics.fmean(values), abs=1e-6)
    assert found.spread == pytest.approx(statistics.stdev(values), abs=1e-6)
    assert found.count == len(values)


def test_a_report_holds_all_rows(tmp_path):
    figure = tmp_path / 'a.png'
    row = Row('x < y: MAE', Value(0.05, 0.01, 3, 'seeds'), 0.04, 'section 1', 'N', 'dark & cold')
    cited = Row('other', Value.of([]), 0.8, 'table', 'N', 'cited', False)
    outcome = Outcome('d', [row, cited], {'c': figure})
    path = tmp_path / 'sub' / 'rows.json'
    harness.write_report(tmp_path, {'inputs': outcome}, {'seeds': 3}, path)
    assert '0.05 ± 0.01 (3 seeds)' in (tmp_path / 'report.md').read_text(encoding='utf-8')
    assert str(Value(517_040.0, 0.0, 1, '')) == '517,040'
    content = json.loads(path.read_text(encoding='utf-8'))
    first, second = content['rows']
    assert first['ours'] == {'mean': 0.05, 'spread': 0.01, 'count': 3, 'over': 'seeds'}
    assert {'experiment', 'name', 'paper', 'place', 'unit', 'conditions', 'simulated'} <= set(first)
    assert second['ours']['mean'] is None
    only = content['experiments'][0]
    assert only['figures'] == {'c': 'a.png'}
    assert all(only[name] for name in ('title', 'paper', 'deviations'))


def estimate(seconds, seed=0, error=0.1, held=1):
    random = np.random.default_rng(seed)
    t_us = 500_000 + 2000 * np.arange(round(500 * seconds))
    known = np.sin(1e-6 * t_us) ** 2
    force = known + random.normal(0.0, error, len(t_us))
    force = np.repeat(force[::held], held)[: len(t_us)]
    return TrialEstimate('trial', 'long_term', '7', t_us, force, known, None)


def test_rows_spread_over_seeds():
    by_seed = {seed: [estimate(3.0, 10 * seed + k) for k in range(2)] for seed in range(3)}
    mae, rmse, r2 = error_rows('m', by_seed, {'mae': 0.04}, 'p', 'c')
    values = [
        np.mean(np.abs(np.concatenate([e.force - e.known for e in trials])))
        for trials in by_seed.values()
    ]
    assert mae.ours.mean == pytest.approx(np.mean(values))
    assert mae.ours.spread == pytest.approx(np.std(values, ddof=1))
    assert (mae.paper, mae.place, rmse.paper) == (0.04, 'p', None)
    assert r2.unit == ''


def test_rate_counts_different_forces():
    assert rate_hz([estimate(4.0)]) == pytest.approx(500.0, rel=0.01)
    assert rate_hz([estimate(4.0, held=20)]) == pytest.approx(25.0, rel=0.03)


def test_rolling_error_is_the_mean_over_half_a_second_around_each_window():
    trial = estimate(12.0)
    bins = rolling_bins(trial)
    assert [len(each) for each in bins] == [2500, 3500]  # two seconds left join the bin before
    error = np.abs(trial.force - trial.known)
    for index in (1000, 2499, 2500, 4100):
        plain = error[index - 125 : index + 125].mean()
        bin_index, place = min(index // 2500, 1), index - 2500 * min(index // 2500, 1)
        assert bins[bin_index][place] == pytest.approx(plain, rel=1e-9)
    # A remainder of more than half a bin stands alone.
    assert [len(each) for each in rolling_bins(estimate(8.0))] == [2500, 1500]


NAMES = ['vibration', 'stability', 'inputs', 'fusion', 'impact', 'slip', 'model', 'comparison']


def test_experiments_are_selected_once_and_in_the_order_of_the_paper():
    assert list(harness.select(['all'])) == NAMES
    assert list(harness.select(['slip', 'inputs', 'slip'])) == ['inputs', 'slip']
    with pytest.raises(MixtacError) as refused:
        harness.select(['smell'])
    assert "'smell'" in str(refused.value)
    assert all(name in refused.value.remedy for name in NAMES)


def square(value: int, log: Path) -> int:
    with log.open('a') as file:
        file.write(f'{value}\n')
    if value < 0:
        raise ValueError(value)
    return value**2


@pytest.fixture
def log(tmp_path):
    return tmp_path / 'log'


@pytest.fixture
def context(tmp_path):
    return Context(PAPER_SIZES['quick'], tmp_path, 1, 1, Progress(disable=True))


def test_results_come_in_order_and_only_missing_ones_are_computed(context, log):
    context.run('some', square, [(1, log), (2, log)])
    assert context.run('all', square, [(k, log) for k in range(4)]) == [0, 1, 4, 9]
    assert sorted(log.read_text().split()) == ['0', '1', '2', '3']
    assert replace(context, jobs=2).run('all', square, [(k, log) for k in (4, 5)]) == [16, 25]


def test_an_interrupted_run_continues(context, log):
    with pytest.raises(ValueError, match='-1'):
        context.run('all', square, [(2, log), (-1, log), (3, log)])
    assert context.run('all', square, [(2, log), (3, log)]) == [4, 9]
    assert log.read_text().split() == ['2', '-1', '3']


def test_changed_code_is_computed_again(context, log, tmp_path, monkeypatch):
    package = tmp_path / 'package'
    package.mkdir()
    monkeypatch.setattr(harness, 'files', lambda _package: package)
    for text in ('A = 1', 'A = 2'):
        (package / 'part.py').write_text(text)
        harness.code_version.cache_clear()
        context.run('all', square, [(1, log)])
    harness.code_version.cache_clear()
    assert log.read_text().split() == ['1', '1']
