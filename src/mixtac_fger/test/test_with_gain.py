# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A gain that is folded into the weights multiplies forces and deviations, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_fger.config import ModelError
from mixtac_fger.fger_net import FgerEstimator, with_gain
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.weights import Model, ModelCard, read_model, save_model


def estimates(model, trial):
    """Return forces and deviations of a trial, [T, 2]."""
    estimator = ForceEstimator(FgerEstimator(model))
    rows, start = [], 0
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    for image, mid_us, arrival_us in zip(
        trial.frames, middle.tolist(), trial.arrival_us.tolist(), strict=True
    ):
        rows += estimator.push_events(trial.events.between(start, arrival_us), arrival_us)
        start = arrival_us
        estimator.push_frame(image * np.uint16(64), mid_us)
    return np.array([(each.force, each.deviation or 0.0) for each in rows])


@pytest.mark.parametrize('gain', [0.3, 1.0, 2.0])
def test_forces_are_multiplied(model, trial, gain):
    before = {name: np.array(tensor) for name, tensor in model.tensors.items()}
    plain = estimates(model, trial)
    assert len(plain) > 300
    assert np.abs(plain[:, 0]).max() > 0.01
    scaled = estimates(with_gain(model, gain), trial)
    assert scaled == pytest.approx(gain * plain, rel=1e-4, abs=1e-5)
    for name, tensor in model.tensors.items():
        assert (tensor == before[name]).all()


def test_deviations_can_be_narrowed_beside_the_gain(model):
    narrow, wide = (with_gain(model, 2.0, deviation) for deviation in (0.5, 1.0))
    for name, tensor in wide.tensors.items():
        factor = 0.5 if name == 'deviation.scale' else 1.0
        assert narrow.tensors[name] == pytest.approx(factor * tensor)


def test_impossible_gains_and_other_architectures_are_refused(model):
    for gain in (0.0, -1.0, float('nan'), float('inf')):
        with pytest.raises(ModelError):
            with_gain(model, gain)
    other = Model('another', 1, model.config, model.card, model.tensors)
    with pytest.raises(ModelError):
        with_gain(other, 2.0)


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
