# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A thread that encodes frames beside the 500 Hz step."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections import deque
from typing import TYPE_CHECKING

from mixtac_core.node.images import ImageConversionError
from mixtac_core.node.process import lower_priority
from mixtac_fger.features import ImageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_fger.estimator import EncodedFrame, Estimator, Image

UNFETCHED_FRAMES = 4
"""Encoded frames that wait to be fetched; beyond that the oldest are dropped."""
NICENESS = 5
"""Niceness of the frame thread, so that the 500 Hz step wins on a busy CPU."""


class FrameWorker:
    """Encodes the latest frame in the background; at most one waits, newer ones replace it.

    Attributes:
        refused: Frames of a size that the model does not read, or damaged ones.
        problem: Why the latest of these was refused.

    Args:
        estimator: Its `encode` is called in the thread.
    """

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator
        self._inbox: queue.Queue[tuple[Image | Callable[[], Image], int] | None] = queue.Queue()
        self._outbox: deque[EncodedFrame] = deque()
        self._thread = threading.Thread(target=self._run, name='fger_frames', daemon=True)
        self._replaced = self._unfetched = self.refused = 0
        self.problem = ''
        self._closed = False
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs, or was ended on purpose."""
        return self._closed or self._thread.is_alive()

    @property
    def dropped(self) -> int:
        """Frames replaced by a newer one before they were encoded or fetched."""
        return self._replaced + self._unfetched

    def push(self, image: Image | Callable[[], Image], mid_us: int) -> None:
        """Add a frame, see `ForceEstimator.push_frame`."""
        with contextlib.suppress(queue.Empty):
            while self._inbox.get_nowait() is not None:
                self._inbox.task_done()
                self._replaced += 1
        self._inbox.put((image, mid_us))

    def results(self) -> list[EncodedFrame]:
        """Return the frames encoded since the last call, oldest first."""
        found = []
        # The thread may remove one in between, when too many wait.
        with contextlib.suppress(IndexError):
            while self._outbox:
                found.append(self._outbox.popleft())
        return found

    def wait(self) -> None:
        """Wait until every frame pushed so far is encoded or the thread has ended."""
        while self._inbox.unfinished_tasks and self._thread.is_alive():
            self._thread.join(timeout=0.001)

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self._inbox.put(None)
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        lower_priority(NICENESS)
        while (job := self._inbox.get()) is not None:
            image, mid_us = job
            try:
                encoded = self._estimator.encode(seen(image), mid_us)
            except (ImageError, ImageConversionError) as error:
                self.refused += 1
                self.problem = str(error)
            else:
                self._add(encoded)
            self._inbox.task_done()

    def _add(self, frame: EncodedFrame | None) -> None:
        if frame is None:
            return
        with contextlib.suppress(IndexError):
            while len(self._outbox) >= UNFETCHED_FRAMES:
                self._outbox.popleft()
                self._unfetched += 1
        self._outbox.append(frame)


def seen(image: Image | Callable[[], Image]) -> Image:
    """Return an image, or what a function returns."""
    return image() if callable(image) else image
