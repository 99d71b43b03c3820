# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training on the toy sensor learns it, and gives the same weights for the same seed."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from memory_groups import Groups

from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.frame_stage import (
    NetworkWithGains,
    Sequences,
    beside_moments,
    encode,
    follow_moments,
    stack,
)
from mixtac_learning.train.stages import (
    FOLLOWED,
    WINDOWS_AFTER,
    WINDOWS_BEFORE,
    estimate,
    follow_frames,
    impacts,
    train_fger,
)
from mixtac_learning.trials.samples import make_sample

SHORT = TrainingSettings(
    frame_epochs=5, recurrent_epochs=3, joint_epochs=1, deviation_epochs=1, frame_batch=16
)


def errors(network: FgerNetwork, sequences: Sequences) -> tuple[float, float, float]:
    """Return the mean absolute errors of the fused force, of frames alone, of a constant."""
    force, frames = estimate(network, sequences)
    truth = sequences.force[sequences.valid]
    return (
        (force[sequences.valid] - truth).abs().mean().item(),
        (frames - sequences.frame_force).abs().mean().item(),
        (truth - truth.median()).abs().mean().item(),
    )


def test_training_learns_the_toy_sensor(config, toy_sequences):
    trained, other = toy_sequences
    stages: list = []
    show = lambda *row: stages.append(row)  # noqa: E731
    network, _ = train_fger(config, SHORT, Groups([trained]), show=show)
    assert [row[:3] for row in stages if row[1] == row[2]] == [
        ('frames', 5, 5),
        ('recurrent', 3, 3),
        ('joint', 1, 1),
        ('deviation', 1, 1),
    ]
    for sequences in (trained, other):
        fused, frames, constant = errors(network, sequences)
        assert frames < 0.5 * constant
        assert fused < 0.6 * constant


def test_the_same_seed_gives_the_same_weights(config, toy_sequences):
    brief = replace(SHORT, frame_epochs=1, recurrent_epochs=1)
    groups = Groups([toy_sequences[1]])
    runs = [train_fger(config, brief, groups)[0].state_dict() for _ in range(2)]
    assert all(torch.equal(runs[0][name], runs[1][name]) for name in runs[0])
    other = train_fger(config, replace(brief, seed=1), groups)[0].state_dict()
    assert not torch.equal(runs[0]['event.hidden.weight'], other['event.hidden.weight'])


@pytest.mark.parametrize('point', ['exposure_centre', 'arrival'])
def test_running_in_stretches_equals_running_at_once(config, toy_sequences, point):
    torch.manual_seed(0)
    sequences = toy_sequences[1]
    network = FgerNetwork(replace(config, correction_point=point))
    whole, _ = estimate(network, sequences)
    features, state = encode(network, sequences), network.initial_state(2)
    parts = []
    with torch.no_grad():
        for start in range(0, len(whole), 37):
            rows = slice(start, start + 37)
            slots = type(sequences.slots)(*(part[rows] for part in sequences.slots))
            events = sequences.event_features[rows].float()
            force, *_, state = network(events, features, slots, state)
            parts.append(force)
    assert torch.allclose(torch.cat(parts), whole, atol=1e-5)


def test_the_start_follows_the_frames(config):
    torch.manual_seed(1)
    network = FgerNetwork(config)
    follow_frames(network)
    features = torch.rand(20, config.feature_size)
    with torch.no_grad():
        known = network.frame.force(features)
        for estimate in (-1.0, 0.0, 2.0):
            before = torch.full((20,), estimate)
            change = network.correction(torch.cat([before[:, None], features], dim=1))[:, 0]
            wanted = FOLLOWED * (known - before)
            assert (change - wanted).abs().max() < 0.1
            assert torch.corrcoef(torch.stack([change, wanted]))[0, 1] > 0.8


@pytest.fixture
def sequences(config, trial):
    """One trial twice, with made-up forces: zero, and blows of one window."""
    both = stack([make_sample(config, trial) for _ in range(2)])
    force = torch.zeros_like(both.force)
    force[100, 0] = force[300, 0] = force[20, 0] = 8.0
    force[200:204, 1] = 5.0
    force[250, 1], force[300:330, 1], force[331, 1] = 2.0, 1.0, 6.0
    return replace(both, force=force)


def test_blows_out_of_nothing_are_cut_out(sequences):
    found = impacts(sequences)
    assert found is not None
    # Not the one at 20, which the trial begins too late for, nor the one on top of a press.
    assert found.force.shape == (WINDOWS_BEFORE + WINDOWS_AFTER, 3)
    for column, (start, trial) in enumerate(((70, 0), (170, 1), (270, 0))):
        rows = slice(start, start + WINDOWS_BEFORE + WINDOWS_AFTER)
        assert torch.equal(found.force[:, column], sequences.force[rows, trial])
        assert torch.equal(found.event_features[:, column], sequences.event_features[rows, trial])
        assert torch.equal(found.slots.frame[:, column], sequences.slots.frame[rows, trial])
    assert found.device.tolist() == [0, 1, 0]


def test_trials_without_blows_give_none(sequences):
    assert impacts(replace(sequences, force=torch.ones_like(sequences.force))) is None


def test_frames_begin_with_the_forces_of_their_moments(config, trial):
    torch.manual_seed(1)
    model = NetworkWithGains(replace(config, shear=True), 1)
    network = model.network
    known = stack([make_sample(config, trial)])
    moments = torch.randn(known.frame_moments.shape)
    across = torch.stack([2.0 * moments[:, 1] + moments[:, 3], 2.0 * moments[:, 2] + moments[:, 4]])
    across = torch.cat([across.T, torch.zeros(len(moments), 1)], dim=1)
    across[0] = torch.nan
    known = replace(
        known, frame_moments=moments, frame_force=-0.5 * moments[:, 0], frame_across=across
    )
    model.fit_scales(known)
    follow_moments(network, known)
    with torch.no_grad():
        features = network.frame(known.frame_inputs.float(), moments)
        torch.testing.assert_close(network.frame.force(features), known.frame_force)
        shown = network.shear.shown(features)[1:, :2]
        torch.testing.assert_close(shown, across[1:, :2], rtol=1e-4, atol=1e-4)
        assert beside_moments(network, features) == 0.0
        network.frame.head.bias += 3.0
        torch.testing.assert_close(beside_moments(network, features), torch.tensor(3.0))
