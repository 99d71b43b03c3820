# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiling everything that runs in real time before the first message arrives."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_events.arrays import Events
from mixtac_events.codec import decode, encode
from mixtac_fger.streaming import ForceEstimator

if TYPE_CHECKING:
    from mixtac_fger.estimates import Estimate
    from mixtac_fger.weights import LoadedModel


START_US = 1_000_000


def warm_up(model: LoadedModel) -> list[Estimate]:
    """Run a throw-away estimator on a few frames and packets; seconds at the very first time.

    Returns:
        What it gave: something, as else it would not have been through everything.
    """
    config = model.config
    estimator = ForceEstimator(model)
    for kind in (np.uint8, np.uint16):
        for index in range(config.reference_frames):
            image = np.full((config.height, config.width), 100, kind)
            estimator.push_frame(image, START_US - 1000 * index)
    t_us = np.arange(START_US + 1000, START_US + 11_000, 100, dtype=np.int64)
    zeros = np.zeros(len(t_us), np.uint16)
    packet = encode(Events(t_us, zeros, zeros, t_us % 200 == 0), complete_until=START_US + 12_000)
    # As from the middleware: bytes that must not be changed.
    decoded = decode(packet.payload.tobytes(), packet.encoding, packet.time_base)
    return estimator.push_events(decoded.events, decoded.complete_until)
