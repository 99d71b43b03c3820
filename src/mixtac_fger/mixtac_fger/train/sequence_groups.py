# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Samples in groups: what is in memory at a time, however many trials there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from mixtac_fger.batches import Sequences, stack
from mixtac_fger.dataset import load_sample, sample_origin, sample_windows
from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mixtac_fger.config import FgerConfig


class SequenceGroups(Protocol):
    """Groups of trials, each side by side as `Sequences`."""

    @property
    def devices(self) -> int:
        """Number of different sensors over all groups."""

    def __len__(self) -> int:
        """Return the number of groups."""

    def load(self, index: int) -> Sequences:
        """Return a group; its device numbers count over all groups."""


@dataclass(frozen=True, slots=True, eq=False)
class MemoryGroups:
    """One group that is in memory.

    Attributes:
        sequences: The group.
    """

    sequences: Sequences

    @property
    def devices(self) -> int:
        """Number of different sensors."""
        return int(self.sequences.device.max()) + 1

    def __len__(self) -> int:
        """Return 1."""
        return 1

    def load(self, index: int) -> Sequences:
        """Return the group."""
        if index:
            raise DatasetError(f'group {index} of one: give 0')
        return self.sequences


class DiskGroups:
    """Groups of sample files; one is in memory at a time.

    Args:
        paths: Sample files.
        config: Network configuration.
        group_size: Trials per group.
        own: Which of the files this process reads; None for all. Groups of all processes are
            equally long, so that they make the same number of updates.
        origins: What is known of each file beyond what it says; None for nothing.
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
        keys = [_device_key(path, index) for index, path in enumerate(paths)]
        order = {key: number for number, key in enumerate(sorted(set(keys)))}
        self._numbers = [order[key] for key in keys]
        self._length = max(sample_windows(path) for path in paths)
        self._paths, self._config = list(paths), config
        self._groups = [chosen[i : i + group_size] for i in range(0, len(chosen), group_size)]
        self._kept: tuple[int, Sequences] | None = None

    @property
    def devices(self) -> int:
        """Number of different sensors over all groups and processes."""
        return max(self._numbers) + 1

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


def _device_key(path: Path, index: int) -> str:
    """Return what tells sensors apart; a trial that says nothing is taken for one of its own."""
    origin = sample_origin(path)
    return str(origin.get('device_seed', origin.get('sensor', f'trial {index}')))
