# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sequences side by side for training, in memory or in groups from disk, and mirrored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mixtac_fger.config import FgerConfig
from mixtac_learning.network import FrameSlots
from mixtac_learning.trials.samples import Sample, load_sample, sample_origin, sample_windows
from mixtac_learning.trials.trial import DatasetError, sensor_of


@dataclass(frozen=True, slots=True, eq=False)
class Sequences:
    """B trials side by side, padded at their ends to T windows.

    Attributes:
        event_features: float16 [T, B, grid rows, grid columns, 4].
        force: Labels [N], float32 [T, B].
        across: Sideways force x, y [N] and torsion [N mm], nan where unknown, float32 [T, B, 3].
        valid: False in the padding, bool [T, B].
        slots: Frames by index into `frame_inputs`.
        frame_inputs: All frames of all trials, float16 [N, channels, rows, columns].
        frame_moments: Moments of each frame (`mixtac_fger.moments`), float32 [N, 9 or 0].
        frame_force: Mean label per exposure [N], float32 [N].
        frame_across: As `across`, at the centre of each exposure, float32 [N, 3].
        frame_trial: Which trial each frame belongs to, int64 [N].
        device: Which sensor each trial was made with, counted from 0, int64 [B].
    """

    event_features: Tensor
    force: Tensor
    across: Tensor
    valid: Tensor
    slots: FrameSlots
    frame_inputs: Tensor
    frame_moments: Tensor
    frame_force: Tensor
    frame_across: Tensor
    frame_trial: Tensor
    device: Tensor

    def to(self, target: torch.device) -> Sequences:
        """Return the sequences with everything that is computed with on a device."""
        if target.type == 'cpu':
            return self
        moved = {name: getattr(self, name).to(target) for name in self.__slots__ if name != 'slots'}
        return Sequences(**moved, slots=FrameSlots(*(part.to(target) for part in self.slots)))


def stack(
    samples: Sequence[Sample],
    devices: Sequence[int] | None = None,
    length: int | None = None,
) -> Sequences:
    """Put trials side by side.

    Args:
        samples: Trials.
        devices: Number of the sensor of each; None if each is of another.
        length: Windows to pad to; None for those of the longest.
    """
    if length is None:
        length = max(len(sample.force) for sample in samples)
    counts = [len(sample.frame_force) for sample in samples]
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])

    def padded(name: str, fill: int = 0) -> Tensor:
        arrays = [getattr(sample, name) for sample in samples]
        out = np.full((length, len(arrays), *arrays[0].shape[1:]), fill, arrays[0].dtype)
        for column, array in enumerate(arrays):
            out[: len(array), column] = array
        return torch.from_numpy(out)

    index = padded('slots', -1)
    shifted = torch.where(index >= 0, index + torch.from_numpy(starts), -1)
    lengths = torch.tensor([len(sample.force) for sample in samples])
    joined = ('frame_inputs', 'frame_moments', 'frame_force', 'frame_across')
    return Sequences(
        **{name: padded(name) for name in ('event_features', 'force', 'across')},
        **{
            name: torch.from_numpy(np.concatenate([getattr(sample, name) for sample in samples]))
            for name in joined
        },
        valid=torch.arange(length)[:, None] < lengths[None],
        slots=FrameSlots(shifted, padded('lags')),
        frame_trial=torch.repeat_interleave(torch.arange(len(samples)), torch.tensor(counts)),
        device=torch.tensor(list(range(len(samples)) if devices is None else devices)),
    )


def mirror_frames(frames: Tensor, config: FgerConfig, columns: bool, rows: bool) -> Tensor:
    """Return network inputs [..., channels, rows, columns] as a mirrored sensor would give them."""
    axes = [axis for axis, wanted in ((-2, rows), (-1, columns)) if wanted]
    turned = {'flow_x': columns, 'flow_y': rows}
    signs = [-1.0 if turned.get(name, False) else 1.0 for name in config.frame_channels]
    sign = torch.tensor(signs, dtype=frames.dtype, device=frames.device)
    return frames.flip(axes) * sign[:, None, None]


def mirror_events(features: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return grid features [..., rows, columns, 4] as a mirrored sensor would give them."""
    axes = [axis for axis, wanted in ((-3, rows), (-2, columns)) if wanted]
    signs = [-1.0 if columns else 1.0, -1.0 if rows else 1.0, 1.0, 1.0]
    return features.flip(axes) * torch.tensor(signs, dtype=features.dtype, device=features.device)


def mirror_moments(moments: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return moments of frames [..., 9] as a mirrored sensor would give them."""
    right, up = (-1.0 if each else 1.0 for each in (columns, rows))
    turned = [right * up] * (moments.shape[-1] - 5)
    return moments * moments.new_tensor([1.0, right, up, right, up, *turned][: moments.shape[-1]])


def mirror_across(values: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return sideways force and torsion [..., 3] of a mirrored sensor."""
    signs = [-1.0 if each else 1.0 for each in (columns, rows, columns != rows)]
    return values * torch.tensor(signs, dtype=values.dtype, device=values.device)


class DiskGroups:
    """Groups of sample files; one is in memory at a time.

    Args:
        paths: Sample files.
        config: Network configuration.
        group_size: Trials per group.
        own: Which of the files this process reads; None for all. Groups of all processes are
            equally long, so that they make the same number of updates.

    Attributes:
        devices: Number of different sensors over all groups and processes.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        config: FgerConfig,
        group_size: int,
        own: Sequence[int] | None = None,
    ) -> None:
        chosen = list(range(len(paths)) if own is None else own)
        if not chosen:
            raise DatasetError(
                f'{len(paths)} trials are too few to share: start fewer processes, or give more'
            )
        origins = [sample_origin(path) for path in paths]
        keys = [sensor_of(each, f'trial {index}') for index, each in enumerate(origins)]
        order = {key: number for number, key in enumerate(sorted(set(keys)))}
        self._numbers = [order[key] for key in keys]
        self.devices = len(order)
        self._length = max(sample_windows(path) for path in paths)
        self._paths, self._config = list(paths), config
        self._groups = [chosen[i : i + group_size] for i in range(0, len(chosen), group_size)]
        self._kept: tuple[int, Sequences] | None = None

    def __len__(self) -> int:
        """Return the number of groups."""
        return len(self._groups)

    def load(self, index: int) -> Sequences:
        """Return a group, from memory where it was the last.

        Raises:
            DatasetError: A file was removed or damaged meanwhile.
        """
        if self._kept is None or self._kept[0] != index:
            self._kept = None
            members = self._groups[index]
            samples = [load_sample(self._paths[i], self._config) for i in members]
            numbers = [self._numbers[i] for i in members]
            self._kept = index, stack(samples, numbers, self._length)
        return self._kept[1]
