# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where the frame network begins: with the forces of the moments."""

from __future__ import annotations

from dataclasses import replace

import torch

from mixtac_learning.train.batches import stack
from mixtac_learning.train.frame_stage import NetworkWithGains, beside_moments, follow_moments
from mixtac_learning.train.parallel import Processes
from mixtac_learning.trials.samples import make_sample


def test_frames_begin_with_the_forces_of_their_moments(config, trial):
    torch.manual_seed(1)
    model = NetworkWithGains(replace(config, shear=True), 1)
    network = model.network
    known = stack([make_sample(config, trial, trial.label(), {})])
    moments = torch.randn(known.frame_moments.shape)
    across = torch.stack([2.0 * moments[:, 1] + moments[:, 3], 2.0 * moments[:, 2] + moments[:, 4]])
    across = torch.cat([across.T, torch.zeros(len(moments), 1)], dim=1)
    across[0] = torch.nan
    known = replace(
        known, frame_moments=moments, frame_force=-0.5 * moments[:, 0], frame_across=across
    )
    model.fit_scales(known)
    follow_moments(network, known, Processes())
    with torch.no_grad():
        features = network.frame(known.frame_inputs.float(), moments)
        torch.testing.assert_close(network.frame.force(features), known.frame_force)
        shown = network.shear.shown(features)[1:, :2]
        torch.testing.assert_close(shown, across[1:, :2], rtol=1e-4, atol=1e-4)
        assert beside_moments(network, features) == 0.0
        network.frame.head.bias += 3.0
        torch.testing.assert_close(beside_moments(network, features), torch.tensor(3.0))
