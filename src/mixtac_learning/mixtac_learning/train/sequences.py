# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sequences to train FGER-Net on: trials side by side, in groups from disk, mirrored at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from mixtac_fger.config import PRESSES, TURNING_WIDTHS
from mixtac_learning.network import FgerNetwork, FrameSlots
from mixtac_learning.train.config import TrainingSettings
from mixtac_learning.train.frame_fit import Frames
from mixtac_learning.trials.samples import Sample, load_sample
from mixtac_learning.trials.trial import sensor_of


@dataclass(frozen=True, slots=True, eq=False)
class Sequences:
    """B trials side by side, padded at their ends to T windows.

    Attributes:
        event_features: float16 [T, B, grid rows, grid columns, 4].
        force: Labels [N], float32 [T, B].
        across: Sideways force x, y [N] and torsion [N mm], nan where unknown, float32 [T, B, 3].
        valid: False in the padding, bool [T, B].
        slots: Frames by index into `frame_moments`.
        frame_moments: Moments of all frames of all trials (`mixtac_fger.moments`), float32 [N, 14].
        device: Which sensor each trial was made with, counted from 0, int64 [B].
    """

    event_features: Tensor
    force: Tensor
    across: Tensor
    valid: Tensor
    slots: FrameSlots
    frame_moments: Tensor
    device: Tensor

    def to(self, target: torch.device) -> Sequences:
        """Return the sequences with everything that is computed with on a device."""
        moved = {name: getattr(self, name).to(target) for name in self.__slots__ if name != 'slots'}
        return Sequences(**moved, slots=FrameSlots(*(part.to(target) for part in self.slots)))


def stack(samples: Sequence[Sample], devices: Sequence[int], length: int) -> Sequences:
    """Put trials side by side.

    Args:
        samples: Trials.
        devices: Number of the sensor of each.
        length: Windows to pad to.
    """
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
    return Sequences(
        **{name: padded(name) for name in ('event_features', 'force', 'across')},
        frame_moments=torch.from_numpy(np.concatenate([each.frame_moments for each in samples])),
        valid=torch.arange(length)[:, None] < lengths[None],
        slots=FrameSlots(shifted, padded('lags')),
        device=torch.tensor(devices),
    )


def mirror_events(features: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return grid features [..., rows, columns, 4] as a mirrored sensor would give them."""
    axes = [axis for axis, wanted in ((-3, rows), (-2, columns)) if wanted]
    signs = [-1.0 if columns else 1.0, -1.0 if rows else 1.0, 1.0, 1.0]
    return features.flip(axes) * torch.tensor(signs, dtype=features.dtype, device=features.device)


def mirror_moments(moments: Tensor, columns: bool, rows: bool) -> Tensor:
    """Return moments of frames [..., 14] as a mirrored sensor would give them."""
    right, up = (-1.0 if each else 1.0 for each in (columns, rows))
    signs = [1.0] * PRESSES + [right, up] * 3 + [1.0] + [right * up] * len(TURNING_WIDTHS)
    return moments * moments.new_tensor(signs)


class DiskGroups:
    """Groups of sample files; one is in memory at a time.

    Args:
        paths: Folders of samples.
        group_size: Trials per group.
        own: Which of the files this process reads; None for all.

    Attributes:
        length: Windows that every trial is padded to.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        group_size: int,
        own: Sequence[int] | None = None,
    ) -> None:
        chosen = list(range(len(paths)) if own is None else own)
        # One at a time is mapped: there may be more files than a process may open.
        facts = [
            (sensor_of(sample.origin, f'trial {index}'), len(sample.force))
            for index, sample in enumerate(load_sample(path, Sample) for path in paths)
        ]
        self._numbers = np.unique([key for key, *_ in facts], return_inverse=True)[1]
        self.length = max(windows for _, windows in facts)
        self._paths = list(paths)
        self._groups = [chosen[i : i + group_size] for i in range(0, len(chosen), group_size)]
        self._kept: tuple[int, Sequences] | None = None

    def __len__(self) -> int:
        """Return the number of groups."""
        return len(self._groups)

    def frames(self) -> Frames:
        """Return the frames of all files, also of those that other processes read."""
        names, parts = ('frame_moments', 'frame_force', 'frame_across'), []
        for path in self._paths:
            # Copied, so that one file at a time is mapped.
            sample = load_sample(path, Sample)
            parts.append([np.array(getattr(sample, name), np.float64) for name in names])
        moments, force, across = (np.concatenate(each) for each in zip(*parts, strict=True))
        sensor = np.repeat(self._numbers, [len(part[1]) for part in parts])
        return Frames(moments, force, across, sensor)

    def load(self, index: int) -> Sequences:
        """Return a group, from memory where it was the last.

        Raises:
            DatasetError: A file was removed or damaged meanwhile.
        """
        if self._kept is None or self._kept[0] != index:
            self._kept = None
            members = self._groups[index]
            samples = [load_sample(self._paths[i], Sample) for i in members]
            numbers = [self._numbers[i] for i in members]
            self._kept = index, stack(samples, numbers, self.length)
        return self._kept[1]


Flip = tuple[bool, bool]
"""Whether columns and rows are mirrored."""


def features_of(network: FgerNetwork, sequences: Sequences, flip: Flip = (False, False)) -> Tensor:
    """Return the features of all frames, or of their mirror images, [N, 14].

    Args:
        network: FGER-Net.
        sequences: Trials.
        flip: Whether to mirror columns and rows.
    """
    return mirror_moments(sequences.frame_moments, *flip) / network.frame.spread


SMALL_N = 0.1
"""Force from which on the knee of the loss is the whole one [N]: below, a contact begins or ends,
and hundredths of a newton matter."""
LEAST_KNEE = 0.2
"""Share of the knee at no force."""


def force_loss(force: Tensor, known: Tensor, knee: float) -> Tensor:
    """Return the loss of each force: quadratic below the knee, linear above it.

    Args:
        force: Estimates [N].
        known: Labels [N], same shape.
        knee: Errors above this count linearly, above a smaller one near no force [N].
    """
    knees = knee * (known.abs() / SMALL_N).clamp(LEAST_KNEE, 1.0)
    error = (force - known).abs()
    return torch.where(error < knees, 0.5 * error.square() / knees, error - 0.5 * knees)


def draw_flips(settings: TrainingSettings, random: torch.Generator) -> Flip:
    """Return whether to mirror columns and rows this time."""
    if not settings.mirror:
        return False, False
    columns, rows = torch.randint(0, 2, (2,), generator=random).tolist()
    return bool(columns), bool(rows)
