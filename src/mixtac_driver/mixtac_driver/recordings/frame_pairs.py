# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recorded frames, and the messages recorded after them that tell when they were exposed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mixtac_driver.recordings import bag_messages as convert

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_driver.recordings.pieces import Piece

PATIENCE = 20
"""Other messages that may pass before a frame goes on without its exposure: 20 ms of packets."""


class FramePairs:
    """Holds a frame back for a moment, until its exposure is there.

    Args:
        waits: False where exposures were not recorded.
    """

    def __init__(self, *, waits: bool) -> None:
        self._waits = waits
        self._held: Piece | None = None
        self._passed = 0
        self._ready: list[Piece] = []

    def add_frame(self, piece: Piece) -> None:
        """Take a piece of one frame."""
        self._release()
        self._held, self._passed = piece, 0
        if not self._waits:
            self._release()

    def add_exposure(self, message: Any, offset_us: int) -> None:  # noqa: ANN401
        """Take a FrameExposure message; that of another frame is left alone.

        Args:
            message: The message.
            offset_us: To subtract from its times to get the recorded camera clock.
        """
        if self._held is None:
            return
        (frame,) = self._held.frames
        if convert.stamp_us(message.header) - offset_us == frame.middle_us:
            exposed = convert.exposed_frame(frame, message, offset_us=offset_us)
            self._held = replace(self._held, frames=(exposed,))
            self._release()

    def pass_by(self) -> None:
        """Say that another message was recorded."""
        self._passed += 1
        if self._passed >= PATIENCE:
            self._release()

    def ready(self) -> Iterator[Piece]:
        """Yield what need not wait any more."""
        while self._ready:
            yield self._ready.pop(0)

    def rest(self) -> Iterator[Piece]:
        """Yield what is left at the end."""
        self._release()
        yield from self.ready()

    def _release(self) -> None:
        if self._held is not None:
            self._ready.append(self._held)
            self._held = None
