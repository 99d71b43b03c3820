# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A toy sensor for tests: a textured plane whose texture moves with the force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_fger.config import FgerConfig
from mixtac_fger.weights import LoadedModel, ModelCard
from mixtac_learning.network import FgerNetwork
from mixtac_learning.train.batches import Sequences, stack
from mixtac_learning.trials.samples import make_sample
from mixtac_learning.trials.trial import ForceLabel

HEIGHT, WIDTH = 260, 346
STEP_US = 1000
INTERVAL_US = 40_000
EXPOSURE_US = 6000
THRESHOLD = 0.2


@dataclass
class ToyTrial:
    """Events, frames and force of a toy sensor; the fields of a recorded trial."""

    events: Events
    frames: np.ndarray
    exposure_start_us: np.ndarray
    exposure_end_us: np.ndarray
    arrival_us: np.ndarray
    label: ForceLabel
    clock: tuple[float, float] = (1.0, 0.0)

    @property
    def reference_t_us(self) -> np.ndarray:
        return self.label.t_us.astype(np.int64)

    @property
    def reference_wrench(self) -> np.ndarray:
        wrench = np.zeros((len(self.label.force), 6))
        wrench[:, 2] = self.label.force + 0.01
        return wrench

    @property
    def truth(self) -> np.ndarray:
        truth = np.zeros(len(self.label.t_us), [('t_us', 'i8'), ('fz', 'f8')])
        truth['t_us'], truth['fz'] = self.label.t_us, self.label.force
        return truth


def texture(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return log intensity without contact and its change per newton (a radial displacement)."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    log_intensity = np.full((HEIGHT, WIDTH), np.log(300.0), np.float32)
    for _ in range(60):
        kx, ky = random.normal(0, 0.25, 2)
        log_intensity += 0.1 * np.sin(kx * x + ky * y + random.uniform(0, 6.28))
    along_y, along_x = np.gradient(log_intensity)
    dx, dy = x - WIDTH / 2, y - HEIGHT / 2
    strength = 2.0 / 60.0 * np.exp(-(dx**2 + dy**2) / (2 * 60.0**2))
    return log_intensity, -(along_x * dx + along_y * dy) * strength


def toy_trial(seconds: float, seed: int) -> ToyTrial:
    """Press slowly and shake: 0.3 s of nothing, then a force between 0 and 1 N."""
    random = np.random.default_rng(seed)
    base, change = texture(random)
    t_us = np.arange(0, int(seconds * 1e6) + 1, STEP_US)
    active = np.clip((t_us / 1e6 - 0.3) / 0.2, 0, 1)
    phase = random.uniform(0, 6.28)
    force = active * (0.5 + 0.4 * np.sin(2 * np.pi * (t_us / 1e6) * 2.0 + phase))
    reference, kept = base.copy(), []
    for now, newton in zip(t_us[1:], force[1:], strict=True):
        crossings = np.trunc((base + change * newton - reference) / THRESHOLD).astype(int)
        y, x = np.nonzero(crossings)
        reference[y, x] += crossings[y, x] * THRESHOLD
        t = np.full(len(x), now - STEP_US // 2)
        kept.append(Events(t, x.astype(np.uint16), y.astype(np.uint16), crossings[y, x] > 0))
    start = np.arange(5000, t_us[-1] - 25_000, INTERVAL_US)
    middle = np.interp(start + EXPOSURE_US / 2, t_us, force)
    frames = np.stack([np.exp(base + change * newton) for newton in middle])
    label = ForceLabel(t_us.astype(np.float64), force)
    arrival = start + EXPOSURE_US + 9000
    return ToyTrial(
        Events.concatenate(kept),
        frames.astype(np.uint16),
        start,
        start + EXPOSURE_US,
        arrival,
        label,
    )


@pytest.fixture(scope='session', autouse=True)
def one_thread() -> None:
    """Small networks on a busy machine: threads wait for each other longer than they help."""
    import torch

    torch.set_num_threads(1)


@pytest.fixture(scope='session')
def trial() -> ToyTrial:
    return toy_trial(1.2, seed=3)


@pytest.fixture(scope='session')
def config() -> FgerConfig:
    return FgerConfig()


@pytest.fixture(scope='session')
def model(config: FgerConfig) -> LoadedModel:
    """A network with random weights that are large enough to matter."""
    import torch

    torch.manual_seed(5)
    network = FgerNetwork(config).eval()
    with torch.no_grad():
        network.event.scale.copy_(torch.tensor([2.0, 2.0, 3.0, 3.0]))
        network.frame.scale.mul_(0.3)
        for part in (network.event, network.increment, network.correction):
            for parameter in part.parameters():
                parameter.mul_(4.0)
        # What the events add directly has no bound: smaller, or the estimate runs away.
        network.increment[0].weight[:, config.lstm_size :] *= 0.02
        network.increment[2].weight *= 0.02
        network.increment[2].bias.zero_()
    return LoadedModel(network, ModelCard())


@pytest.fixture(scope='session')
def toy_sequences(config: FgerConfig) -> list[Sequences]:
    """Two sets of toy trials: five to train on and two others."""
    trials = [toy_trial(1.6, seed) for seed in range(7)]
    samples = [make_sample(config, trial, trial.label, {}) for trial in trials]
    return [stack(samples[:5]), stack(samples[5:])]
