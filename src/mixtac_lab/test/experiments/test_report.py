# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rows, and the report of them."""

from __future__ import annotations

import json
import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_lab.experiments.report import Outcome, Row, Value, number, write

PNG = b'\x89PNG\r\n\x1a\n'


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=20))
def test_mean_and_spread_are_those_of_the_standard_library(values):
    found = Value.of(values)
    assert found.mean == pytest.approx(statistics.fmean(values), abs=1e-6)
    assert found.spread == pytest.approx(statistics.stdev(values), abs=1e-6)
    assert found.count == len(values)


def test_values_that_are_missing_do_not_count():
    assert Value.of([1.0, math.nan, 3.0]) == Value(2.0, math.sqrt(2.0), 2, 'seeds')
    assert Value.of([]).as_dict()['mean'] is None
    assert Value.of([4.0]).spread == 0.0


@pytest.mark.parametrize(
    ('value', 'text'),
    [(0.0412, '0.0412'), (517_040, '517,040'), (1.996e9, '2e+09'), (500.0, '500'), (13, '13')],
)
def test_numbers_are_short(value, text):
    assert number(value) == text


@pytest.fixture
def outcomes(tmp_path):
    figure = tmp_path / 'a.png'
    figure.write_bytes(PNG)
    row = Row('x < y: MAE', Value(0.05, 0.01, 3, 'seeds'), 0.04, 'section 1', 'N', 'dark & cold')
    cited = Row('other', Value.of([]), 0.8, 'table', 'N', 'cited', False)
    return [
        Outcome('inputs', 'Inputs', 'p', 'd', [row, cited], {'c': figure}, ('smaller',)),
        Outcome('slip', 'Slip', 'p', 'none', skipped='not from bags'),
    ]


def test_report_holds_numbers_and_what_was_skipped(outcomes, tmp_path):
    write(tmp_path, outcomes, {'seeds': 3})
    text = (tmp_path / 'report.md').read_text(encoding='utf-8')
    assert '0.05 ± 0.01 (3 seeds)' in text
    assert 'not from bags' in text


def test_rows_of_all_experiments_are_in_one_list(outcomes, tmp_path):
    path = tmp_path / 'sub' / 'rows.json'
    write(tmp_path, outcomes, {'seeds': 3}, path)
    assert (tmp_path / 'report.json').read_bytes() == path.read_bytes()
    content = json.loads(path.read_text(encoding='utf-8'))
    first, cited = content['rows']
    assert first['experiment'] == 'inputs'
    assert first['ours'] == {'mean': 0.05, 'spread': 0.01, 'count': 3, 'over': 'seeds'}
    assert first['simulated'] is True
    assert {'name', 'paper', 'unit', 'conditions'} <= set(first)
    assert cited['ours']['mean'] is None
    assert content['experiments'][1]['skipped'] == 'not from bags'
