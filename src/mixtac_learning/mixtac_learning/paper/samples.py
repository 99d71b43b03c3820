# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Training samples of the paper's networks, as memory-mapped arrays on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.frames import bin_mean
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import PaperNetwork, PaperState, SegmentBatch
from mixtac_learning.trials.samples import Recipe
from mixtac_learning.trials.trial import DatasetError, TrialArrays, frame_arrivals, window_ends


def packet_points(
    config: PaperConfig, events: Events, ends: NDArray[np.int64]
) -> tuple[NDArray[np.float16], NDArray[np.int64]]:
    """Return the normalised events of consecutive packets.

    A packet of more than `PaperConfig.events_per_packet` events is thinned out evenly in time
    order.

    Args:
        config: Shapes.
        events: Sorted events, camera clock [us].
        ends: End of each packet [us], `window_us` apart, int64 [T].

    Returns:
        Points float16 [E, 4]: x and y from -1 to 1 across the sensor, time from 0 to 1 within the
        packet, polarity -1 or 1; and where each packet starts among them, int64 [T + 1].
    """
    cuts = np.searchsorted(events.t, [ends[0] - config.window_us, *ends])
    counts = np.diff(cuts)
    kept = np.minimum(counts, config.events_per_packet)
    starts = np.concatenate([[0], np.cumsum(kept)]).astype(np.int64)
    packet = np.repeat(np.arange(len(ends)), kept)
    rank = np.arange(starts[-1]) - starts[packet]
    index = cuts[packet] + rank * counts[packet] // np.maximum(kept[packet], 1)
    points = np.empty((len(index), 4), np.float16)
    points[:, 0] = 2.0 * events.x[index] / (config.width - 1) - 1.0
    points[:, 1] = 2.0 * events.y[index] / (config.height - 1) - 1.0
    points[:, 2] = (events.t[index] - (ends[packet] - config.window_us)) / config.window_us
    points[:, 3] = np.where(events.polarity[index], 1.0, -1.0)
    return points, starts


