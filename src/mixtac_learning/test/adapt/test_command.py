# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac adapt` from recordings to a weight file with its card."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_fger.weights import load_model, save_model
from mixtac_learning.adapt import adaptation
from mixtac_learning.adapt import adaptation as command
from mixtac_learning.adapt.adaptation import AdaptRequest, run_adaptation
from mixtac_learning.adapt.presses import Material
from mixtac_learning.judge.metrics import CalibrationError
from mixtac_learning.train.batches import stack
from mixtac_learning.train.trainer import estimate
from mixtac_learning.trials.samples import make_sample


@pytest.fixture
def request_of(model, config, trial, tmp_path, monkeypatch):
    """Return a request whose recordings are two presses with 1.5 times the model's own force."""
    sample = make_sample(config, trial, trial.label, {})
    force = estimate(model.network, stack([sample]))[0][:, 0].numpy()
    press = replace(sample, force=1.5 * force)
    material = Material([press, press], 2.0, 7.0)
    monkeypatch.setattr(command, 'gather_presses', lambda *_: material)
    monkeypatch.setattr(command, 'bag_sources', lambda bag, _topic: [_source(bag)])
    monkeypatch.setattr(adaptation, 'tuned', lambda network, _data: network)
    monkeypatch.setattr(adaptation, 'SHORTEST_PRESSED_S', 0.0)
    monkeypatch.setattr(adaptation, 'fit_scale', lambda *_: SimpleNamespace(force_scale=1.5))
    path = tmp_path / 'start.safetensors'
    save_model(path, model.network, model.card)
    return AdaptRequest(
        [Path('a')], path, tmp_path / 'new.safetensors', (), '/w', tmp_path / 'figures.json'
    )


def _source(bag):
    split, _, sensor = bag.name.partition('_')
    origin = {'split': split if split == 'test' else 'train', 'device_seed': sensor}
    return SimpleNamespace(
        name=bag.name, origin=origin, load=lambda: None, load_camera=lambda: None
    )


def test_the_new_model_is_written_with_what_was_done(request_of, model, trial, config, capsys):
    run_adaptation(replace(request_of, serial='0042'))
    said = ' '.join(capsys.readouterr().out.split())
    assert 'left out 7 s' in said
    assert 'chosen: gain, gain 1.500' in said
    new = load_model(request_of.out)
    sequences = stack([make_sample(config, trial, trial.label, {})])
    before, after = (estimate(net, sequences)[0].numpy() for net in (model.network, new.network))
    assert np.abs(after - 1.5 * before).max() < 1e-3
    adapted = new.card.training['adapted']
    assert adapted['from'] == 'start.safetensors'
    assert adapted['bags'] == ['a']
    assert adapted['gain'] == 1.5
    assert new.card.training['sensor_serial'] == '0042'
    figures = json.loads(request_of.json.read_text())
    assert figures['chosen'] == 'gain'
    assert figures['held_out_mae_gain'] < figures['held_out_mae_unchanged']
    card = request_of.out.with_suffix('.md').read_text()
    assert 'adaptation' in card
    assert 'held out mae gain' in card


def test_loads_belong_to_one_recording(request_of):
    asked = replace(request_of, bags=[Path('a'), Path('b')], loads=('0.5:1-2',))
    with pytest.raises(CalibrationError, match='one bag'):
        run_adaptation(asked)


@pytest.mark.parametrize(
    ('bags', 'reason'), [(['test', 'test'], 'test trials'), (['a_1', 'a_2'], '2 sensors')]
)
def test_recordings_that_do_not_fit_are_refused(request_of, bags, reason):
    with pytest.raises(CalibrationError, match=reason):
        run_adaptation(replace(request_of, bags=[Path(bag) for bag in bags]))
