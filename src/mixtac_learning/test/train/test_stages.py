# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training on the toy sensor learns it, and gives the same weights for the same seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
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
from mixtac_learning.train.loop import TrainingError
from mixtac_learning.train.stages import (
    COVERED,
    WINDOWS_AFTER,
    WINDOWS_BEFORE,
    calibrate_deviations,
    estimate,
    impacts,
    live_course,
    share_convolutions,
    train_fger,
)
from mixtac_learning.trials.samples import make_sample

SHORT = TrainingSettings(frame_epochs=5, recurrent_epochs=3, joint_epochs=1, frame_batch=16)


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


def test_running_in_stretches_equals_running_at_once(config, toy_sequences):
    torch.manual_seed(0)
    sequences = toy_sequences[1]
    network = FgerNetwork(config)
    whole, _ = estimate(network, sequences)
    features, state = encode(network, sequences), network.initial_state(2)
    parts = []
    with torch.no_grad():
        for start in range(0, len(whole), 37):
            rows = slice(start, start + 37)
            slots = type(sequences.slots)(*(part[rows] for part in sequences.slots))
            events = sequences.event_features[rows].float()
            force, state = network(events, features, slots, state)
            parts.append(force)
    assert torch.allclose(torch.cat(parts), whole, atol=1e-5)


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


def test_a_share_of_the_convolutions_is_left(config):
    torch.manual_seed(1)
    network = FgerNetwork(replace(config, shear=True))
    trained = {name: value.clone() for name, value in network.state_dict().items()}
    frames = torch.randn(6, len(config.frame_channels), *config.frame_shape)
    frames[0] = 0.0
    features = network.frame(frames, torch.zeros(6, 9))
    found = {}
    for share in (1.0, 0.5, 0.0):
        network.load_state_dict(trained)
        share_convolutions(network, share)
        changed = {n for n, value in network.state_dict().items() if not value.equal(trained[n])}
        assert not [n for n in changed if n.startswith(('frame.conv', 'frame.project', 'shear.'))]
        event = network.increment[0].bias + network.context(features)
        found[share] = torch.cat([network.frame.force(features)[:, None], event], dim=1)
    torch.testing.assert_close(found[0.5], (found[1.0] + found[0.0]) / 2.0)
    torch.testing.assert_close(found[0.0], found[1.0][:1].expand(6, -1))
    assert changed
    assert (found[1.0] - found[0.5]).abs().max() > 1e-3


def test_the_convolutions_are_scaled_at_the_end_of_a_training_only(config, toy_sequences):
    none = {f'{stage}_epochs': 0 for stage in ('frame', 'recurrent', 'joint')}
    settings, groups = TrainingSettings(**none, convolution_share=0.0), Groups([toy_sequences[1]])
    fresh, _ = train_fger(config, settings, groups)
    assert not fresh.frame.head.weight[:, : config.frame_size].any()
    start = FgerNetwork(config)
    kept = start.frame.head.weight.clone()
    adapted, _ = train_fger(config, settings, groups, start=start)
    assert adapted.frame.head.weight.equal(kept)


@pytest.fixture
def shear_network(config):
    torch.manual_seed(7)
    network = FgerNetwork(replace(config, shear=True)).eval()
    with torch.no_grad():
        network.shear.frame.weight.mul_(0.3)
    return network


def laplace(shape) -> torch.Tensor:
    """Return errors of which one deviation covers `COVERED`."""
    size = -np.log(1.0 - COVERED)
    return torch.distributions.Laplace(0.0, 1.0 / size).sample(shape)


def test_deviations_are_those_of_the_errors(shear_network, toy_sequences):
    law = torch.tensor([0.05, 0.2, 0.1])
    found = live_course(shear_network, toy_sequences[0])
    value, moved = found.across.unbind(2)
    wide = (law[0] ** 2 + (law[1] * found.force) ** 2 + (law[2] * found.moved) ** 2).sqrt()
    spread = (law[0] ** 2 + (law[1] * value) ** 2 + (law[2] * moved) ** 2).sqrt()
    known = replace(
        toy_sequences[0],
        force=found.force + wide * laplace(wide.shape),
        across=value + spread * laplace(spread.shape),
    )
    calibrate_deviations(shear_network, Groups([known] * 20))
    for each, (x, change), expected in (
        (shear_network.deviation, (found.force, found.moved), wide),
        (shear_network.shear.deviation[0], (value[..., 0], moved[..., 0]), spread[..., 0]),
        (shear_network.shear.deviation[2], (value[..., 2], moved[..., 2]), spread[..., 2]),
    ):
        floor, share, drift = each
        fitted = (floor**2 + (share * x) ** 2 + (drift * change) ** 2).sqrt()
        assert (fitted[known.valid] / expected[known.valid] - 1.0).abs().mean() < 0.08


def test_few_trials_make_them_wider(shear_network, toy_sequences):
    found = []
    for count in (1, 50):
        calibrate_deviations(shear_network, Groups([toy_sequences[1]] * count))
        found.append(shear_network.deviation.clone())
    assert (found[0] / found[1] > 1.1).all()


def test_the_sideways_force_is_not_trained_where_no_trial_shows_it(config, toy_sequences):
    shear = replace(config, shear=True)
    brief = TrainingSettings(frame_epochs=1, recurrent_epochs=1, joint_epochs=0)
    trained, other = toy_sequences
    with pytest.raises(TrainingError):
        train_fger(shear, brief, Groups([trained]))
    shown = replace(
        trained,
        across=0.1 * torch.randn(trained.across.shape),
        frame_across=0.1 * torch.randn(trained.frame_across.shape),
    )
    # Held out trials that do not show it give it no deviation of zero.
    network, _ = train_fger(shear, brief, Groups([shown]), Groups([other]))
    assert (network.shear.deviation[:, 0] > 0.05).all()
