# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's networks in the estimator node, from a weight file."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_fger.estimator import open_estimator
from mixtac_fger.features import ImageError
from mixtac_fger.reference import TareError
from mixtac_fger.streaming import ForceEstimator, warm_up
from mixtac_fger.weights import ModelCard, read_model, write_model
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import build, paper_model_of


@pytest.fixture(scope='module', params=['fger', 'fusion'])
def weights(request, tmp_path_factory):
    """Return a weight file of a small network with random weights."""
    sizes = {'scale': 8, 'events_per_packet': 16, 'channels': 8, 'lstm_size': 8}
    config = PaperConfig.from_dict({'model': request.param} | sizes)
    path = tmp_path_factory.mktemp(request.param) / 'paper.safetensors'
    write_model(path, paper_model_of(build(config), ModelCard({})))
    return path


def test_a_weight_file_becomes_an_estimator_by_its_architecture(weights):
    model = read_model(weights)
    assert model.architecture == 'fger_paper'
    estimator = open_estimator(model)
    assert warm_up(estimator)
    with pytest.raises(ImageError):
        open_estimator(model).encode(np.zeros((5, 5), np.uint8), 0)


def test_forces_come_per_window_and_there_is_nothing_to_tare(weights, trial):
    estimator = ForceEstimator(open_estimator(read_model(weights)), background_frames=True)
    image = np.minimum(trial.frames[0], 1023).astype(np.uint16) * np.uint16(64)
    assert estimator.push_events(Events.empty(), 100_000) == []
    estimator.push_frame(image, 95_000)
    estimator.drain()
    found = estimator.push_events(trial.events.between(100_000, 120_000), 120_000)
    with pytest.raises(TareError):
        estimator.tare()
    estimator.close()
    assert [each.end_us for each in found] == list(range(102_000, 120_001, 2000))
    assert np.isfinite([each.force for each in found]).all()
    assert {each.deviation for each in found} == {None}
