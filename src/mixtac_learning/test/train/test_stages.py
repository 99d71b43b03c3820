# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training on the toy sensor learns it, and gives the same weights for the same seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.loop import TrainingError
from mixtac_learning.train.sequences import DiskGroups, features_of, stack
from mixtac_learning.train.stages import (
    COVERED,
    WINDOWS_AFTER,
    WINDOWS_BEFORE,
    calibrate_deviations,
    estimate,
    impacts,
    live_course,
    train_fger,
)
from mixtac_learning.trials.samples import make_sample, save_sample

SHORT = TrainingSettings(recurrent_epochs=8)


def test_training_learns_the_toy_sensor(config, toy_groups, toy_sequences, toy_samples):
    stages: list = []
    show = lambda *row: stages.append(row)  # noqa: E731
    network, _ = train_fger(config, SHORT, toy_groups[0], show=show)
    assert [row[:3] for row in stages if row[1] == row[2]] == [('recurrent', 8, 8)]
    for sequences, samples in zip(toy_sequences, (toy_samples[:5], toy_samples[5:]), strict=True):
        truth, valid = sequences.force, sequences.valid
        constant = (truth[valid] - truth[valid].median()).abs().mean()
        shown = torch.from_numpy(np.concatenate([each.frame_force for each in samples]))
        frames = network.frame_force(features_of(network, sequences))
        assert (frames - shown).abs().mean() < 0.5 * constant
        assert (estimate(network, sequences) - truth)[valid].abs().mean() < 0.6 * constant


def test_the_same_seed_gives_the_same_weights(config, toy_groups):
    brief = replace(SHORT, recurrent_epochs=1)
    groups = toy_groups[1]
    runs = [train_fger(config, brief, groups)[0].state_dict() for _ in range(2)]
    assert all(torch.equal(runs[0][name], runs[1][name]) for name in runs[0])
    other = train_fger(config, replace(brief, seed=1), groups)[0].state_dict()
    assert not torch.equal(runs[0]['event.hidden.weight'], other['event.hidden.weight'])


def test_running_in_stretches_equals_running_at_once(config, toy_sequences):
    torch.manual_seed(0)
    sequences = toy_sequences[1]
    network = FgerNetwork(config)
    whole = estimate(network, sequences)
    features, state = features_of(network, sequences), network.initial_state(2)
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
    sample = make_sample(config, trial)
    both = stack([sample, sample], [0, 1], len(sample.force))
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


@pytest.fixture
def shear_network(config):
    torch.manual_seed(7)
    network = FgerNetwork(replace(config, shear=True)).eval()
    for constants in (network.frame.press, network.shear.pull, network.shear.turning):
        constants.fill_(0.3)
    return network


class InMemory(list):
    """Groups that are not on disk."""

    load = list.__getitem__


def laplace(shape) -> torch.Tensor:
    """Return errors of which one deviation covers `COVERED`."""
    size = -np.log(1.0 - COVERED)
    return torch.distributions.Laplace(0.0, 1.0 / size).sample(shape)


def test_deviations_are_those_of_the_errors(shear_network, toy_sequences):
    law = torch.tensor([0.05, 0.2, 0.1])
    value, moved = live_course(shear_network, toy_sequences[0]).unbind(2)
    spread = (law[0] ** 2 + (law[1] * value) ** 2 + (law[2] * moved) ** 2).sqrt()
    noisy = value + spread * laplace(spread.shape)
    known = replace(toy_sequences[0], force=noisy[..., 0], across=noisy[..., 1:])
    calibrate_deviations(shear_network, InMemory([known] * 20))
    laws = [shear_network.deviation, *shear_network.shear.deviation]
    for axis, (floor, share, drift) in enumerate(laws):
        x, change = value[..., axis], moved[..., axis]
        fitted = (floor**2 + (share * x) ** 2 + (drift * change) ** 2).sqrt()
        assert (fitted / spread[..., axis] - 1.0)[known.valid].abs().mean() < 0.08


def test_few_trials_make_them_wider(shear_network, toy_sequences):
    found = []
    for count in (1, 50):
        calibrate_deviations(shear_network, InMemory([toy_sequences[1]] * count))
        found.append(shear_network.deviation.clone())
    assert (found[0] / found[1] > 1.1).all()


def test_the_sideways_force_is_not_trained_where_no_trial_shows_it(
    config, toy_groups, toy_samples, tmp_path
):
    shear = replace(config, shear=True)
    brief = TrainingSettings(recurrent_epochs=1)
    with pytest.raises(TrainingError):
        train_fger(shear, brief, toy_groups[0])
    sample, random = toy_samples[0], np.random.default_rng(0)
    across, of_frames = (
        random.normal(0.0, 0.1, each.shape).astype(np.float32)
        for each in (sample.across, sample.frame_across)
    )
    save_sample(tmp_path / 'shown', replace(sample, across=across, frame_across=of_frames))
    # Held out trials that do not show it give it no deviation of zero.
    network, _ = train_fger(shear, brief, DiskGroups([tmp_path / 'shown'], 1), toy_groups[1])
    assert (network.shear.deviation[:, 0] > 0.05).all()
