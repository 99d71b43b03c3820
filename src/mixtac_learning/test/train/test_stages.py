# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training on the toy sensor learns it, and gives the same weights for the same seed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from memory_groups import Groups

from mixtac_fger.config import HIGHEST_LOG_DEVIATION, LOWEST_LOG_DEVIATION
from mixtac_fger.recurrent_network import deviation, deviation_weights
from mixtac_learning.network import DeviationHead, FgerNetwork, arrays_of
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.frame_stage import (
    NetworkWithGains,
    Sequences,
    beside_moments,
    encode,
    follow_moments,
    stack,
)
from mixtac_learning.train.loop import TrainingError, TrainingLoop
from mixtac_learning.train.stages import (
    FOLLOWED,
    WINDOWS_AFTER,
    WINDOWS_BEFORE,
    DeviationStage,
    Errors,
    calibrate_deviation,
    calibrate_shear,
    collect,
    estimate,
    follow_frames,
    impacts,
    share_convolutions,
    shear_course,
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
        told = network.correction[0](torch.cat([torch.ones(6, 1), features], dim=1))
        event = network.increment[0].bias + network.context(features)
        found[share] = torch.cat([network.frame.force(features)[:, None], told, event], dim=1)
    torch.testing.assert_close(found[0.5], (found[1.0] + found[0.0]) / 2.0)
    torch.testing.assert_close(found[0.0], found[1.0][:1].expand(6, -1))
    assert changed
    assert (found[1.0] - found[0.5]).abs().max() > 1e-3


def test_the_convolutions_are_scaled_at_the_end_of_a_training_only(config, toy_sequences):
    none = {f'{stage}_epochs': 0 for stage in ('frame', 'recurrent', 'joint', 'deviation')}
    settings, groups = TrainingSettings(**none, convolution_share=0.0), Groups([toy_sequences[1]])
    fresh, _ = train_fger(config, settings, groups)
    assert not fresh.frame.head.weight[:, : config.frame_size].any()
    start = FgerNetwork(config)
    kept = start.frame.head.weight.clone()
    adapted, _ = train_fger(config, settings, groups, start=start)
    assert adapted.frame.head.weight.equal(kept)


STATE = 8


TRIALS = 1000


def tensors_of(head: DeviationHead) -> dict[str, np.ndarray]:
    """Return the head's weights by their names in a weight file."""
    return {f'deviation.{name}': value for name, value in arrays_of(head).items()}


def windows(count: int, seed: int, trials: int = TRIALS) -> Errors:
    """Return errors whose spread is 0.02 N, and 0.2 N where the first state is positive."""
    random = torch.Generator().manual_seed(seed)
    hidden = torch.rand(count, STATE, generator=random) * 2 - 1
    spread = torch.where(hidden[:, 0] > 0, 0.2, 0.02)
    return Errors(
        hidden,
        torch.rand(count, generator=random),
        torch.rand(count, generator=random),
        spread * torch.randn(count, generator=random),
        trials,
    )


@pytest.fixture(scope='module')
def trained():
    """A head that was trained and calibrated on such errors, as a network holds it."""
    torch.manual_seed(0)
    network = SimpleNamespace(deviation=DeviationHead(STATE, 16))
    settings = TrainingSettings(deviation_epochs=40, deviation_rate=3e-2)
    stage = DeviationStage('deviation', 40, 3e-2, SimpleNamespace(network=network), None, settings)
    stage.errors = windows(16000, 1)
    TrainingLoop(network.deviation).run([stage])
    calibrate_deviation(network, windows(8000, 2))
    return network.deviation


def test_intervals_cover_what_they_say(trained):
    fresh = windows(8000, 3)
    with torch.no_grad():
        found = trained(fresh.hidden, fresh.force, fresh.moved)
    for part in (fresh.hidden[:, 0] > 0.3, fresh.hidden[:, 0] < -0.3):
        inside = (fresh.error.abs() <= found)[part].float().mean().item()
        assert inside == pytest.approx(0.683, abs=0.08)
        inside = (fresh.error.abs() <= 1.96 * found)[part].float().mean().item()
        assert inside == pytest.approx(0.95, abs=0.03)


def test_few_trials_make_it_wider():
    """Trials err by a spread of their own; a further trial is covered on average all the same."""
    random = torch.Generator().manual_seed(5)
    network = SimpleNamespace(deviation=DeviationHead(STATE, 16))
    hidden, force = torch.zeros(900, STATE), torch.zeros(900)
    with torch.no_grad():
        unit = float(torch.exp(network.deviation.log_deviation(hidden[:1], force[:1], force[:1])))
    covered = {3: 0.0, TRIALS: 0.0}
    for trials in covered:
        for _ in range(300):
            spreads = torch.exp(0.7 * torch.randn(4, 1, generator=random))
            errors = unit * spreads * torch.randn(4, 300, generator=random)
            known = Errors(hidden, force, force, errors[:3].flatten(), trials)
            scale = calibrate_deviation(network, known)
            inside = errors[3].abs() <= unit * scale
            covered[trials] += float(inside.float().mean()) / 300
    assert covered[TRIALS] < 0.66
    assert covered[3] == pytest.approx(0.683, abs=0.04)


def test_deviations_are_bounded_and_never_infinite():
    head = DeviationHead(2, 3)
    with torch.no_grad():
        for raw, bound in ((1e6, HIGHEST_LOG_DEVIATION), (-1e6, LOWEST_LOG_DEVIATION)):
            head.output.bias.fill_(raw)
            found = head(torch.zeros(1, 2), torch.tensor([1e3]), torch.tensor([1e3]))
            assert float(found[0]) == pytest.approx(np.exp(bound), rel=1e-5)
            one = deviation(np.zeros(2, np.float32), 1e3, 1e3, deviation_weights(tensors_of(head)))
            assert one == pytest.approx(np.exp(bound), rel=1e-5)


def test_collected_errors_are_those_of_the_batch(network, toy_sequences):
    sequences = toy_sequences[1]
    found = collect(network, Groups([sequences]))
    force, _ = estimate(network, sequences)
    errors = (force - sequences.force)[sequences.valid]
    assert found.error.sort().values == pytest.approx(errors.sort().values, abs=1e-6)
    few = collect(network, Groups([sequences]), most=100)
    assert few.error.shape == (100,)
    assert few.hidden.shape == (100, network.config.lstm_size)


def test_deviations_of_the_sideways_force_are_those_of_its_errors(config, toy_sequences):
    torch.manual_seed(7)
    network = FgerNetwork(replace(config, shear=True)).eval()
    with torch.no_grad():
        network.shear.frame.weight.mul_(0.3)
    law = torch.tensor([0.05, 0.2, 0.1])
    value, moved = shear_course(network, toy_sequences[0]).unbind(2)
    spread = (law[0] ** 2 + (law[1] * value) ** 2 + (law[2] * moved) ** 2).sqrt()
    known = replace(toy_sequences[0], across=value + spread * torch.randn(value.shape))
    calibrate_shear(network, Groups([known]))
    floor, share, drift = network.shear.deviation.T
    found = (floor**2 + (share * value) ** 2 + (drift * moved) ** 2).sqrt()
    kept = known.valid
    assert (found[kept] / spread[kept] - 1.0).abs().mean() < 0.05
    torch.testing.assert_close(floor, law[0].expand(3), rtol=0.1, atol=0.0)


def test_the_sideways_force_is_not_trained_where_no_trial_shows_it(config, toy_sequences):
    shear = replace(config, shear=True)
    brief = TrainingSettings(frame_epochs=1, recurrent_epochs=1, joint_epochs=0, deviation_epochs=1)
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
