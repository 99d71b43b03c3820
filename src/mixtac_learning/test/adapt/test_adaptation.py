# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A model is adapted by presses as far as they ask for it, and not where nothing explains them."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mixtac_fger.config import ModelError
from mixtac_learning.adapt import adaptation
from mixtac_learning.adapt.adaptation import adapt, choose, side_by_side, tuned, with_gain
from mixtac_learning.adapt.presses import (
    Load,
    cut_presses,
    folds,
    gather_presses,
    known_windows,
    load_label,
    parse_load,
    part_of,
)
from mixtac_learning.judge.metrics import CalibrationError
from mixtac_learning.train.batches import stack
from mixtac_learning.train.stages import estimate
from mixtac_learning.trials.samples import make_sample


def outputs(network, sample):
    """Return force and deviation of a sample, [T] each."""
    sequences = stack([replace(sample, force=np.zeros_like(sample.force))])
    state = network.initial_state(1)
    with torch.no_grad():
        features = network.frame(sequences.frame_inputs.float(), sequences.frame_moments)
        events = sequences.event_features.float()
        course = network(events, features, sequences.slots, state)
        deviation = network.deviation(course.hidden, course.force, course.moved)
    return course.force[:, 0].numpy(), deviation[:, 0].numpy()


@pytest.fixture(scope='module')
def sample(config, trial):
    return make_sample(config, trial, trial.label(), {})


@pytest.fixture(scope='module')
def following(network, sample):
    """A network that gives out a sum of the frame feature, which a press changes, and no more."""
    built = copy.deepcopy(network)
    hidden, _, output = built.correction
    with torch.no_grad():
        for layer in (hidden, output, built.increment[2]):
            layer.weight.zero_()
            layer.bias.zero_()
        # 0.8 (c sum f - d - F), out of two rectified halves; c and d stretch it to 0 to 1 N.
        inputs = torch.from_numpy(sample.frame_inputs).float()
        features = built.frame(inputs, torch.from_numpy(sample.frame_moments)).sum(1)
        c = 1.0 / (features.max() - features.min())
        hidden.weight[0] = torch.tensor([-1.0] + [c] * built.config.feature_size)
        hidden.bias[0] = -c * features.min()
        hidden.weight[1], hidden.bias[1] = -hidden.weight[0], -hidden.bias[0]
        output.weight[0, :2] = torch.tensor([0.8, -0.8])
    return built


@pytest.fixture(scope='module')
def presses(sample, following):
    """The sample four times, labelled with the network's own forces: gain 1 is right."""
    force, _ = outputs(following, sample)
    assert force.max() > 0.3
    assert np.ptp(force) > 0.1
    return [replace(sample, force=force) for _ in range(4)]


def stiffer(presses, gain):
    return [replace(press, force=np.float32(gain) * press.force) for press in presses]


@pytest.mark.parametrize('gain', [0.3, 1.0, 2.5])
def test_a_folded_gain_multiplies_forces_and_deviations(network, sample, gain):
    force, deviation = outputs(network, sample)
    scaled_force, scaled_deviation = outputs(with_gain(network, gain), sample)
    assert scaled_force == pytest.approx(gain * force, rel=1e-4, abs=1e-4)
    assert scaled_deviation == pytest.approx(gain * deviation, rel=1e-3)
    assert outputs(network, sample)[0] == pytest.approx(force, abs=0.0)


@pytest.mark.parametrize('gain', [0.3, 2.5])
def test_the_gain_without_torch_is_that_of_the_network(network, sample, gain):
    scaled = copy.deepcopy(network)
    with torch.no_grad():
        for layer in (scaled.increment[2], scaled.correction[2], scaled.frame.head):
            for parameter in layer.parameters():
                parameter.mul_(gain)
        scaled.gates_force.weight /= gain
        scaled.correction.get_parameter('0.weight')[:, 0] /= gain
        scaled.deviation.hidden.weight[:, -2:] /= gain
        scaled.deviation.scale *= gain
    force, deviation = outputs(scaled, sample)
    found_force, found_deviation = outputs(with_gain(network, gain), sample)
    assert found_force == pytest.approx(force, abs=1e-6)
    assert found_deviation == pytest.approx(deviation, abs=1e-6)


