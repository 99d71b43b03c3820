# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stored results are not computed again; other inputs and other code are."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from rich.progress import Progress

from mixtac_learning.experiments import harness
from mixtac_learning.experiments.harness import PAPER_SIZES, Context

if TYPE_CHECKING:
    from pathlib import Path


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


def test_processes_share_the_work(context, log):
    assert replace(context, jobs=2).run('all', square, [(k, log) for k in range(3)]) == [0, 1, 4]


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
