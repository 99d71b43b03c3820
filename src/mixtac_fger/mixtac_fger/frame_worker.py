# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frame network in a thread of its own, so that event windows never wait for it."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
from collections import deque
from typing import TYPE_CHECKING

from mixtac_fger.errors import ImageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_fger.frame_encoder import EncodedFrame, FrameEncoder

    Image = NDArray[np.uint8] | NDArray[np.uint16]


WAITING_RESULTS = 4
"""Encoded frames that wait to be fetched; of more the oldest are dropped."""
NICENESS = 5
"""Of the thread: where processors are scarce, 500 Hz windows come before 25 Hz frames."""


class FrameWorker:
    """Encodes the latest frame in the background; at most one waits, newer ones replace it.

    Attributes:
        refused: Frames of a size that the model does not read.
        problem: Why the latest of these was refused.

    Args:
        encoder: Shared with the owner for its reference.
    """

    def __init__(self, encoder: FrameEncoder) -> None:
        self._encoder = encoder
        self._inbox: queue.Queue[tuple[Image, int] | None] = queue.Queue()
        self._outbox: deque[EncodedFrame] = deque()
        self._thread = threading.Thread(target=self._run, name='fger_frames', daemon=True)
        self._replaced = self._unfetched = 0
        self.refused = 0
        self.problem = ''
        self._closed = False
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs, or has been ended on purpose."""
        return self._closed or self._thread.is_alive()

    @property
    def dropped(self) -> int:
        """Frames replaced by a newer one before they were encoded or fetched."""
        return self._replaced + self._unfetched

    def push(self, image: Image, mid_us: int) -> None:
        """Hand over a frame; the caller must not change `image` afterwards."""
        try:
            while self._inbox.get_nowait() is not None:
                self._replaced += 1
        except queue.Empty:
            pass
        self._inbox.put((image, mid_us))

    def results(self) -> list[EncodedFrame]:
        """Return the frames encoded since the last call, oldest first."""
        found = []
        while True:
            try:
                found.append(self._outbox.popleft())
            except IndexError:
                return found

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self._inbox.put(None)
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while (job := self._inbox.get()) is not None:
            try:
                encoded = self._encoder.encode(*job)
            except ImageError as error:
                self.refused += 1
                self.problem = str(error)
                continue
            if encoded is not None:
                self._hand_out(encoded)

    def _hand_out(self, frame: EncodedFrame) -> None:
        with contextlib.suppress(IndexError):
            while len(self._outbox) >= WAITING_RESULTS:
                self._outbox.popleft()
                self._unfetched += 1
        self._outbox.append(frame)
