# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The networks against literal re-writings of what they compute."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from mixtac_fger.config import ConfigError
from mixtac_learning.paper.config import MODELS, PaperConfig
from mixtac_learning.paper.layers import PointEncoder, SparseBackbone, SparseBlock
from mixtac_learning.paper.networks import SegmentBatch, build
from mixtac_learning.paper.samples import PaperSample, make_paper_sample, run_samples
from mixtac_learning.train.paper_stage import fit_scales

SMALL = PaperConfig(
    width=32,
    height=24,
    channels=8,
    blocks=1,
    event_widths=(6, 10),
    lstm_size=12,
    increment_size=7,
    correction_size=5,
    sparse_channels=(4, 8),
)
WINDOWS, SEQUENCES = 9, 3


@pytest.fixture
def batch() -> SegmentBatch:
    """Three sequences; frames arrive in windows 2 and 6 of the first, 5 of the second."""
    torch.manual_seed(1)
    slots = torch.full((WINDOWS, SEQUENCES), -1)
    slots[2, 0], slots[6, 0], slots[5, 1] = 0, 1, 2
    packet = torch.randint(WINDOWS * SEQUENCES, (150,)).sort().values
    packet = packet[(packet != 4)]  # one window stays empty
    return SegmentBatch(
        points=torch.randn(len(packet), 4),
        packet=packet,
        frames=torch.rand(4, 1, 24, 32),
        event_frames=torch.rand(4, 2, 24, 32) * (torch.rand(4, 1, 24, 32) > 0.7),
        slots=slots,
        before=torch.tensor([-1, 3, -1]),
        force=torch.rand(WINDOWS, SEQUENCES),
    )


def algorithm_1(network, batch: SegmentBatch, column: int) -> list[float]:
    """Run one sequence, line by line as the paper writes it, in NumPy where it can be."""
    weights = {name: value.detach().numpy() for name, value in network.named_parameters()}

    def perceptron(name: str, x: np.ndarray) -> float:
        hidden = np.maximum(weights[f'{name}.0.weight'] @ x + weights[f'{name}.0.bias'], 0)
        return float((weights[f'{name}.2.weight'] @ hidden + weights[f'{name}.2.bias'])[0])

    def sigmoid(x: np.ndarray) -> np.ndarray:
        return 1 / (1 + np.exp(-x))

    features = network.frame(batch.frames).detach().numpy()
    latest = features[batch.before[column]] if batch.before[column] >= 0 else None
    h = c = np.zeros(network.config.lstm_size)
    f, out = 0.0, []
    withheld, since = 0.0, 0
    for window in range(WINDOWS):
        own = batch.points[batch.packet == window * SEQUENCES + column].numpy()
        f_e = np.zeros(network.config.event_widths[-1])
        for event in own:
            inner = event
            for layer in (0, 2):
                name = f'recurrence.encoder.layers.{layer}'
                inner = np.maximum(weights[f'{name}.weight'] @ inner + weights[f'{name}.bias'], 0)
            f_e = np.maximum(f_e, inner)
        x = np.concatenate([f_e, [f]])
        gates = weights['recurrence.lstm.weight_ih'] @ x + weights['recurrence.lstm.bias_ih']
        gates = gates + weights['recurrence.lstm.weight_hh'] @ h
        i, forget, g, o = np.split(gates + weights['recurrence.lstm.bias_hh'], 4)
        c = sigmoid(forget) * c + sigmoid(i) * np.tanh(g)
        h = sigmoid(o) * np.tanh(c)
        f = f + perceptron('recurrence.increment', h)
        slot = int(batch.slots[window, column])
        if slot >= 0:
            step = perceptron('correction', np.concatenate([[f], features[slot]]))
            withheld = withheld * (1 - since / 20) + (step if latest is not None else 0.0)
            latest, since = features[slot], 0
            f = f + step
        since += 1
        out.append(f - withheld * (1 - since / 20))
    return out


def test_fger_net_is_algorithm_1(batch):
    torch.manual_seed(0)
    network = build(SMALL).eval()
    with torch.no_grad():
        force, _ = network(batch, network.initial_state(SEQUENCES))
        for column in range(SEQUENCES):
            wanted = algorithm_1(network, batch, column)
            assert force[:, column].tolist() == pytest.approx(wanted, abs=1e-5)


def test_another_lamp_and_exposure_change_nothing():
    torch.manual_seed(0)
    network = build(replace(SMALL, model='frames', light='reference')).train()
    frames = 0.1 + 0.4 * torch.rand(2, 1, 24, 32)
    with torch.no_grad():
        dim, bright = (
            network.force_of(network.features(part * frames, frames)) for part in (0.5, 2.0)
        )
        alone = network.force_of(network.features(frames[:1], frames))
    assert torch.allclose(dim, bright, atol=1e-5)
    # Nor does what else is in the batch.
    assert torch.allclose(
        2 * alone, 2 * network.force_of(network.features(frames, frames))[:1], atol=1e-5
    )


def test_a_correction_is_given_out_within_one_cycle():
    torch.manual_seed(0)
    network = build(SMALL).eval()
    events, frames = torch.zeros(1, 10), torch.rand(2, 8)
    state = network.initial_state(1)
    with torch.no_grad():
        for window in range(45):
            slots = torch.tensor([{0: 0, 20: 1}.get(window, -1)])
            arrives = bool(slots >= 0)
            given, state = network.window(events, frames, slots, state, arrives=arrives)
            # The first frame is used at once, the second within the 20 windows after it.
            whole = float(given) == pytest.approx(float(state.force), abs=1e-6)
            assert whole == (not 20 <= window < 39)