def test_impossible_gains_are_refused(network):
    for gain in (0.0, -1.0, float('nan'), float('inf')):
        with pytest.raises(ModelError):
            with_gain(network, gain)


@pytest.fixture
def fast(monkeypatch):
    """Last layers that stay as they are: their training has a test of its own."""
    monkeypatch.setattr(adaptation, 'tuned', lambda network, _data: network)
    monkeypatch.setattr(adaptation, 'SHORTEST_PRESSED_S', 0.5)


def test_a_stiffer_gel_is_found_as_a_gain(following, presses, fast):
    adapted = adapt(following, stiffer(presses, 1.7))
    assert adapted.way == 'gain'
    assert adapted.gain == pytest.approx(1.7, rel=0.02)
    assert adapted.held_out_mae['gain'] < 0.5 * adapted.held_out_mae['unchanged']
    assert adapted.presses == 4


def test_a_model_that_fits_stays_as_it_is(following, presses, fast):
    adapted = adapt(following, presses)
    assert adapted.way == 'unchanged'
    assert adapted.gain == 1.0


def test_the_deviation_covers_what_was_held_out(following, presses, fast):
    noise = np.random.default_rng(0).laplace(0.0, 0.05, (4, len(presses[0].force)))
    noisy = [
        replace(press, force=(press.force + each).astype(np.float32))
        for press, each in zip(stiffer(presses, 1.7), noise, strict=True)
    ]
    adapted = adapt(following, noisy)
    force, deviation = outputs(adapted.network, presses[0])
    covered = [np.mean(np.abs(force - press.force) <= deviation) for press in noisy]
    # Wider than one deviation of these presses: a further press is to be covered after four.
    wider = stats.t.ppf(0.8413, 4)
    wanted = stats.laplace.cdf(wider * stats.laplace.ppf(0.8413)) * 2 - 1
    assert np.mean(covered) == pytest.approx(wanted, abs=0.02)


@pytest.mark.parametrize(
    'change',
    [
        lambda press: replace(press, force=-press.force),
        lambda press: replace(press, force=0.01 * press.force),
        lambda press: replace(press, force=100.0 * press.force),
        lambda press: replace(press, force=press.force[::-1].copy()),
    ],
)
def test_what_does_not_belong_together_is_refused(following, presses, fast, change):
    with pytest.raises(CalibrationError):
        adapt(following, [change(press) for press in presses])


def test_one_press_is_too_few(following, presses):
    with pytest.raises(CalibrationError):
        adapt(following, presses[:1])


def test_larger_changes_have_to_earn_their_keep():
    assert choose({'unchanged': 1e-7, 'gain': 1e-8, 'last_layers': 0.0}) == 'unchanged'
    assert choose({'unchanged': 0.1, 'gain': 0.098, 'last_layers': 0.097}) == 'unchanged'
    assert choose({'unchanged': 0.1, 'gain': 0.05, 'last_layers': 0.049}) == 'gain'
    assert choose({'unchanged': 0.1, 'gain': 0.05, 'last_layers': 0.03}) == 'last_layers'
    assert choose({'unchanged': 0.1, 'gain': 0.2, 'last_layers': 0.09}) == 'last_layers'


def test_the_last_layers_learn_and_nothing_else_changes(following, presses):
    data = side_by_side([part_of(press, 0, 200) for press in stiffer(presses[:2], 1.5)])
    before, _ = estimate(following, data)
    adapted = tuned(following, data)
    after, _ = estimate(adapted, data)
    assert (after - data.force).abs().mean() < (before - data.force).abs().mean()
    old, new = following.state_dict(), adapted.state_dict()
    changed = {name.split('.')[0] for name in old if not torch.equal(old[name], new[name])}
    assert changed == {'increment', 'correction'}


