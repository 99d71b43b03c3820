# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training on the toy sensor learns it, and gives the same weights for the same seed."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
import torch
from memory_groups import Groups

from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.frame_stage import Sequences, encode
from mixtac_learning.train.loop import Processes
from mixtac_learning.train.stages import estimate, impacts, train_fger

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


@dataclass
class Meeting:
    """Where two threads exchange values, as processes would."""

    barrier: threading.Barrier = field(default_factory=lambda: threading.Barrier(2, timeout=60))
    brought: dict[int, tuple[str, Any]] = field(default_factory=dict)

    def swap(self, rank: int, what: str, value: Any) -> list[Any]:
        self.brought[rank] = what, value
        self.barrier.wait()
        found = [self.brought[each] for each in range(2)]
        self.barrier.wait()
        assert {name for name, _ in found} == {what}
        return [each for _, each in found]


@dataclass(frozen=True)
class Member(Processes):
    """One of two threads."""

    meeting: Meeting = field(default_factory=Meeting)

    def mean(self, tensor: torch.Tensor) -> torch.Tensor:
        return torch.stack(self.meeting.swap(self.rank, 'mean', tensor.detach().clone())).mean(0)

    def smallest(self, number: int) -> int:
        return min(self.meeting.swap(self.rank, 'smallest', number))

    def wait(self) -> None:
        self.meeting.swap(self.rank, 'wait', None)


def test_processes_with_unequal_data_stay_in_step(config, toy_sequences):
    trained, other = toy_sequences
    brief = replace(SHORT, frame_epochs=1, recurrent_epochs=2, blow_every=2)
    devices = Groups([trained]).devices
    assert len(trained.frame_force) != len(other.frame_force)
    blow = torch.zeros_like(trained.force)
    blow[40:60] = 5.0
    struck = replace(trained, force=blow)
    assert impacts(struck) is not None
    assert impacts(other) is None
    data = [Groups([struck, other], devices), Groups([other], devices)]
    meeting = Meeting()

    def train(rank: int) -> dict[str, torch.Tensor]:
        member = Member(rank, 2, meeting)
        found, _ = train_fger(config, brief, data[rank], processes=member)
        return found.state_dict()

    with ThreadPoolExecutor(2) as threads:
        assert all(threads.map(train, range(2)))
