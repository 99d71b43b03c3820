# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which bags `mixtac evaluate` judges."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from mixtac_fger.weights import ModelCard, write_model
from mixtac_learning.commands import evaluate
from mixtac_learning.judge import report as evaluation
from mixtac_learning.judge.estimators import trial_estimator
from mixtac_learning.trials.trial import DatasetError, TrialArrays


@dataclass(frozen=True)
class Source:
    """A recording that needs no file."""

    path: Path
    trial: TrialArrays
    origin: dict[str, str]
    incomplete: bool = False
    shown: str = ''

    @property
    def name(self) -> str:
        return self.shown or self.path.name

    def load(self) -> TrialArrays:
        return replace(self.trial, origin={**self.origin, 'name': self.name})

    def damage(self) -> str:
        return '' if self.name != 'b' else 'its end is missing'


def sources_of(*bags: tuple[str, str], trial: TrialArrays):
    """Return what finds bags of these names and splits in every folder; one.bag is a bag itself."""

    def sources(folder: Path, _reference: str) -> list[Source]:
        if folder.suffix == '.bag':
            return [Source(folder, trial, {'split': 'train'})]
        return [Source(folder / name, trial, {'split': split}) for name, split in bags]

    return sources


def test_a_bag_that_is_named_is_judged_whatever_its_split(
    model, trial, tmp_path, monkeypatch, capsys
):
    sources = sources_of(('a', 'train'), ('b', 'test'), trial=trial)
    monkeypatch.setattr(evaluation, 'bag_sources', sources)
    path, out = tmp_path / 'm.safetensors', tmp_path / 'figures.json'
    write_model(path, replace(model, card=ModelCard({'bags': ['a', 'b']})))
    bags = [Path('one.bag'), Path('folder')]
    series = tmp_path / 'forces.csv'
    evaluate(bags, str(path), reference='/w', json=out, series=series)
    warnings = capsys.readouterr().err
    assert 'its end is missing' in warnings
    assert 'trained on bags of these names: b\n' in warnings
    content = json.loads(out.read_text())
    assert content['bags'] == ['one.bag', 'b']
    assert [row['bag'] for row in content['rows']] == ['one.bag', 'folder/b']
    rows = list(csv.reader(series.read_text().splitlines()))
    assert {len(row) for row in rows} == {7}
    assert {row[0] for row in rows[1:]} == {'one.bag', 'b'}
    assert all((row[4] == '1') == (row[5] == 'TRUSTED') for row in rows[1:])
    estimates = trial_estimator(model)(trial)
    forces = [float(row[2]) for row in rows[1:] if row[0] == 'b']
    assert forces == pytest.approx(estimates.force, abs=1e-6)


def test_bags_of_one_name_are_told_apart_by_their_folders(model, trial, tmp_path, monkeypatch):
    sources = sources_of(('static/a', 'test'), ('dynamic/a', 'test'), ('b', 'test'), trial=trial)
    monkeypatch.setattr(evaluation, 'bag_sources', sources)
    path, out = tmp_path / 'm.safetensors', tmp_path / 'figures.json'
    write_model(path, model)
    evaluate([tmp_path], str(path), json=out)
    assert json.loads(out.read_text())['bags'] == ['static_a', 'dynamic_a', 'b']


def test_a_folder_of_training_bags_is_refused_with_their_number(
    model, trial, tmp_path, monkeypatch
):
    sources = sources_of(('a', 'train'), ('b', 'train'), trial=trial)
    monkeypatch.setattr(evaluation, 'bag_sources', sources)
    with pytest.raises(DatasetError) as caught:
        evaluation.judge_bags(model, [tmp_path])
    assert ' 2 ' in str(caught.value)
    assert caught.value.remedy