def test_presses_are_cut_where_the_sensor_is_released(sample):
    estimates = np.zeros(len(sample.force))
    for start, stop in ((60, 140), (220, 300), (400, 450)):
        estimates[start:stop] = 0.8
    parts = cut_presses(sample, estimates)
    borders = [0, 180, 350, len(estimates)]
    assert [len(part.force) for part in parts] == np.diff(borders).tolist()
    joined = np.concatenate([part.window_end_us for part in parts])
    assert np.array_equal(joined, sample.window_end_us)
    for part in parts:
        assert part.slots.max() < len(part.frame_inputs)
        wanted = sample.slots[np.isin(sample.window_end_us, part.window_end_us)]
        frames = [sample.frame_inputs[slot] for slot in wanted if slot >= 0]
        assert np.array_equal(part.frame_inputs[part.slots[part.slots >= 0]], frames)


def test_a_press_of_unknown_force_is_left_out(sample):
    estimates = np.where(np.arange(len(sample.force)) % 200 > 100, 0.8, 0.0)
    unknown = replace(sample, force=np.full_like(sample.force, np.nan))
    assert cut_presses(unknown, estimates) == []


@given(count=st.integers(2, 40), parts=st.integers(2, 6))
def test_every_press_is_held_out_once(count, parts):
    held = folds([None] * count, parts)
    assert sorted(index for each in held for index in each) == list(range(count))
    assert all(len(each) < count for each in held)


def test_loads_are_read():
    assert parse_load('0.5:3.0-6.0') == Load(0.5, 3.0, 6.0)
    assert parse_load(' 2:.5-1 ') == Load(2.0, 0.5, 1.0)
    for wrong in ('0.5', '0.5:3', '-1:2-3', 'a:1-2', '1:2-2.1', '1:3-2', '1:1.2.3-4', ''):
        with pytest.raises(CalibrationError):
            parse_load(wrong)


def test_loads_hold_only_within_their_times():
    loads = [Load(0.5, 1.0, 2.0), Load(1.5, 3.0, 4.0)]
    label = load_label(loads, 10_000_000, 15_000_000)
    times = np.array([10_500_000, 11_500_000, 12_500_000, 13_500_000, 14_900_000])
    assert label.at(times) == pytest.approx([0.0, 0.5, 0.0, 1.5, 0.0])
    assert known_windows(loads, times, 10_000_000).tolist() == [False, True, False, True, False]
    edges = np.array([11_000_000, 11_050_000, 11_950_000, 13_200_000])
    assert known_windows(loads, edges, 10_000_000).tolist() == [False, False, False, True]


def test_loads_that_cannot_be_are_refused():
    for loads in ([Load(1, 1, 3), Load(1, 2, 4)], [Load(1, 4, 6)]):
        with pytest.raises(CalibrationError):
            load_label(loads, 0, 5_000_000)


def test_recordings_beyond_the_limit_are_left_out(network, trial):
    recorded = trial
    whole = gather_presses(network, [recorded])
    material = gather_presses(network, [recorded, recorded], longest_s=whole.used_s + 0.2)
    assert material.used_s == pytest.approx(whole.used_s + 0.2)
    assert material.left_out_s == pytest.approx(whole.used_s - 0.2)
    known = gather_presses(network, [recorded], [Load(0.5, 0.6, 1.0)])
    forces = np.concatenate([press.force for press in known.presses])
    assert np.nanmax(forces) == pytest.approx(0.5)
    assert np.isnan(forces).mean() > 0.5


def test_a_recording_without_a_press_is_refused(network, sample, monkeypatch):
    monkeypatch.setattr('mixtac_learning.adapt.presses._sample', lambda *_: sample)
    monkeypatch.setattr(
        'mixtac_learning.adapt.presses.estimate', lambda _n, s: (torch.zeros_like(s.force), None)
    )
    with pytest.raises(CalibrationError):
        gather_presses(network, [None])
