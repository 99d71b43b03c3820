# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiling everything that runs in real time before the first message arrives."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from mixtac_events.arrays import Events
from mixtac_events.codec import decode, encode
from mixtac_fger.streaming import ForceEstimator

if TYPE_CHECKING:
    from mixtac_fger.weights import LoadedModel


def warm_up(model: LoadedModel) -> None:
    """Run a throw-away estimator on a few frames and packets; seconds at the very first time."""
    torch.set_num_threads(1)
    config = model.config
    estimator = ForceEstimator(model)
    for kind in (np.uint8, np.uint16):
        for index in range(config.reference_frames):
            image = np.full((config.height, config.width), 100, kind)
            estimator.push_frame(image, index * 40_000)
    t_us = np.arange(1000, 11_000, 100, dtype=np.int64)
    zeros = np.zeros(len(t_us), np.uint16)
    packet = encode(Events(t_us, zeros, zeros, t_us % 200 == 0), complete_until=12_000)
    decoded = decode(packet.payload, packet.encoding, packet.time_base)
    estimator.push_events(decoded.events, decoded.complete_until)
