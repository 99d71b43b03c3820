# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A toy sensor for tests: a textured plane whose texture moves with the force."""

from __future__ import annotations

from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_fger.config import ARCHITECTURE, PRESSES, VERSION, FgerConfig, tensor_shapes
from mixtac_fger.estimator import Estimate
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.validity import PictureFigures
from mixtac_fger.weights import Model, ModelCard

HEIGHT, WIDTH = 260, 346
STEP_US = 1000
INTERVAL_US = 40_000
EXPOSURE_US = 6000
THRESHOLD = 0.2
SOUND = PictureFigures(np.zeros(48), np.zeros(48), np.ones(48), shift=0.0, outward=0.0)
"""What the picture of a sensor that nothing touches has in common with the reference."""


class ToyTrial(NamedTuple):
    """Events, 10-bit frames and force of a toy sensor; times on the camera clock [us]."""

    events: Events
    frames: np.ndarray
    exposure_start_us: np.ndarray
    exposure_end_us: np.ndarray
    arrival_us: np.ndarray
    t_us: np.ndarray
    force: np.ndarray


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
    # Others never reach the threshold.
    rows, columns = np.nonzero(np.abs(change) * force.max() > 0.9 * THRESHOLD)
    still, moving = base[rows, columns], change[rows, columns]
    reference, kept = still.copy(), []
    for now, newton in zip(t_us[1:], force[1:], strict=True):
        crossings = np.trunc((still + moving * newton - reference) / THRESHOLD).astype(int)
        (at,) = np.nonzero(crossings)
        reference[at] += crossings[at] * THRESHOLD
        x, y = columns[at].astype(np.uint16), rows[at].astype(np.uint16)
        kept.append(Events(np.full(len(at), now - STEP_US // 2), x, y, crossings[at] > 0))
    start = np.arange(5000, t_us[-1] - 25_000, INTERVAL_US)
    middle = np.interp(start + EXPOSURE_US / 2, t_us, force)
    frames = np.stack([np.exp(base + change * newton) for newton in middle])
    return ToyTrial(
        Events.concatenate(kept),
        np.minimum(frames, 1023).astype(np.uint16),
        start,
        start + EXPOSURE_US,
        start + EXPOSURE_US + 9000,
        t_us.astype(np.float64),
        force,
    )


def displacement(place, press=0.0, pull=(0.0, 0.0), turn=0.0, width=8.0):
    """Return the displacement [2, rows, columns] under a contact, y downwards [bins]."""
    rows, columns = FgerConfig().frame_shape
    y, x = np.mgrid[:rows, :columns].astype(float)
    x, y = x - place[0], y - place[1]
    near = np.exp(-(x**2 + y**2) / (2.0 * width**2))
    # Skin moves away from a press; a turn from x to y as the contact frame has them, y upwards.
    moved = press * near * np.stack([x, y]) + near * np.reshape(pull, (2, 1, 1))
    return (moved + turn * near * np.stack([y, -x])).astype(np.float32)


def random_model(config: FgerConfig, seed: int = 5) -> Model:
    """Return a model with random weights that are large enough to matter."""
    random = np.random.default_rng(seed)
    shapes = tensor_shapes(config)
    tensors = {}
    for name, shape in shapes.items():
        inputs = np.prod(shapes.get(name.replace('.bias', '.weight'), shape)[1:])
        limit = 1.0 / np.sqrt(max(float(inputs), 1.0))
        tensors[name] = random.uniform(-limit, limit, shape).astype(np.float32)
    tensors['frame.spread'][:] = 20.0
    tensors['frame.spread'][1:PRESSES] = 2e4, 2e7
    # Below the threshold of contact, so that a tare is possible at any time.
    tensors['frame.press'] *= 0.1
    tensors['event.scale'][:] = (2.0, 2.0, 3.0, 3.0)
    tensors['deviation'][:] = (0.01, 0.1, 0.5)
    for name, tensor in tensors.items():
        if name.startswith(('event.hidden', 'event.output', 'increment')):
            np.multiply(tensor, 4.0, out=tensor)
    # What the events add directly has no bound: smaller, or the estimate runs away.
    tensors['increment.0.weight'][:, config.lstm_size :] *= 0.02
    tensors['increment.2.weight'] *= 0.04
    tensors['increment.2.bias'][:] = 0.0
    return Model(ARCHITECTURE, VERSION, asdict(config), ModelCard(), tensors)


def estimates(model: Model, trial: ToyTrial, **options: object) -> list[Estimate]:
    """Return the estimates of a trial without contact at its start."""
    estimator = ForceEstimator(FgerEstimator(model), assume_free=True, **options)
    rows, start = [], 0
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    for image, mid_us, arrival_us in zip(
        trial.frames, middle.tolist(), trial.arrival_us.tolist(), strict=True
    ):
        rows += estimator.push_events(trial.events.between(start, arrival_us), arrival_us)
        start = arrival_us
        estimator.push_frame(image * np.uint16(64), mid_us)
    return rows
