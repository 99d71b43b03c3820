# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running the paper's networks over whole trials, as in inference."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from mixtac_fger.paper.segments import Segment, assemble

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from mixtac_fger.paper.models import PaperNetwork
    from mixtac_fger.paper.samples import PaperSample

STRETCH_WINDOWS = 250
"""Windows that are in memory at a time: half a second."""


@torch.no_grad()
def run_samples(
    network: PaperNetwork, samples: Sequence[PaperSample]
) -> Iterator[NDArray[np.float32]]:
    """Yield the force [N] at the end of each window of each trial, float32 [T].

    Every trial begins at no force and nothing remembered, and runs to its end without any
    knowledge of the true force. Memory does not grow with its length.

    Args:
        network: In evaluation mode.
        samples: Trials.
    """
    device = next(network.parameters()).device
    for sample in samples:
        state = network.initial_state(1)
        parts = []
        for start in range(0, len(sample.force), STRETCH_WINDOWS):
            stop = min(start + STRETCH_WINDOWS, len(sample.force))
            batch = assemble([sample], [Segment(0, start, stop)], network.config.model)
            force, state = network(batch.to(device), state)
            parts.append(force[:, 0].cpu().numpy())
        yield np.concatenate(parts)