def test_events_only_never_sees_a_frame(batch):
    torch.manual_seed(0)
    network = build(replace(SMALL, model='events')).eval()
    assert not [name for name, _ in network.named_parameters() if 'frame' in name]
    frames = batch.frames.clone().requires_grad_()
    tracked = SegmentBatch(**{n: getattr(batch, n) for n in batch.__slots__} | {'frames': frames})
    force, _ = network(tracked, network.initial_state(SEQUENCES))
    force.sum().backward()
    assert frames.grad is None
    blind = SegmentBatch(
        **{n: getattr(batch, n) for n in batch.__slots__}
        | {'frames': torch.rand(4, 1, 24, 32), 'slots': torch.full_like(batch.slots, -1)}
    )
    assert torch.equal(network(blind, network.initial_state(SEQUENCES))[0], force)


@pytest.mark.parametrize('model', ['frames', 'fusion'])
def test_frame_models_hold_their_force(batch, model):
    torch.manual_seed(0)
    network = build(replace(SMALL, model=model)).eval()
    with torch.no_grad():
        own = network.force_of(network.features(batch.frames, batch.event_frames))
        force, state = network(batch, network.initial_state(SEQUENCES))
    assert force[:, 0].tolist() == [0, 0, *[own[0].item()] * 4, *[own[1].item()] * 3]
    assert force[:, 1].tolist() == [*[own[3].item()] * 5, *[own[2].item()] * 4]
    assert force[:, 2].tolist() == [0.0] * WINDOWS
    assert torch.equal(state.force, force[-1])


def test_an_empty_packet_or_event_frame_has_no_feature():
    encoder = PointEncoder(SMALL)
    features = encoder(torch.randn(5, 4), torch.tensor([0, 0, 2, 2, 2]), 3)
    assert features[1].tolist() == [0.0] * 10
    assert not SparseBackbone(2, (4, 8)).eval()(torch.zeros(2, 2, 9, 7)).any()


def test_channels_begin_as_cells_of_one_polarity():
    torch.manual_seed(0)
    encoder = PointEncoder(PaperConfig(model='events'))
    places = (torch.arange(8) + 0.5) / 4 - 1
    points = torch.cartesian_prod(places, places, torch.tensor([0.5]), torch.tensor([1.0, -1.0]))
    found = encoder(points, torch.arange(len(points)), len(points))
    assert found.argmax(1).sort().values.tolist() == list(range(128))
    # Each depends neither on the other polarity nor of places two cells away.
    own = points[found.argmax(0)]
    for channel, place in enumerate(own):
        away = (points[:, :2] - place[:2]).abs().amax(1) > 0.45
        assert not found[away | (points[:, 3] != place[3]), channel].any()


def test_sparse_convolutions_touch_active_pixels_only():
    torch.manual_seed(0)
    maps = torch.zeros(1, 2, 8, 8)
    maps[0, :, 1, 1] = torch.tensor([1.0, 2.0])
    maps[0, :, 1, 2] = torch.tensor([3.0, 0.5])
    maps[0, :, 6, 5] = torch.tensor([0.2, 0.1])
    block = SparseBlock(2, 3).eval()
    with torch.no_grad():
        out, mask = block(maps, maps.abs().amax(1, keepdim=True) > 0)
    assert mask[0, 0].nonzero().tolist() == [[0, 0], [0, 1], [3, 2]]
    assert not out[0, :, ~mask[0, 0]].any()
    # By hand: the sum over active neighbours of kernel times input, normalised and rectified.
    kernel = block.convolution.weight.detach().numpy()
    value = np.zeros(3)
    for (row, column), source in (((1, 1), maps[0, :, 1, 1]), ((1, 2), maps[0, :, 1, 2])):
        value += kernel[:, :, row - 1 + 1, column - 1 + 1] @ source.numpy()
    scale = 1 / np.sqrt(1 + block.norm.eps)
    assert out[0, :, 0, 0].tolist() == pytest.approx(np.maximum(value * scale, 0), abs=1e-6)


def test_impossible_configurations_are_refused():
    with pytest.raises(ConfigError):
        PaperConfig(model='snn')
    with pytest.raises(ConfigError):
        PaperConfig(event_widths=(64, 0))
    with pytest.raises(ConfigError):
        PaperConfig.from_dict({'depth': 3})
    config = PaperConfig(model='fusion', scale=2)
    assert PaperConfig.from_dict(asdict(config)) == config


SIZES = {'scale': 16, 'events_per_packet': 16, 'channels': 8, 'blocks': 1, 'lstm_size': 8}


def cut(sample: PaperSample, windows: int) -> PaperSample:
    return replace(
        sample,
        window_end_us=sample.window_end_us[:windows],
        starts=sample.starts[: windows + 1],
        slots=sample.slots[:windows],
        force=sample.force[:windows],
    )


@pytest.mark.parametrize('model', MODELS)
def test_trials_side_by_side_are_those_alone(trial, model):
    config = PaperConfig.from_dict({'model': model} | SIZES)
    whole = make_paper_sample(config, trial)
    samples = [cut(whole, 310), whole, cut(whole, 64), cut(whole, 310), cut(whole, 0)]
    network = build(config).eval()
    fit_scales(network, [whole])
    found = run_samples(network, samples)
    alone = [run_samples(network, [each])[0] for each in samples]
    assert [len(each) for each in found] == [len(each.force) for each in samples]
    for together, single in zip(found, alone, strict=True):
        assert np.allclose(together, single, atol=1e-4)
    assert np.std(found[1]) > 0.0
