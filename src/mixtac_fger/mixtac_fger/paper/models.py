# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The paper's networks by name, and their cost."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from torch import nn

from mixtac_fger.paper.batch import SegmentBatch
from mixtac_fger.paper.fger import EventsOnly, FgerPaper
from mixtac_fger.paper.frame_models import FeatureFusion, FrameModel, FramesOnly

if TYPE_CHECKING:
    from mixtac_fger.paper.config import PaperConfig

PaperNetwork = FgerPaper | EventsOnly | FrameModel
CYCLE_US = 40_000
"""From frame to frame at the paper's 25 Hz."""
_CLASSES: dict[str, type[FgerPaper | EventsOnly | FramesOnly | FeatureFusion]] = {
    'fger': FgerPaper,
    'events': EventsOnly,
    'frames': FramesOnly,
    'fusion': FeatureFusion,
}


def build(config: PaperConfig) -> PaperNetwork:
    """Return a network with fresh weights."""
    return _CLASSES[config.model](config)


def count_parameters(network: nn.Module) -> int:
    """Return the number of trained parameters."""
    return sum(parameter.numel() for parameter in network.parameters())


def one_cycle(config: PaperConfig) -> SegmentBatch:
    """Return one cycle at full load: a frame, and packets with the most events that are read."""
    windows, rows, columns = CYCLE_US // config.window_us, *config.frame_shape
    slots = torch.full((windows, 1), -1)
    slots[-1] = 0
    return SegmentBatch(
        points=torch.rand(windows * config.events_per_packet, 4),
        packet=torch.arange(windows).repeat_interleave(config.events_per_packet),
        frames=torch.rand(1, 1, rows, columns),
        event_frames=torch.rand(1, 2, rows, columns),
        slots=slots,
        before=torch.tensor([-1]),
        force=torch.zeros(windows, 1),
        frame_force=torch.zeros(1),
        start=torch.zeros(1),
    )


def operations_per_cycle(config: PaperConfig) -> int:
    """Return floating-point operations (2 per multiply-add) of one cycle at full load.

    Counted by hand from the shapes, without normalisation, activations and pooling. Sparse
    convolutions count as if every pixel held events.
    """
    total = 0
    if config.model != 'events':
        total += _backbone(config)
    if config.model in {'fger', 'events'}:
        total += _recurrence(config)
    heads = {
        'fger': 1 + config.channels,
        'frames': config.channels,
        'fusion': config.channels + config.sparse_channels[-1],
        'events': -1,
    }
    total += config.correction_size * (heads[config.model] + 1)
    if config.model == 'fusion':
        total += _sparse(config)
    return 2 * total


def _backbone(config: PaperConfig) -> int:
    rows, columns = (_half(size) for size in config.frame_shape)
    stem = 49 * config.channels * rows * columns
    stage = 2 * config.blocks * 9 * config.channels**2 * _half(rows) * _half(columns)
    return stem + stage


def _recurrence(config: PaperConfig) -> int:
    widths = (4, *config.event_widths)
    point = sum(a * b for a, b in pairwise(widths))
    lstm = 4 * config.lstm_size * (widths[-1] + 1 + config.lstm_size)
    increment = config.increment_size * (config.lstm_size + 1)
    return CYCLE_US // config.window_us * (point * config.events_per_packet + lstm + increment)


def _sparse(config: PaperConfig) -> int:
    (rows, columns), widths = config.frame_shape, (2, *config.sparse_channels)
    total = 0
    for a, b in pairwise(widths):
        total += 9 * a * b * rows * columns
        rows, columns = _half(rows), _half(columns)
    return total


def _half(size: int) -> int:
    return (size + 1) // 2
