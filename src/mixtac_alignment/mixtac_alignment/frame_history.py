# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frames of the recent past, reduced and joined with their exposure times, in fixed memory."""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.frame_features import FrameFeatures

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAMES_PER_S: Final = 60
"""Most frames a second that are remembered."""
WAITING: Final = 32
"""Frames, or exposures, that wait for the other half of themselves."""


class FrameHistory:
    """Frames by their stamp; a half without the other is dropped and counted.

    Attributes:
        unmatched: Frames or exposures whose other half never came.

    Args:
        span_s: Time to remember [s].
    """

    def __init__(self, span_s: float) -> None:
        self.unmatched = 0
        self._span_us = round(span_s * 1e6)
        self._images: OrderedDict[int, NDArray[np.float32]] = OrderedDict()
        self._spans: OrderedDict[int, tuple[int, int]] = OrderedDict()
        self._whole: deque[tuple[int, int, NDArray[np.float32]]] = deque(
            maxlen=max(16, round(span_s * FRAMES_PER_S))
        )

    def push_image(self, stamp_ns: int, values: NDArray[np.float32]) -> None:
        """Add the log brightness of a frame, as `reduce_frame` gives it."""
        self._images[stamp_ns] = values
        self._join(stamp_ns)

    def push_exposure(self, stamp_ns: int, start_us: int, end_us: int) -> None:
        """Add when the frame of a stamp was exposed, camera clock [us]."""
        self._spans[stamp_ns] = (start_us, end_us)
        self._join(stamp_ns)

    def snapshot(self) -> FrameFeatures | None:
        """Return the frames, oldest first; none if there are none."""
        if not self._whole:
            return None
        oldest = self._whole[-1][0] - self._span_us
        rows = [row for row in self._whole if row[0] >= oldest]
        start, end = (np.array([row[k] for row in rows], np.int64) for k in (0, 1))
        return FrameFeatures(start, end, np.stack([row[2] for row in rows]))

    def clear(self) -> None:
        """Forget everything."""
        self._images.clear()
        self._spans.clear()
        self._whole.clear()

    def _join(self, stamp_ns: int) -> None:
        if stamp_ns in self._images and stamp_ns in self._spans:
            span, values = self._spans.pop(stamp_ns), self._images.pop(stamp_ns)
            if self._whole and span[0] <= self._whole[-1][0]:
                self._whole.clear()
            self._whole.append((*span, values))
        for waiting in (self._images, self._spans):
            while len(waiting) > WAITING:
                waiting.popitem(last=False)
                self.unmatched += 1
