# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac adapt` from recordings to a weight file with its card."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_fger.weights import ModelCard, read_model, write_model
from mixtac_learning.adapt import adaptation
from mixtac_learning.adapt import adaptation as command
from mixtac_learning.adapt.adaptation import run_adaptation
from mixtac_learning.adapt.presses import PressSet
from mixtac_learning.judge.metrics import CalibrationError
from mixtac_learning.network import network_of
from mixtac_learning.train.batches import stack
from mixtac_learning.train.stages import estimate
from mixtac_learning.trials.samples import make_sample


@pytest.fixture
def adapt(model, network, config, trial, tmp_path, monkeypatch):
    """Return the command; its recordings are two presses with 1.5 times the model's own force."""
    sample = make_sample(config, trial, trial.label(), {})
    force = estimate(network, stack([sample]))[0][:, 0].numpy()
    press = replace(sample, force=1.5 * force)
    material = PressSet([press, press], 2.0, 7.0)
    monkeypatch.setattr(command, 'gather_presses', lambda *_: material)
    monkeypatch.setattr(command, 'bag_sources', lambda bag, _topic: [_source(bag)])
    monkeypatch.setattr(adaptation, 'tuned', lambda network, _data: network)
    monkeypatch.setattr(adaptation, 'SHORTEST_PRESSED_S', 0.0)
    monkeypatch.setattr(adaptation, 'fit_scale', lambda *_: 1.5)
    path = tmp_path / 'start.safetensors'
    write_model(path, model)
    out, figures = tmp_path / 'new.safetensors', tmp_path / 'figures.json'
    return partial(run_adaptation, bags=[Path('a')], model=path, out=out, json=figures)


def _source(bag):
    split, _, sensor = bag.name.partition('_')
    origin = {'split': split if split == 'test' else 'train', 'device_seed': sensor}
    return SimpleNamespace(
        name=bag.name, origin=origin, load=lambda: None, load_camera=lambda: None
    )


def test_the_new_model_is_written_with_what_was_done(
    adapt, network, trial, config, tmp_path, capsys
):
    adapt(serial='0042')
    out = tmp_path / 'new.safetensors'
    said = ' '.join(capsys.readouterr().out.split())
    assert 'left out 7 s' in said
    assert 'chosen: gain, gain 1.500' in said
    new = read_model(out)
    sequences = stack([make_sample(config, trial, trial.label(), {})])
    before, after = (estimate(net, sequences)[0].numpy() for net in (network, network_of(new)))
    assert np.abs(after - 1.5 * before).max() < 1e-3
    adapted = new.card.training['adapted']
    assert adapted['from'] == 'start.safetensors'
    assert adapted['bags'] == ['a']
    assert adapted['gain'] == 1.5
    assert new.card.training['sensor_serial'] == '0042'
    figures = json.loads((tmp_path / 'figures.json').read_text())
    assert figures['chosen'] == 'gain'
    assert figures['held_out_mae_gain'] < figures['held_out_mae_unchanged']
    card = out.with_suffix('.md').read_text()
    assert 'adaptation' in card
    assert 'held out mae gain' in card


def test_what_was_known_of_another_sensor_goes(adapt, model, tmp_path):
    card = ModelCard({'sensor_serial': 'A1', 'calibrated': {'gain': 2.0}, 'trials': 7})
    write_model(tmp_path / 'start.safetensors', replace(model, card=card))
    adapt()
    training = read_model(tmp_path / 'new.safetensors').card.training
    assert set(training) == {'trials', 'adapted'}


def test_loads_belong_to_one_recording(adapt):
    with pytest.raises(CalibrationError):
        adapt(bags=[Path('a'), Path('b')], loads=('0.5:1-2',))


@pytest.mark.parametrize('bags', [['test', 'test'], ['a_1', 'a_2']])
def test_recordings_that_do_not_fit_are_refused(adapt, bags):
    with pytest.raises(CalibrationError):
        adapt(bags=[Path(bag) for bag in bags])
