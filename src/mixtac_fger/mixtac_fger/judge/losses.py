# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What gets lost on the way from the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Losses:
    """Losses of a trial; a packet holds the events of one window.

    Attributes:
        frame_part: Part of the frames that is lost, at random.
        packet_part: Part of the packets that is lost, at random.
        gaps_us: Beginnings of gaps in which everything is lost, camera clock [us].
        gap_us: Length of each gap [us].
        seed: Of the random losses.
    """

    frame_part: float = 0.0
    packet_part: float = 0.0
    gaps_us: tuple[int, ...] = ()
    gap_us: int = 200_000
    seed: int = 0

    def lost_frames(self, arrival_us: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which frames are lost, by their arrival [us, camera clock], [N]."""
        random = np.random.default_rng((self.seed, 1))
        chosen = random.random(len(arrival_us)) < self.frame_part
        return np.asarray(chosen | self.in_gap(arrival_us))

    def lost_packets(self, end_us: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which packets are lost, by their ends [us, camera clock], [T]."""
        random = np.random.default_rng((self.seed, 2))
        chosen = random.random(len(end_us)) < self.packet_part
        return np.asarray(chosen | self.in_gap(end_us))

    def in_gap(self, t_us: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which times are after the beginning of a gap and not after its end."""
        inside = np.zeros(len(t_us), np.bool_)
        for begin in self.gaps_us:
            inside |= (t_us > begin) & (t_us <= begin + self.gap_us)
        return inside
