# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the paper's networks are given: stretches of windows side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import torch
    from torch import Tensor


@dataclass(frozen=True, slots=True, eq=False)
class SegmentBatch:
    """B stretches of T windows with the frames that arrive in them.

    Attributes:
        points: Events of all windows, [E, 4]; see `PointEncoder`.
        packet: Window of each event, t * B + b, int64 [E].
        frames: Intensities of the frames, [N, 1, rows, columns].
        event_frames: ln(1 + count) of ON and OFF events between each frame and the one before, [N,
            2, rows, columns]; empty unless the model reads them.
        slots: Frame that arrives in each window, -1 for none, int64 [T, B].
        before: Frame that is the latest before the first window, -1 for none, int64 [B].
        force: Label at the end of each window [N], [T, B].
        frame_force: Mean label over each exposure [N], [N].
        start: Label before the first window [N], [B].
    """

    points: Tensor
    packet: Tensor
    frames: Tensor
    event_frames: Tensor
    slots: Tensor
    before: Tensor
    force: Tensor
    frame_force: Tensor
    start: Tensor

    def to(self, device: torch.device) -> SegmentBatch:
        """Return the batch on a device."""
        return SegmentBatch(*(getattr(self, name).to(device) for name in self.__slots__))


class PaperState(NamedTuple):
    """What is carried from stretch to stretch.

    Attributes:
        hidden: LSTM output [B, lstm_size].
        cell: LSTM cell [B, lstm_size].
        force: Estimate [B] in N.
        feature: Feature of the latest frame [B, channels].
        seen: Whether there is one, bool [B].
    """

    hidden: Tensor
    cell: Tensor
    force: Tensor
    feature: Tensor
    seen: Tensor

    def detached(self) -> PaperState:
        """Return the state without its gradient."""
        return PaperState(*(part.detach() for part in self))
