# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A gain that is folded into the weights multiplies forces and deviations, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from toy_sensor import estimates

from mixtac_fger.config import ModelError
from mixtac_fger.fger_net import with_gain
from mixtac_fger.weights import Model, ModelCard, read_model, save_model


def forces(model, trial):
    """Return forces and deviations of a trial, [T, 2]."""
    return np.array([(each.force, each.deviation) for each in estimates(model, trial)])


@pytest.mark.parametrize('gain', [0.3, 1.0, 2.0])
def test_forces_are_multiplied_and_their_reasons_stay(model, trial, gain, monkeypatch):
    monkeypatch.setattr('mixtac_fger.streaming.LOWEST_FORCE', -0.01)
    monkeypatch.setattr('mixtac_fger.streaming.HIGHEST_FORCE', 0.01)
    before = {name: np.array(tensor) for name, tensor in model.tensors.items()}
    plain = forces(model, trial)
    assert len(plain) > 300
    assert np.abs(plain[:, 0]).max() > 0.01
    scaled = forces(with_gain(model, gain), trial)
    assert scaled == pytest.approx(gain * plain, rel=1e-4, abs=1e-5)
    for name, tensor in model.tensors.items():
        assert (tensor == before[name]).all()
    reasons = [
        [each.reason for each in estimates(m, trial)] for m in (model, with_gain(model, gain))
    ]
    assert reasons[0] == reasons[1]
    assert len(set(reasons[0])) > 1


def test_impossible_gains_and_other_architectures_are_refused(model):
    other = Model('another', 1, model.config, model.card, model.tensors)
    for wrong, gain in ((model, 0.0), (model, float('nan')), (model, float('inf')), (other, 2.0)):
        with pytest.raises(ModelError):
            with_gain(wrong, gain)


def test_a_scaled_model_is_written_and_read_back(model, tmp_path):
    scaled = with_gain(model, 1.7)
    card = ModelCard({'calibrated': {'gain': 1.7, 'gel': 'soft'}}, {})
    path = tmp_path / 'mine.safetensors'
    save_model(
        path, Model(scaled.architecture, scaled.version, scaled.config, card, scaled.tensors)
    )
    found = read_model(path)
    assert found.card.training == card.training
    for name, tensor in scaled.tensors.items():
        assert (found.tensors[name] == tensor).all()
    assert 'soft' in path.with_suffix('.md').read_text()
