# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live estimator of FGER-Net against the torch network over whole trials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_fger.force_path import EventGains
from mixtac_learning.judge.estimators import stream, windows_of
from mixtac_learning.train.sequences import stack
from mixtac_learning.train.stages import estimate
from mixtac_learning.trials.samples import make_sample
from mixtac_learning.trials.trial import ForceLabel


@pytest.fixture
def exact(monkeypatch):
    """Compare the live estimator with the batch network, which neither rounds nor learns."""
    monkeypatch.setattr('mixtac_learning.trials.samples.STORED', np.float32)
    monkeypatch.setattr('mixtac_fger.fger_net.SPREAD_WINDOWS', 1)
    monkeypatch.setattr(EventGains, 'PRIOR', (1.0, 0.0))
    monkeypatch.setattr(EventGains, 'PRIOR_N', 1e6)
    monkeypatch.setattr('mixtac_fger.force_path.BLOW_N', 1e6)


@pytest.mark.usefixtures('exact')
def test_streaming_equals_the_batch_network(model, network, config, trial):
    # Samples are kept as float16 on disk; the two paths are compared without that rounding.
    sample = make_sample(config, trial)
    force = estimate(network, stack([sample], [0], len(sample.force)))
    run = stream(model, trial)
    assert np.abs(run.force - force[:, 0].numpy()).max() < 1e-5
    assert np.array_equal(run.t_us, sample.window_end_us)
    assert np.ptp(run.force) > 0.3


def test_the_deviation_is_made_of_floor_shares_and_what_is_pending(model, trial, monkeypatch):
    monkeypatch.setattr('mixtac_fger.fger_net.SPREAD_WINDOWS', 1)
    floor, share = 0.2, 0.3
    tensors = {**model.tensors, 'deviation': np.array([floor, share, 0.0], np.float32)}
    run = stream(replace(model, tensors=tensors), trial)
    np.testing.assert_allclose(run.deviation, np.hypot(floor, share * run.force), rtol=1e-6)
    tensors['deviation'] = np.zeros(3, np.float32)
    assert stream(replace(model, tensors=tensors), trial).deviation is None


def test_nothing_is_estimated_where_packets_were_lost(model, trial):
    whole = stream(model, trial)
    begin, end = (int(trial.arrival_us[k]) + 500 for k in (10, 20))
    holed = stream(model, replace(trial, gaps_us=[(begin, end)]))
    inside = (whole.t_us > begin) & (whole.t_us <= end)
    assert inside.any()
    assert not ((holed.t_us > begin) & (holed.t_us <= end)).any()
    before = whole.t_us <= begin
    assert np.array_equal(holed.force[holed.t_us <= begin], whole.force[before])
    assert holed.t_us[-1] == whole.t_us[-1]


def test_forces_from_long_before_the_camera_make_no_windows(trial):
    label = trial.truth
    early = ForceLabel(np.append(-3.6e7, label.t_us), np.append(0.0, label.force))
    found, wanted = windows_of(replace(trial, truth=early), 2000), windows_of(trial, 2000)
    assert [each.end_us for each in found] == [each.end_us for each in wanted]
