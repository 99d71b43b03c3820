# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Groups of trials in memory, in place of `mixtac_learning.train.frame_stage.DiskGroups`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mixtac_learning.train.frame_stage import Sequences


@dataclass
class Groups:
    """Groups in memory; `devices` is counted in the first where it is 0."""

    all: list[Sequences]
    devices: int = 0

    def __post_init__(self) -> None:
        self.devices = self.devices or int(self.all[0].device.max()) + 1

    def __len__(self) -> int:
        return len(self.all)

    def load(self, index: int) -> Sequences:
        return self.all[index]
