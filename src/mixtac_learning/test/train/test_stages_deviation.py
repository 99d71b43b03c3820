# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The uncertainty: learned where errors differ, calibrated, the same live as in batches."""

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
from mixtac_learning.train.loop import TrainingError, TrainingLoop
from mixtac_learning.train.stages import (
    DeviationStage,
    Errors,
    calibrate_deviation,
    calibrate_shear,
    collect,
    estimate,
    shear_course,
    train_fger,
)

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


def test_the_sideways_force_is_not_trained_where_no_trial_tells_it(config, toy_sequences):
    shear = replace(config, shear=True)
    brief = TrainingSettings(frame_epochs=1, recurrent_epochs=1, joint_epochs=0, deviation_epochs=1)
    trained, other = toy_sequences
    with pytest.raises(TrainingError):
        train_fger(shear, brief, Groups([trained]))
    blind = replace(
        trained,
        across=0.1 * torch.randn(trained.across.shape),
        frame_across=0.1 * torch.randn(trained.frame_across.shape),
    )
    # Held out trials that do not show it give it no deviation of zero.
    network, _ = train_fger(shear, brief, Groups([blind]), Groups([other]))
    assert (network.shear.deviation[:, 0] > 0.05).all()
