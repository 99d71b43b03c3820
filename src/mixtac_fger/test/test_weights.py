# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weight files: round trip, and one clear line for each way they can be wrong."""

from __future__ import annotations

import json

import pytest
import torch
from safetensors.torch import load_file, save_file

from mixtac_fger.config import ConfigError, FgerConfig, ModelError
from mixtac_fger.weights import ModelCard, find_model, load_model, save_model, shipped_models
from mixtac_learning.network import FgerNetwork


@pytest.fixture
def saved(tmp_path):
    network = FgerNetwork(FgerConfig(lstm_size=16))
    path = tmp_path / 'deep' / 'model.safetensors'
    save_model(path, network, ModelCard({'seed': 4}, {'all': {'mae': 0.03}}))
    return path, network


def rewritten(path, tensors=None, **header):
    from safetensors import safe_open

    with safe_open(path, framework='pt') as file:
        metadata = {**file.metadata(), **header}
    save_file(tensors or load_file(path), path, metadata=metadata)
    return path


def refusal(path) -> str:
    with pytest.raises(ModelError) as caught:
        load_model(path)
    text = str(caught.value)
    assert str(path) in text
    assert 'mixtac train' in text
    assert '\n' not in text
    return text


def test_what_was_saved_is_loaded(saved):
    path, network = saved
    loaded = load_model(path)
    assert loaded.config == network.config
    assert loaded.card == ModelCard({'seed': 4}, {'all': {'mae': 0.03}})
    assert not loaded.network.training
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, loaded.network.state_dict()[name])
    assert [entry.name for entry in path.parent.iterdir()] == ['model.safetensors']


def test_a_missing_file_is_named(tmp_path):
    text = refusal(tmp_path / 'no.safetensors')
    assert 'does not exist, but fger_small version 1 is needed' in text


def test_another_architecture_is_named(saved):
    assert 'holds resnet18 version 1' in refusal(rewritten(saved[0], architecture='resnet18'))


def test_another_version_is_named(saved):
    assert 'holds fger_small version 0' in refusal(rewritten(saved[0], version='0'))


def test_a_file_without_our_header_is_named(tmp_path):
    path = tmp_path / 'bare.safetensors'
    save_file({'w': torch.zeros(1)}, path)
    assert 'no architecture' in refusal(path)


@pytest.mark.parametrize('value', [float('nan'), float('inf')])
def test_numbers_that_are_not_finite_are_named(saved, value):
    path, _ = saved
    tensors = load_file(path)
    tensors['correction.2.bias'][0] = value
    assert 'tensor correction.2.bias holds numbers' in refusal(rewritten(path, tensors))


def test_another_shape_is_named(saved):
    path, _ = saved
    tensors = load_file(path)
    tensors['correction.2.bias'] = torch.zeros(7)
    assert 'tensor correction.2.bias has shape (7,)' in refusal(rewritten(path, tensors))


def test_a_missing_tensor_is_named(saved):
    path, _ = saved
    tensors = load_file(path)
    del tensors['event.hidden.bias']
    assert 'tensor event.hidden.bias has shape None' in refusal(rewritten(path, tensors))


@pytest.mark.parametrize('content', [b'', b'not a model', b'\xff' * 64])
def test_another_kind_of_file_is_named(tmp_path, content):
    path = tmp_path / 'photo.safetensors'
    path.write_bytes(content)
    assert 'not a safetensors file' in refusal(path)


@pytest.mark.parametrize('config', ['{', '[]', '{"width": 1}', 'null'])
def test_an_unusable_configuration_is_named(saved, config):
    assert 'header that cannot be used' in refusal(rewritten(saved[0], config=config))


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('width', 0),
        ('log_floor', -1.0),
        ('gradient_bin', 3),
        ('frame_channels', ('colour',)),
        ('frame_channels', ()),
        ('correction_point', 'never'),
    ],
)
def test_impossible_configurations_are_refused(field, value):
    with pytest.raises(ConfigError, match='FgerConfig'):
        FgerConfig(**{field: value})


def test_configurations_survive_json():
    config = FgerConfig(frame_channels=('frame', 'difference'), lstm_size=7)
    assert FgerConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_models_are_found_by_name_and_by_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_model('fger_small') == shipped_models() / 'fger_small.safetensors'
    assert find_model('some/where.safetensors').parts == ('some', 'where.safetensors')
    (tmp_path / 'mine.safetensors').write_bytes(b'')
    assert find_model('mine.safetensors').exists()
