# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weight files: round trip, and one clear line for each way they can be wrong."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file
from toy_sensor import random_model

from mixtac_fger.config import (
    ConfigError,
    FgerConfig,
    ModelError,
    count_parameters,
    tensor_shapes,
)
from mixtac_fger.estimator import open_estimator
from mixtac_fger.weights import ModelCard, find_model, read_model, shipped_models, write_model


@pytest.fixture
def saved(tmp_path):
    card = ModelCard({'seed': 4}, {'all': {'mae': 0.03}})
    model = replace(random_model(FgerConfig(lstm_size=16)), card=card)
    path = tmp_path / 'deep' / 'model.safetensors'
    write_model(path, model)
    return path, model


def rewritten(path, tensors=None, **header):
    from safetensors import safe_open

    with safe_open(path, framework='np') as file:
        metadata = {**file.metadata(), **header}
    save_file(tensors or load_file(path), path, metadata=metadata)
    return path


def refusal(path) -> str:
    """Return the one line that opening a file fails with."""
    with pytest.raises(ModelError) as caught:
        open_estimator(read_model(path))
    assert caught.value.remedy
    assert '\n' not in str(caught.value)
    return str(caught.value)


def test_what_was_saved_is_loaded(saved):
    path, model = saved
    loaded = read_model(path)
    assert loaded.config == model.config
    assert loaded.card == model.card
    assert (loaded.architecture, loaded.version) == (model.architecture, model.version)
    assert set(loaded.tensors) == set(model.tensors)
    for name, tensor in model.tensors.items():
        assert np.array_equal(tensor, loaded.tensors[name])
    assert [entry.name for entry in path.parent.iterdir()] == ['model.safetensors']
    # A view is written as it looks.
    write_model(path, replace(model, tensors={'w': np.arange(6).reshape(2, 3).T}))
    assert read_model(path).tensors['w'].tolist() == [[0, 3], [1, 4], [2, 5]]


def test_the_shipped_model_has_the_shapes_of_its_configuration():
    model = read_model(find_model('fger_small'))
    config = FgerConfig.from_dict(model.config)
    assert {name: each.shape for name, each in model.tensors.items()} == tensor_shapes(config)
    assert count_parameters(config) == 29_658


def test_files_that_are_no_models_are_named(tmp_path):
    bare = tmp_path / 'bare.safetensors'
    save_file({'w': np.zeros(1)}, bare)
    for path in (bare, tmp_path / 'no.safetensors'):
        assert str(path) in refusal(path)
    for content in (b'', b'not a model', b'\xff' * 64):
        bare.write_bytes(content)
        assert str(bare) in refusal(bare)


def test_another_architecture_or_version_is_named(saved):
    assert 'version 0' in refusal(rewritten(saved[0], version='0'))
    text = refusal(rewritten(saved[0], architecture='resnet18'))
    assert 'resnet18' in text
    assert 'fger_small' in text


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('increment.2.bias', [float('nan')]),
        ('increment.2.bias', [float('inf')]),
        ('increment.2.bias', [0.0] * 7),
        ('event.hidden.bias', None),
        ('event.scale', [0.0] * 4),
        ('frame.spread', [0.0] * 9),
    ],
)
def test_tensors_that_cannot_be_used_are_named(saved, name, value):
    tensors = load_file(saved[0])
    del tensors[name]
    if value is not None:
        tensors[name] = np.array(value, np.float32)
    assert name in refusal(rewritten(saved[0], tensors))


def test_numbers_that_numpy_does_not_know_are_refused(saved):
    path, _ = saved
    content = path.read_bytes()
    size = int.from_bytes(content[:8], 'little')
    head = json.loads(content[8 : 8 + size])
    head['increment.2.bias'].update(dtype='BF16', data_offsets=[0, 2])
    text = json.dumps({k: head[k] for k in ('__metadata__', 'increment.2.bias')}).encode()
    path.write_bytes(len(text).to_bytes(8, 'little') + text + bytes(2))
    assert str(path) in refusal(path)


@pytest.mark.parametrize(
    'config', ['{', '[]', '{"width": 1}', 'null', pytest.param('[' * 100_000, id='nested')]
)
def test_an_unusable_configuration_is_named(saved, config):
    refusal(rewritten(saved[0], config=config))


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('width', 0),
        ('log_floor', -1.0),
        ('gradient_bin', 3),
        ('force_unit', float('nan')),
        ('reference_stillness', float('inf')),
        ('history_windows', 1),
        ('history_windows', 10**9),
        ('reference_frames', 1 << 63),
    ],
)
def test_impossible_configurations_are_refused(field, value):
    with pytest.raises(ConfigError) as caught:
        FgerConfig(**{field: value})
    assert field in str(caught.value)


def test_configurations_survive_json():
    config = FgerConfig(shear=True, lstm_size=7)
    assert FgerConfig.from_dict(json.loads(json.dumps(asdict(config)))) == config


def test_models_are_found_by_name_and_by_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_model('fger_small') == shipped_models() / 'fger_small.safetensors'
    assert find_model('some/where.safetensors').parts == ('some', 'where.safetensors')
    (tmp_path / 'mine.safetensors').write_bytes(b'')
    assert find_model('mine.safetensors').exists()
