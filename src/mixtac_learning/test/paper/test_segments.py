# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials that run side by side give what each gives alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_learning.paper.config import MODELS, PaperConfig
from mixtac_learning.paper.networks import build
from mixtac_learning.paper.samples import PaperSample, make_paper_sample, run_samples
from mixtac_learning.train.paper_stage import fit_scales

SMALL = {'scale': 16, 'events_per_packet': 16, 'channels': 8, 'blocks': 1, 'lstm_size': 8}


def cut(sample: PaperSample, windows: int) -> PaperSample:
    return replace(
        sample,
        window_end_us=sample.window_end_us[:windows],
        starts=sample.starts[: windows + 1],
        slots=sample.slots[:windows],
        force=sample.force[:windows],
    )


@pytest.mark.parametrize('model', MODELS)
def test_trials_side_by_side_are_those_alone(trial, model):
    config = PaperConfig.from_dict({'model': model} | SMALL)
    whole = make_paper_sample(config, trial)
    samples = [cut(whole, 310), whole, cut(whole, 64), cut(whole, 310), cut(whole, 0)]
    network = build(config).eval()
    fit_scales(network, [whole])
    found = run_samples(network, samples)
    alone = [run_samples(network, [each])[0] for each in samples]
    assert [len(each) for each in found] == [len(each.force) for each in samples]
    for together, single in zip(found, alone, strict=True):
        assert np.allclose(together, single, atol=1e-4)
    assert np.std(found[1]) > 0.0
