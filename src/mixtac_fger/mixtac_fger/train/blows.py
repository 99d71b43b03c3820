# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The blows of a group of trials, cut out: few windows in thousands, seen too seldom otherwise."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from mixtac_fger.network import FrameSlots

if TYPE_CHECKING:
    from torch import Tensor

    from mixtac_fger.batches import Sequences

BLOW_N = 3.0
"""A force beyond this is a blow [N]; presses stay below."""
BEFORE = 30
"""Windows before the blow: without contact, so that a stretch begins as a trial does."""
AFTER = 70
"""Windows from the blow on: three frames or so follow."""
RELEASED_N = 0.05
"""Largest force in the windows before [N]."""


def blows(sequences: Sequences) -> Sequences | None:
    """Return a stretch around each blow that comes out of no contact, side by side.

    Args:
        sequences: Trials.

    Returns:
        `BEFORE` + `AFTER` windows of each blow; frames are those of `sequences`. None without any.
    """
    starts = _starts(sequences.force, sequences.valid)
    if not len(starts):
        return None
    first, trial = starts.unbind(1)
    rows = first[None] + torch.arange(BEFORE + AFTER, device=first.device)[:, None]
    return replace(
        sequences,
        event_features=sequences.event_features[rows, trial],
        force=sequences.force[rows, trial],
        valid=sequences.valid[rows, trial],
        slots=FrameSlots(*(part[rows, trial] for part in sequences.slots)),
        device=sequences.device[trial],
    )


def _starts(force: Tensor, valid: Tensor) -> Tensor:
    """Return first window and trial of each stretch, int64 [N, 2]."""
    strong = (force > BLOW_N) & valid
    rising = strong.clone()
    rising[1:] &= ~strong[:-1]
    found = []
    for window, trial in torch.nonzero(rising).tolist():
        start = window - BEFORE
        if start < 0 or window + AFTER > len(force):
            continue
        # The first windows of the blow itself rise from nothing.
        before = force[start : window - 2, trial]
        if float(before.abs().max()) < RELEASED_N:
            found.append((start, trial))
    return torch.tensor(found, dtype=torch.int64, device=force.device).reshape(-1, 2)