def event_counts(
    config: PaperConfig, events: Events, borders: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """Return the events between consecutive times as pictures.

    Args:
        config: Shapes.
        events: Sorted events, camera clock [us].
        borders: Times [us], increasing, int64 [N + 1].

    Returns:
        Number of ON and of OFF events per pixel of `PaperConfig.frame_shape`, at most 255, uint8
        [N, 2, rows, columns].
    """
    rows, columns = config.frame_shape
    out = np.zeros((len(borders) - 1, 2, rows, columns), np.uint8)
    cuts = np.searchsorted(events.t, borders)
    for index, (start, stop) in enumerate(pairwise(cuts)):
        y = events.y[start:stop].astype(np.int64) // config.scale
        x = events.x[start:stop].astype(np.int64) // config.scale
        inside = (y < rows) & (x < columns)
        channel = np.where(events.polarity[start:stop], 0, 1)
        cell = ((channel * rows + y) * columns + x)[inside]
        counts = np.bincount(cell, minlength=2 * rows * columns)
        out[index] = np.minimum(counts, 255).reshape(2, rows, columns)
    return out


_SEEN = ('width', 'height', 'scale', 'window_us', 'events_per_packet')
"""Fields of the configuration that change what a sample holds."""
FULL_SCALE = 1023.0
"""Largest value of the camera's converter [DN]."""
SETTLE_FRAMES = 5
"""Frames at the beginning of a trial, without contact, that are the reference where one is used;
windows are judged after them."""


@dataclass(frozen=True, slots=True, eq=False)
class PaperSample:
    """One trial; T windows, N frames, arrays mapped from disk.

    Attributes:
        window_end_us: Camera clock [us], int64 [T].
        points: Events, float16 [E, 4]; see `packet_points`.
        starts: Where each window's events begin, int64 [T + 1].
        frames: Intensities of 0 to 1, float16 [N, rows, columns].
        counts: Events since the frame before, uint8 [N, 2, rows, columns].
        slots: Frame that arrives in each window, -1 for none, int64 [T].
        force: Label at the end of each window [N], float32 [T].
        frame_force: Mean label over each exposure [N], float32 [N].
        origin: Where it came from.
    """

    window_end_us: NDArray[np.int64]
    points: NDArray[np.float16]
    starts: NDArray[np.int64]
    frames: NDArray[np.float16]
    counts: NDArray[np.uint8]
    slots: NDArray[np.int64]
    force: NDArray[np.float32]
    frame_force: NDArray[np.float32]
    origin: dict[str, Any]

    def seen(self, frames: NDArray[np.int64], config: PaperConfig) -> NDArray[np.float32]:
        """Return frames as `frame_input` does.

        Args:
            frames: Their numbers, int64 [n].
            config: Configuration of the network.
        """
        return frame_input(self.frames[frames], self.frames[:SETTLE_FRAMES], config)


def paper_recipe(config: PaperConfig) -> Recipe:
    """Return the recipe of the samples of the paper's networks."""
    seen = {name: getattr(config, name) for name in _SEEN}
    return Recipe('paper', config, make_paper_sample, {'kind': 'paper 2'} | seen)


def make_paper_sample(config: PaperConfig, trial: TrialArrays) -> PaperSample:
    """Return the network inputs of a trial, from the arrival of its first frame to the end.

    Args:
        config: Shapes.
        trial: Events, frames, forces.

    Raises:
        DatasetError: The trial has no known force, no frames, frames of another size, or ends
            before its first frame arrives.
    """
    label = trial.label()
    shape = trial.frames.shape[1:]
    if len(trial.frames) < 2 or shape != (config.height, config.width):
        raise DatasetError(
            f'trial {trial.origin.get("name")} has {len(trial.frames)} frames of {shape}: at least'
            f' 2 of {config.height} rows and {config.width} columns are needed'
        )
    ends = window_ends(trial, label, config.window_us, int(trial.arrival_us[0]))
    slots = frame_arrivals(trial.arrival_us, ends)
    points, starts = packet_points(config, trial.events, ends)
    arrival = trial.arrival_us
    borders = np.concatenate([[arrival[0] - (arrival[1] - arrival[0])], arrival])
    return PaperSample(
        window_end_us=ends,
        points=points,
        starts=starts,
        frames=_reduced(config, trial.frames),
        counts=event_counts(config, trial.events, borders),
        slots=slots,
        force=label.at(ends),
        frame_force=label.mean(trial.exposure_start_us, trial.exposure_end_us),
        origin=trial.origin,
    )


def frame_input(
    frames: NDArray[np.float16], still: NDArray[np.float16], config: PaperConfig
) -> NDArray[np.float32]:
    """Return frames as the input of `FrameBackbone`, [n, 1, rows, columns].

    Args:
        frames: Intensities of 0 to 1, float16 [n, rows, columns].
        still: Frames without contact, whose mean is the reference; the same shape.
        config: Configuration of the network, whose `light` decides.
    """
    seen = frames.astype(np.float32)
    if config.light == 'reference':
        rest = np.mean(still, axis=0, dtype=np.float32)
        # Above zero: the converter's lowest bit.
        seen /= np.maximum(rest, np.float32(1.0 / FULL_SCALE))
    return seen[:, None]


def _reduced(config: PaperConfig, frames: NDArray[np.uint16]) -> NDArray[np.float16]:
    mean = np.empty(config.frame_shape, np.float32)
    out = np.empty((len(frames), *config.frame_shape), np.float16)
    for index, frame in enumerate(frames):
        bin_mean(frame, config.scale, mean)
        out[index] = mean / FULL_SCALE
    return out


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
    parts, slots, count = [], [], 0
    for column, segment in enumerate(segments):
        sample, rows = samples[segment.trial], slice(segment.start, segment.stop)
        # Frames by their numbers: those that arrive, and the latest before.
        named = np.append(sample.slots[rows], sample.slots[: segment.start].max(initial=-1))
        if config.model == 'events':
            named[:] = -1
        used = np.unique(named[named >= 0])
        slots.append(np.where(named >= 0, np.searchsorted(used, named) + count, -1))
        count += len(used)
        frames = features[segment.trial][used] if features else sample.seen(used, config)
        shown = used if config.model == 'fusion' else used[:0]
        pictures = np.log1p(sample.counts[shown].astype(np.float32))
        starts = sample.starts[segment.start : segment.stop + 1]
        if config.model not in {'fger', 'events'}:
            starts = starts[:1]
        packet = np.repeat(np.arange(len(starts) - 1), np.diff(starts)) * len(segments) + column
        parts.append((sample.points[starts[0] : starts[-1]], packet, frames, pictures))
    joined = [np.concatenate(each) for each in zip(*parts, strict=True)]
    table = torch.from_numpy(np.stack(slots, 1))
    return SegmentBatch(
        points=_tensor(joined[0]),
        packet=torch.from_numpy(joined[1]),
        frames=_tensor(joined[2]),
        event_frames=_tensor(joined[3]),
        slots=table[:-1],
        before=table[-1],
        force=_tensor(np.stack([samples[s.trial].force[s.start : s.stop] for s in segments], 1)),
    )


def _tensor(array: NDArray[np.generic]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


class FrameBatch(NamedTuple):
    """Single frames of any trials.

    Attributes:
        frames: [N, 1, rows, columns], as in `SegmentBatch`.
        event_frames: [N, 2, rows, columns], as in `SegmentBatch`.
        force: Force that each shows [N], [N].
    """

    frames: torch.Tensor
    event_frames: torch.Tensor
    force: torch.Tensor


def arrivals(samples: Sequence[PaperSample]) -> NDArray[np.int64]:
    """Return trial and window of every frame that arrives, int64 [N, 2]."""
    found = [np.flatnonzero(sample.slots >= 0) for sample in samples]
    trials = np.repeat(np.arange(len(found)), [len(each) for each in found])
    return np.stack([trials, np.concatenate(found)], 1)


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
    fused, parts = config.model == 'fusion', []
    for trial in np.unique(chosen[:, 0]):
        sample, windows = samples[trial], np.sort(chosen[chosen[:, 0] == trial, 1])
        used = sample.slots[windows]
        counts = sample.counts[used if fused else used[:0]].astype(np.float32)
        force = sample.force[windows] if fused else sample.frame_force[used]
        parts.append((sample.seen(used, config), np.log1p(counts), force))
    return FrameBatch(*(_tensor(np.concatenate(each)) for each in zip(*parts, strict=True)))


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
