# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frame network in a thread of its own, so that event windows never wait for it."""

from __future__ import annotations

import queue
import threading
from typing import TYPE_CHECKING

import torch

from mixtac_fger.errors import ImageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mixtac_fger.frame_encoder import EncodedFrame, FrameEncoder

    Image = NDArray[np.uint8] | NDArray[np.uint16]


class FrameWorker:
    """Encodes the latest frame in the background; at most one waits, newer ones replace it.

    Attributes:
        dropped: Frames replaced by a newer one before they were encoded.
        refused: Frames of a size that the model does not read.
        problem: Why the latest of these was refused.

    Args:
        encoder: Shared with the owner for its reference.
    """

    def __init__(self, encoder: FrameEncoder) -> None:
        self._encoder = encoder
        self._inbox: queue.Queue[tuple[Image, int] | None] = queue.Queue()
        self._outbox: queue.SimpleQueue[EncodedFrame] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name='fger_frames', daemon=True)
        self.dropped = 0
        self.refused = 0
        self.problem = ''
        self._thread.start()

    def push(self, image: Image, mid_us: int) -> None:
        """Hand over a frame; the caller must not change `image` afterwards."""
        try:
            while self._inbox.get_nowait() is not None:
                self.dropped += 1
        except queue.Empty:
            pass
        self._inbox.put((image, mid_us))

    def results(self) -> list[EncodedFrame]:
        """Return the frames encoded since the last call, oldest first."""
        found = []
        while True:
            try:
                found.append(self._outbox.get_nowait())
            except queue.Empty:
                return found

    def close(self) -> None:
        """End the thread."""
        self._inbox.put(None)
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        torch.set_num_threads(1)
        while (job := self._inbox.get()) is not None:
            try:
                encoded = self._encoder.encode(*job)
            except ImageError as error:
                self.refused += 1
                self.problem = str(error)
                continue
            if encoded is not None:
                self._outbox.put(encoded)
