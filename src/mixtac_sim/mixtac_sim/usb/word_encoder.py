# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events and readout blocks to the camera's 16-bit stream words, in the order of the FPGA.

A timestamp word precedes a stamped word only when the time changed; a wrap word goes out every
32,768 us whether or not anything happened. Times are int64 microseconds on the camera clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numba import njit

from mixtac_events.arrays import Events

if TYPE_CHECKING:
    from numpy.typing import NDArray

TIMESTAMP_RESET_WORD: Final = 0x0001
_WRAP_US: Final = 0x8000
_WRAP_WORD: Final = 0x7000
_STAMP_WORD: Final = 0x8000
_ROW_WORD: Final = 0x1000
_COLUMN_WORD: Final = 0x2000
_ON: Final = 0x1000
_MAX_WRAPS: Final = 0xFFF
_BASE, _LAST, _ROW, _ROW_TIME, _ROWS_SENT = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Readout words that belong together, cut where other words may come between.

    Attributes:
        t: Time of each block [us, int64, camera clock], non-decreasing.
        stamped: Whether the first word of the block is one that the FPGA stamps.
        end: One past each block's last word in ``words``.
        words: ``uint16`` stream words of all blocks.
    """

    t: NDArray[np.int64]
    stamped: NDArray[np.bool_]
    end: NDArray[np.int64]
    words: NDArray[np.uint16]

    @classmethod
    def empty(cls) -> Blocks:
        """Return no blocks."""
        return cls(
            np.empty(0, np.int64),
            np.empty(0, np.bool_),
            np.empty(0, np.int64),
            np.empty(0, np.uint16),
        )

    @classmethod
    def from_lists(cls, times: list[int], stamped: list[bool], words: list[list[int]]) -> Blocks:
        """Build blocks from one entry per block."""
        flat = [word for block in words for word in block]
        ends = np.cumsum([len(block) for block in words], dtype=np.int64)
        return cls(
            np.array(times, np.int64), np.array(stamped, np.bool_), ends, np.array(flat, np.uint16)
        )

    @classmethod
    def merge(cls, parts: list[Blocks]) -> Blocks:
        """Return the blocks of all parts in order of time; equal times keep the order given."""
        parts = [part for part in parts if len(part.t)]
        if not parts:
            return cls.empty()
        offsets = np.cumsum([0] + [len(part.words) for part in parts])
        t = np.concatenate([part.t for part in parts])
        end = np.concatenate([part.end + at for part, at in zip(parts, offsets, strict=False)])
        order = np.argsort(t, kind='stable')
        words = np.concatenate([part.words for part in parts])
        stamped = np.concatenate([part.stamped for part in parts])
        if np.array_equal(order, np.arange(len(t))):
            return cls(t, stamped, end, words)
        return cls(t[order], stamped[order], *_reordered(words, end, order))

    def split(self, before_us: int) -> tuple[Blocks, Blocks]:
        """Cut into the blocks before a time [us, camera clock] and the rest."""
        cut = int(np.searchsorted(self.t, before_us))
        word = int(self.end[cut - 1]) if cut else 0
        early = Blocks(self.t[:cut], self.stamped[:cut], self.end[:cut], self.words[:word])
        late = Blocks(self.t[cut:], self.stamped[cut:], self.end[cut:] - word, self.words[word:])
        return early, late


@njit(cache=True, nogil=True)
def _reordered(
    words: NDArray[np.uint16], end: NDArray[np.int64], order: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    out = np.empty_like(words)
    ends = np.empty_like(end)
    n = 0
    for k in range(len(order)):
        block = order[k]
        start = end[block - 1] if block > 0 else 0
        for i in range(start, end[block]):
            out[n] = words[i]
            n += 1
        ends[k] = n
    return ends, out


@njit(cache=True, nogil=True)
def _wrap(t: int, state: NDArray[np.int64], coalesce: bool, out: NDArray[np.uint16], n: int) -> int:
    while t - state[_BASE] >= _WRAP_US:
        count = min((t - state[_BASE]) // _WRAP_US, _MAX_WRAPS) if coalesce else 1
        state[_BASE] += count * _WRAP_US
        state[_LAST] = state[_BASE]
        out[n] = _WRAP_WORD | count
        n += 1
    return n


@njit(cache=True, nogil=True)
def _stamp(
    t: int, state: NDArray[np.int64], coalesce: bool, out: NDArray[np.uint16], n: int
) -> int:
    n = _wrap(t, state, coalesce, out, n)
    # The FPGA's time never runs backwards: a late word takes the time of the one before it.
    if t > state[_LAST]:
        state[_LAST] = t
        out[n] = _STAMP_WORD | (t - state[_BASE])
        n += 1
    return n


@njit(cache=True, nogil=True)
def _row(
    t: int, row: int, state: NDArray[np.int64], coalesce: bool, out: NDArray[np.uint16], n: int
) -> int:
    # Several events of one row at one time share the row word.
    if row != state[_ROW] or max(t, state[_LAST]) != state[_ROW_TIME]:
        n = _stamp(t, state, coalesce, out, n)
        state[_ROW] = row
        state[_ROW_TIME] = state[_LAST]
        state[_ROWS_SENT] += 1
        out[n] = _ROW_WORD | row
        n += 1
    return n


@njit(cache=True, nogil=True)
def _encode(
    t: NDArray[np.int64],
    row: NDArray[np.uint16],
    column: NDArray[np.uint16],
    on: NDArray[np.bool_],
    block_t: NDArray[np.int64],
    stamped: NDArray[np.bool_],
    end: NDArray[np.int64],
    words: NDArray[np.uint16],
    state: NDArray[np.int64],
    coalesce: bool,
    out: NDArray[np.uint16],
) -> int:
    n = 0
    block = 0
    start = 0
    for i in range(len(t) + 1):
        while block < len(block_t) and (i == len(t) or block_t[block] < t[i]):
            if stamped[block]:
                n = _stamp(block_t[block], state, coalesce, out, n)
            for k in range(start, end[block]):
                out[n] = words[k]
                n += 1
            start = end[block]
            block += 1
        if i < len(t):
            n = _row(t[i], row[i], state, coalesce, out, n)
            out[n] = _COLUMN_WORD | column[i] | (_ON if on[i] else 0)
            n += 1
    return n


class WordEncoder:
    """Turns events and readout blocks into one continuous word stream.

    Args:
        inverted: Row words carry x and column words y, as in the retail chip.
    """

    def __init__(self, *, inverted: bool) -> None:
        self._inverted = inverted
        self._state = np.zeros(5, np.int64)
        self._out = np.empty(1 << 16, np.uint16)
        self.reset()
        # The first calls compile, or load what was compiled: not while data wait.
        self.encode(Events.empty(), Blocks.empty(), 0)
        pair = Blocks.from_lists([0, 0], [True, True], [[0], [0]])
        _reordered(pair.words, pair.end, np.zeros(2, np.int64))

    @property
    def rows_sent(self) -> int:
        """How many row words were written since construction."""
        return int(self._state[_ROWS_SENT])

    def reset(self) -> None:
        """Restart time at zero; the caller sends the reset word."""
        rows = self._state[_ROWS_SENT]
        self._state[:] = (0, 0, -1, -1, rows)

    def save(self) -> NDArray[np.int64]:
        """Return the state for `restore`."""
        return self._state.copy()

    def restore(self, state: NDArray[np.int64]) -> None:
        """Go back to a state, as if what was encoded since had not been."""
        self._state[:] = state

    def encode(
        self,
        events: Events,
        blocks: Blocks,
        until_us: int,
        *,
        coalesce: bool = False,
    ) -> NDArray[np.uint16]:
        """Encode everything up to a time, wraps included.

        Args:
            events: Sorted by ``t`` [us, camera clock].
            blocks: Readout blocks sorted by time.
            until_us: Time [us, camera clock] up to which wraps are due.
            coalesce: Send missed wraps as one word with a count, as after a stalled transfer.

        Returns:
            Stream words, ``uint16``; a view that the next call overwrites.
        """
        wraps = max(0, until_us - int(self._state[_BASE])) // _WRAP_US + 2
        if len(events):
            wraps += max(0, int(events.t[-1]) - int(self._state[_BASE])) // _WRAP_US
        needed = 3 * len(events) + len(blocks.t) + len(blocks.words) + wraps
        if needed > len(self._out):
            self._out = np.empty(2 * needed, np.uint16)
        row, column = (events.x, events.y) if self._inverted else (events.y, events.x)
        count = _encode(
            *(events.t, row, column, events.polarity),
            *(blocks.t, blocks.stamped, blocks.end, blocks.words),
            *(self._state, coalesce, self._out),
        )
        count = _wrap(until_us, self._state, coalesce, self._out, count)
        return self._out[:count]
