# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stages of the paper's networks: what learns, and on what."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.layers import Scale
from mixtac_learning.paper.networks import PaperNetwork, build
from mixtac_learning.paper.samples import PaperSample, make_paper_sample
from mixtac_learning.train.paper_stage import (
    EventStage,
    FrameStage,
    PaperStage,
    PaperTraining,
    RecurrentStage,
    fit_scales,
)

SMALL = {'scale': 16, 'events_per_packet': 16, 'channels': 8, 'blocks': 1, 'lstm_size': 8}


def config(model: str, **changes) -> PaperConfig:
    return PaperConfig.from_dict({'model': model} | SMALL | changes)


@pytest.fixture(scope='module')
def samples(trial) -> list[PaperSample]:
    return [make_paper_sample(config('fusion'), trial) for _ in range(2)]


def stage(kind: type[PaperStage], name: str, network: PaperNetwork, samples, **training):
    settings = PaperTraining(**training)
    return kind(name, 1, 1e-3, network, samples, settings)


def learn(chosen: PaperStage, optimiser: torch.optim.Optimizer) -> None:
    for loss in chosen.losses(torch.Generator().manual_seed(0)):
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


@pytest.mark.parametrize(
    ('kind', 'name', 'learning'),
    [
        (FrameStage, 'frames', {'correction'}),
        (EventStage, 'events', {'recurrence'}),
        (RecurrentStage, 'recurrent', {'recurrence', 'correction'}),
        (RecurrentStage, 'joint', {'frame', 'recurrence', 'correction'}),
    ],
)
def test_each_stage_trains_its_part(samples, kind, name, learning):
    network = build(config('fger'))
    chosen = stage(kind, name, network, samples, cycles=5)
    optimised = {id(each) for each in chosen.parameters()}
    for loss in chosen.losses(torch.Generator().manual_seed(0)):
        loss.backward()
    found = {
        name.partition('.')[0]
        for name, each in network.named_parameters()
        if each.grad is not None and id(each) in optimised
    }
    assert found == learning


def test_a_correction_learns_the_force_of_the_frame(samples):
    network = build(config('fger'))
    chosen = stage(FrameStage, 'frames', network, samples)
    learn(chosen, torch.optim.AdamW(chosen.parameters(), 1e-2, weight_decay=0.1))
    chosen.validate()
    features = torch.randn(5, network.config.channels, generator=torch.Generator().manual_seed(1))
    alone = network.corrected(torch.zeros(5), features)
    assert alone.std() > 0.0
    for before in (-1.0, 0.3, 2.0):
        corrected = network.corrected(torch.full((5,), before), features)
        assert torch.allclose(corrected, alone, atol=1e-5)


def test_the_state_is_carried_through_whole_trials(samples):
    network = build(config('events')).eval()
    seen = []
    network.register_forward_pre_hook(lambda _module, inputs: seen.append(inputs[1].force.clone()))
    network.register_forward_hook(lambda _module, _inputs, out: seen.append(out[1].force.detach()))
    chosen = stage(RecurrentStage, 'joint', network, samples, cycles=2)
    losses = list(chosen.losses(torch.Generator().manual_seed(0)))
    assert len(losses) == chosen.updates() == len(seen) // 2
    assert not seen[0].any()
    for before, after in zip(seen[1:-1:2], seen[2::2], strict=True):
        assert torch.equal(before, after)


def test_the_event_path_learns_which_way_the_force_goes(samples):
    rng = np.random.default_rng(0)
    # More force for events on the left, less for those on the right.
    signs = np.where(rng.random(400) < 0.5, -1.0, 1.0)
    points = np.stack([np.repeat(-0.5 * signs, 3), *rng.random((3, 1200))], 1).astype(np.float16)
    toy = replace(
        samples[0],
        window_end_us=np.arange(400) * 2000,
        points=points,
        starts=np.arange(401) * 3,
        slots=np.full(400, -1),
        force=np.cumsum(0.01 * signs).astype(np.float32),
    )
    network = build(config('events'))
    fit_scales(network, samples)
    chosen = stage(EventStage, 'events', network, [toy], event_batch=8)
    chosen.checked = [toy]
    before = chosen.validate()
    learn(chosen, torch.optim.Adam(chosen.parameters(), 1e-2))
    network.eval()
    after = chosen.validate()
    assert before is not None
    assert after is not None
    assert after < 0.5 * before


@pytest.mark.parametrize(('kind', 'name'), [(EventStage, 'events'), (RecurrentStage, 'recurrent')])
def test_scales_follow_where_stretches_are_drawn_at_random(samples, kind, name):
    network = build(config('fger'))
    fit_scales(network, samples)
    network.train()
    chosen = stage(kind, name, network, samples, cycles=5, event_batch=4)
    chosen.parameters()
    before = {
        name: each.mean.clone() for name, each in network.named_modules() if isinstance(each, Scale)
    }
    next(chosen.losses(torch.Generator().manual_seed(0)))
    moved = {
        name
        for name, each in network.named_modules()
        if isinstance(each, Scale) and not torch.equal(each.mean, before[name])
    }
    assert moved == ({'recurrence.encoder.scale'} if kind is EventStage else set())
