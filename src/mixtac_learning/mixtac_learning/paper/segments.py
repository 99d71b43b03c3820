# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Batches of equally long stretches of samples, and inference over whole trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from mixtac_learning.paper.networks import PaperNetwork, SegmentBatch
from mixtac_learning.paper.samples import PaperSample


class Segment(NamedTuple):
    """A stretch of a sample.

    Attributes:
        trial: Index of the sample.
        start: Its first window.
        stop: After its last window.
    """

    trial: int
    start: int
    stop: int


def cut_segments(
    samples: Sequence[PaperSample], windows: int, shift: int, trials: Sequence[int] | None = None
) -> list[Segment]:
    """Cut samples into stretches of equal length; shorter remainders are dropped.

    Args:
        samples: Samples.
        windows: Length of a stretch.
        shift: Windows before the first stretch of each sample, so that borders differ from epoch to
            epoch.
        trials: Which samples; None for all.
    """
    chosen = range(len(samples)) if trials is None else trials
    return [
        Segment(trial, start, start + windows)
        for trial in chosen
        for start in range(
            shift if len(samples[trial].force) - shift >= windows else 0,
            len(samples[trial].force) - windows + 1,
            windows,
        )
    ]


def assemble(
    samples: Sequence[PaperSample], segments: Sequence[Segment], model: str
) -> SegmentBatch:
    """Put stretches of equal length side by side.

    Args:
        samples: Samples.
        segments: Stretches.
        model: One of `mixtac_learning.paper.config.MODELS`; what it does not read stays empty. The
            label of a frame is the mean force of its exposure, or for `fusion` the force when it
            arrives, up to which that network has seen events.
    """
    columns = [_Column(samples[s.trial], s, model) for s in segments]
    shift = np.cumsum([0, *(len(c.frames) for c in columns[:-1])])
    slots = np.stack([_shifted(c.slots, k) for c, k in zip(columns, shift, strict=True)], 1)
    before = np.array([_shifted(c.before, k) for c, k in zip(columns, shift, strict=True)])
    packet = np.concatenate([c.packet * len(columns) + b for b, c in enumerate(columns)])
    return SegmentBatch(
        points=_tensor(np.concatenate([c.points for c in columns]), np.float32),
        packet=torch.from_numpy(packet),
        frames=_tensor(np.concatenate([c.frames for c in columns])[:, None], np.float32),
        event_frames=_tensor(np.concatenate([c.event_frames for c in columns]), np.float32),
        slots=torch.from_numpy(slots),
        before=torch.from_numpy(before),
        force=_tensor(np.stack([c.force for c in columns], 1), np.float32),
        frame_force=_tensor(np.concatenate([c.frame_force for c in columns]), np.float32),
        start=_tensor(np.array([c.start for c in columns]), np.float32),
    )


class _Column:
    """One stretch, with frames counted from its own first."""

    def __init__(self, sample: PaperSample, segment: Segment, model: str) -> None:
        rows = slice(segment.start, segment.stop)
        slots = np.array(sample.slots[rows])
        self.force = np.array(sample.force[rows])
        self.start = sample.force[segment.start - 1] if segment.start else sample.force[0]
        earlier = np.flatnonzero(sample.slots[: segment.start] >= 0)
        latest = int(sample.slots[earlier[-1]]) if len(earlier) else -1
        if model == 'events':
            used = np.zeros(0, np.int64)
            self.slots, self.before = np.full_like(slots, -1), np.int64(-1)
        else:
            used = np.unique(np.concatenate([[latest], slots]))
            used = used[used >= 0]
            self.slots = np.where(slots >= 0, np.searchsorted(used, slots), -1)
            self.before = np.int64(np.searchsorted(used, latest) if latest >= 0 else -1)
        self.frames = sample.frames[used]
        shown = used if model == 'fusion' else used[:0]
        self.event_frames = np.log1p(sample.counts[shown].astype(np.float32))
        self.frame_force = np.array(sample.frame_force[used])
        if model == 'fusion':
            # Its label is the force when the frame arrives, not that of the exposure.
            arrivals = np.flatnonzero(sample.slots >= 0)
            place = np.searchsorted(sample.slots[arrivals], used)
            self.frame_force = np.array(sample.force[arrivals[place]])
        self.points, self.packet = _points(sample, segment, model)


def _points(
    sample: PaperSample, segment: Segment, model: str
) -> tuple[NDArray[np.float16], NDArray[np.int64]]:
    if model not in {'fger', 'events'}:
        return np.zeros((0, 4), np.float16), np.zeros(0, np.int64)
    starts = sample.starts[segment.start : segment.stop + 1]
    packet = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    return np.array(sample.points[starts[0] : starts[-1]]), packet


def _shifted(slots: NDArray[np.int64] | np.int64, shift: int) -> NDArray[np.int64]:
    return np.where(slots >= 0, slots + shift, -1)


def _tensor(array: NDArray[np.generic], kind: type[np.float32]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=kind))


STRETCH_WINDOWS = 250
"""Windows that are in memory at a time: half a second."""


@torch.no_grad()
def run_samples(
    network: PaperNetwork, samples: Sequence[PaperSample]
) -> Iterator[NDArray[np.float32]]:
    """Yield the force [N] at the end of each window of each trial, float32 [T].

    Every trial starts at zero force with an empty memory and runs to its end without any
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
