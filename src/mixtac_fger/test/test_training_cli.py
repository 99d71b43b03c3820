# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands end to end, with the toy sensor in place of the simulator."""

from __future__ import annotations

import json

import pytest

from mixtac_fger import generation, training_cli
from mixtac_fger.errors import ModelError
from mixtac_fger.weights import load_model


@pytest.fixture
def simulated(monkeypatch, trial) -> list[str]:
    """Names of the trials that were simulated, each the same toy trial."""
    names: list[str] = []

    def simulate(spec):
        names.append(spec.name)
        return trial

    monkeypatch.setattr(generation, 'simulate', simulate)
    monkeypatch.setattr(generation, 'simulator_digest', lambda: 'toy')
    return names


def test_train_writes_weights_with_their_figures(tmp_path, simulated, capsys):
    out, report = tmp_path / 'small.safetensors', tmp_path / 'report.json'
    options = {
        'out': out,
        'seed': 1,
        'trials': 3,
        'gels': 3,
        'seconds': 6.0,
        'epochs': 6,
        'jobs': 1,
    }
    training_cli.train(**options, data=tmp_path / 'data', json=report)
    card = load_model(out).card
    assert card.training['device_seeds'] == [101_000, 101_002]
    assert card.training['trials'] == 3
    assert set(card.metrics) == {'seen_devices', 'unseen_devices'}
    assert set(card.metrics['unseen_devices']) > {'all', 'press', 'impact'}
    assert json.loads(report.read_text())['metrics'] == card.metrics
    assert 'unseen devices' in capsys.readouterr().out
    kept = sorted(path.name for path in (tmp_path / 'data' / 'toy').iterdir())
    assert kept == sorted(f'{name}.npz' for name in simulated[:3])
    before = len(simulated)
    assert len(list(generation.generate([], load_model(out).config, tmp_path, 1))) == 0
    training_cli.evaluate(str(out), 2, 1, 6.0, report)
    assert len(simulated) > before
    figures = json.loads(report.read_text())['metrics']['unseen_devices']
    assert figures['all']['mae'] == pytest.approx(card.metrics['unseen_devices']['all']['mae'])


def test_samples_on_disk_are_not_simulated_again(tmp_path, simulated, config):
    from mixtac_fger.trial_plan import training_plan

    plan = training_plan(2, 2, 6.0, 0)
    first = list(generation.generate(plan, config, tmp_path, 1))
    again = list(generation.generate(plan, config, tmp_path, 1))
    assert len(simulated) == 2
    assert [sample.origin for sample in again] == [spec.to_dict() for spec in plan]
    assert (first[0].force == again[0].force).all()


def test_evaluating_a_missing_model_simulates_nothing(tmp_path, simulated):
    with pytest.raises(ModelError, match='does not exist'):
        training_cli.evaluate(str(tmp_path / 'no.safetensors'), 2, 1, 6.0, None)
    assert simulated == []
