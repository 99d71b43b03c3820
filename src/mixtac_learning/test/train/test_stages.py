# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training on the toy sensor learns it, and gives the same weights for the same seed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
import torch

from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.batches import MemoryGroups, Sequences
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.loop import TrainingLoop
from mixtac_learning.train.stages import encode, estimate, train_fger

SHORT = TrainingSettings(
    frame_epochs=12, recurrent_epochs=8, joint_epochs=2, deviation_epochs=4, frame_batch=16
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
    loop = partial(TrainingLoop, report=lambda *row: stages.append(row))
    network, _ = train_fger(config, SHORT, MemoryGroups(trained), make_loop=loop)
    assert [row[:3] for row in stages if row[1] == row[2]] == [
        ('frames', 12, 12),
        ('recurrent', 8, 8),
        ('joint', 2, 2),
        ('deviation', 4, 4),
    ]
    for sequences in (trained, other):
        fused, frames, constant = errors(network, sequences)
        assert frames < 0.5 * constant
        assert fused < 0.6 * constant


def test_the_same_seed_gives_the_same_weights(config, toy_sequences):
    brief = replace(SHORT, frame_epochs=1, recurrent_epochs=1, joint_epochs=1)
    groups = MemoryGroups(toy_sequences[1])
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
            force, _, state = network(events, features, slots, state)
            parts.append(force)
    assert torch.allclose(torch.cat(parts), whole, atol=1e-5)
