# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stored results are not computed again; other inputs and other code are."""

from __future__ import annotations

import dataclasses
import pickle
from typing import TYPE_CHECKING

import pytest

from mixtac_learning.experiments import harness
from mixtac_learning.experiments.harness import Piece, compute
from mixtac_learning.experiments.slip import TrialPlan, trial_piece
from mixtac_slip_control.parameters import SlipControlParameters

if TYPE_CHECKING:
    from pathlib import Path


def square(base: Path, value: int, log: Path) -> dict[str, int]:
    with log.open('a') as file:
        file.write(f'{value}\n')
    if value < 0:
        raise ValueError(value)
    base.with_name(f'{base.name}.txt').write_text(str(value))
    return {'square': value**2}


@pytest.fixture
def log(tmp_path):
    return tmp_path / 'log'


def piece_of(value: int, log: Path) -> Piece:
    return Piece(f'squared_{value}', square, (value, log))


@pytest.mark.parametrize('jobs', [1, 2])
def test_results_come_in_order_and_only_missing_ones_are_computed(tmp_path, log, jobs):
    folder = tmp_path / 'pieces'
    pieces = [piece_of(k, log) for k in range(4)]
    advanced = []
    compute(folder, pieces[1:3])
    results = compute(folder, pieces, jobs, lambda: advanced.append(1))
    assert [each['square'] for each in results] == [0, 1, 4, 9]
    assert len(advanced) == 4
    assert sorted(log.read_text().split()) == ['0', '1', '2', '3']
    assert (folder / f'{pieces[3].stem}.txt').read_text() == '3'


def test_an_interrupted_run_continues_and_a_damaged_result_is_computed_again(tmp_path, log):
    folder = tmp_path / 'pieces'
    with pytest.raises(ValueError, match='-1'):
        compute(folder, [piece_of(2, log), piece_of(-1, log), piece_of(3, log)])
    (folder / f'{piece_of(3, log).stem}.json').write_text('{"squ')
    results = compute(folder, [piece_of(2, log), piece_of(3, log)])
    assert [each['square'] for each in results] == [4, 9]
    assert log.read_text().split() == ['2', '-1', '3']


def test_changed_code_is_another_piece(tmp_path, monkeypatch):
    (tmp_path / 'part.py').write_text('A = 1')
    monkeypatch.setattr(harness, 'files', lambda _package: tmp_path)
    stems = []
    for text in ('A = 1', 'A = 2'):
        (tmp_path / 'part.py').write_text(text)
        harness.code_version.cache_clear()
        stems.append(pickle.loads(pickle.dumps(piece_of(1, tmp_path / 'log'))).stem)
    harness.code_version.cache_clear()
    assert len(set(stems)) == 2


def test_other_settings_of_a_trial_are_another_piece():
    settings = SlipControlParameters()
    other = dataclasses.replace(settings, law='paper')
    plans = [TrialPlan(), TrialPlan(preset='easy'), TrialPlan(settings=other)]
    assert len({trial_piece(plan).stem for plan in plans}) == 3
    assert trial_piece(TrialPlan()).stem == trial_piece(TrialPlan(settings=settings)).stem
