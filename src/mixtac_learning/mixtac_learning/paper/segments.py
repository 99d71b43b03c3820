# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Batches of single frames and of equally long stretches, and inference over whole trials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import PaperNetwork, PaperState, SegmentBatch
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


def assemble(
    samples: Sequence[PaperSample],
    segments: Sequence[Segment],
    config: PaperConfig,
    features: Sequence[NDArray[np.float32]] = (),
) -> SegmentBatch:
    """Put stretches of equal length side by side.

    Args:
        samples: Samples.
        segments: Stretches.
        config: Of the network; what it does not read stays empty.
        features: f_frame of all frames of each sample where it is known, [frames, channels].
    """
    columns = [
        _Column(samples[s.trial], s, config, features[s.trial] if features else None)
        for s in segments
    ]
    shift = np.cumsum([0, *(len(c.frames) for c in columns[:-1])])
    slots = np.stack([_shifted(c.slots, k) for c, k in zip(columns, shift, strict=True)], 1)
    before = np.array([_shifted(c.before, k) for c, k in zip(columns, shift, strict=True)])
    packet = np.concatenate([c.packet * len(columns) + b for b, c in enumerate(columns)])
    return SegmentBatch(
        points=_tensor(np.concatenate([c.points for c in columns]), np.float32),
        packet=torch.from_numpy(packet),
        frames=_tensor(np.concatenate([c.frames for c in columns]), np.float32),
        event_frames=_tensor(np.concatenate([c.event_frames for c in columns]), np.float32),
        slots=torch.from_numpy(slots),
        before=torch.from_numpy(before),
        force=_tensor(np.stack([c.force for c in columns], 1), np.float32),
    )


class _Column:
    """One stretch, with frames counted from its own first."""

    def __init__(
        self,
        sample: PaperSample,
        segment: Segment,
        config: PaperConfig,
        features: NDArray[np.float32] | None,
    ) -> None:
        rows = slice(segment.start, segment.stop)
        slots = np.array(sample.slots[rows])
        self.force = np.array(sample.force[rows])
        earlier = np.flatnonzero(sample.slots[: segment.start] >= 0)
        latest = int(sample.slots[earlier[-1]]) if len(earlier) else -1
        if config.model == 'events':
            used = np.zeros(0, np.int64)
            self.slots, self.before = np.full_like(slots, -1), np.int64(-1)
        else:
            used = np.unique(np.concatenate([[latest], slots]))
            used = used[used >= 0]
            self.slots = np.where(slots >= 0, np.searchsorted(used, slots), -1)
            self.before = np.int64(np.searchsorted(used, latest) if latest >= 0 else -1)
        self.frames = sample.seen(used, config) if features is None else features[used]
        shown = used if config.model == 'fusion' else used[:0]
        self.event_frames = np.log1p(sample.counts[shown].astype(np.float32))
        self.points, self.packet = _points(sample, segment, config.model)


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


class FrameBatch(NamedTuple):
    """Single frames of any trials.

    Attributes:
        frames: [N, channels, rows, columns], as in `SegmentBatch`.
        event_frames: [N, 2, rows, columns], as in `SegmentBatch`.
        force: What each is to tell [N], [N].
    """

    frames: torch.Tensor
    event_frames: torch.Tensor
    force: torch.Tensor


def arrivals(samples: Sequence[PaperSample], trials: Sequence[int]) -> NDArray[np.int64]:
    """Return trial and window of every frame that arrives in one of these trials, int64 [N, 2]."""
    found = [np.flatnonzero(samples[trial].slots >= 0) for trial in trials]
    return np.stack([np.repeat(trials, [len(each) for each in found]), np.concatenate(found)], 1)


def frame_batch(
    samples: Sequence[PaperSample], chosen: NDArray[np.int64], config: PaperConfig
) -> FrameBatch:
    """Return single frames, sorted by trial.

    The label of a frame is the mean force of its exposure: what it shows. For `fusion`, which knows
    the events up to then, it is the force when the frame arrives.

    Args:
        samples: Samples.
        chosen: Rows of `arrivals`, int64 [N, 2].
        config: Of the network.
    """
    frames, event_frames, force = [], [], []
    for trial in np.unique(chosen[:, 0]):
        sample, windows = samples[trial], np.sort(chosen[chosen[:, 0] == trial, 1])
        used = sample.slots[windows]
        frames.append(sample.seen(used, config))
        shown = used if config.model == 'fusion' else used[:0]
        event_frames.append(np.log1p(sample.counts[shown].astype(np.float32)))
        known = sample.force[windows] if config.model == 'fusion' else sample.frame_force[used]
        force.append(known)
    return FrameBatch(
        _tensor(np.concatenate(frames), np.float32),
        _tensor(np.concatenate(event_frames), np.float32),
        _tensor(np.concatenate(force), np.float32),
    )


STRETCH_WINDOWS = 250
"""Windows that are in memory at a time, of all trials together: half a second of one."""


@torch.no_grad()
def run_samples(network: PaperNetwork, samples: Sequence[PaperSample]) -> list[NDArray[np.float32]]:
    """Return the force [N] at the end of each window of each trial, float32 [T].

    Every trial starts at zero force with an empty memory and runs to its end without any
    knowledge of the true force. Trials run side by side; memory grows with neither their number
    nor their length.

    Args:
        network: In evaluation mode.
        samples: Trials.
    """
    device = next(network.parameters()).device
    parts: list[list[NDArray[np.float32]]] = [[] for _ in samples]
    # Trials that have ended leave; the longest come first.
    left = sorted(range(len(samples)), key=lambda trial: -len(samples[trial].force))
    state, start = network.initial_state(len(left)), 0
    while left:
        shortest = len(samples[left[-1]].force)
        if start == shortest:
            left.pop()
            state = PaperState(*(part[: len(left)] for part in state))
            continue
        stop = min(start + max(STRETCH_WINDOWS // len(left), 1), shortest)
        batch = assemble(samples, [Segment(trial, start, stop) for trial in left], network.config)
        force, state = network(batch.to(device), state)
        for trial, own in zip(left, force.cpu().numpy().T, strict=True):
            parts[trial].append(own)
        start = stop
    return [np.concatenate(each) if each else np.zeros(0, np.float32) for each in parts]
