# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The readout of the array: one event at a time, so bursts come late and in rows.

A crossing is packed into one integer that sorts by time, then row, column and polarity:
(time in the block [ns]) << 18 | pixel << 1 | ON. The arbiter takes 80 ns per event, 12 Mev/s at
most; a pixel that waits to be read cannot fire again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from mixtac_events.arrays import Events
from mixtac_sim.array_geometry import PADDED, WIDTH

if TYPE_CHECKING:
    from numpy.typing import NDArray

SERVICE_NS = 80
"""Time to read one event [ns]: 12 Mev/s (user guide; readout-delay article, 357)."""
LATENCY_NS = 20_000
"""Shortest time from crossing to request [ns] (data sheet: best case about 20 us)."""
JITTER_NS = 15_000.0
"""Standard deviation of the additional latency [ns] (estimate; ICNS model: 10 us)."""


def pack(
    time_ns: NDArray[np.int64], pixel: NDArray[np.int64], on: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return crossings packed into integers; times count from the start of the block [ns]."""
    return np.asarray((time_ns << 18) | (pixel << 1) | on)


class Readout:
    """The queue between pixels and the outside.

    Args:
        service_ns: Time to read one event [ns].
        latency_ns: Shortest time from crossing to request [ns].
        jitter_ns: Standard deviation of the additional latency [ns].

    Attributes:
        lost: Events of pixels that were still waiting to be read.
    """

    def __init__(
        self,
        service_ns: int = SERVICE_NS,
        latency_ns: int = LATENCY_NS,
        jitter_ns: float = JITTER_NS,
    ) -> None:
        self._service_ns, self._latency_ns, self._jitter_ns = service_ns, latency_ns, jitter_ns
        self._free_ns = np.zeros(1, np.int64)
        self._busy_ns = np.zeros(PADDED, np.int64)
        self._early = np.empty(0, np.int64)
        self.lost = 0

    def read(
        self, keys: NDArray[np.int64], block_ns: int, span_ns: int, rng: np.random.Generator
    ) -> Events:
        """Return what leaves the array of the crossings of a block, sorted by time.

        Args:
            keys: Packed crossings of this block, in any order.
            block_ns: Begin of the block [ns] of true time.
            span_ns: Length of the block [ns]; later requests wait for the next block.
            rng: Draws the latencies; a stream of this block alone.
        """
        late = (
            np.abs(rng.normal(0.0, self._jitter_ns, len(keys))).astype(np.int64) + self._latency_ns
        )
        waiting = np.sort(np.concatenate([self._early, keys + (late << 18)]))
        split = int(np.searchsorted(waiting, np.int64(span_ns) << 18))
        self._early = waiting[split:] - (np.int64(span_ns) << 18)
        t, pixel, on, lost = _serve(
            waiting[:split], block_ns, self._service_ns, self._free_ns, self._busy_ns
        )
        self.lost += lost
        row, column = np.divmod(pixel, WIDTH)
        return Events(t, column.astype(np.uint16), row.astype(np.uint16), on)


@njit(cache=True, nogil=True)
def _serve(
    waiting: NDArray[np.int64],
    block_ns: int,
    service_ns: int,
    free_ns: NDArray[np.int64],
    busy_ns: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.bool_], int]:
    """Serve sorted requests one after the other; return time [us], pixel, ON and lost."""
    t = np.empty(waiting.size, np.int64)
    pixel = np.empty(waiting.size, np.int32)
    on = np.empty(waiting.size, np.bool_)
    count, lost = 0, 0
    for key in waiting:
        p = (key >> 1) & 0x1FFFF
        asked = block_ns + (key >> 18)
        if asked < busy_ns[p]:
            lost += 1
            continue
        done = max(asked, free_ns[0]) + service_ns
        free_ns[0] = done
        busy_ns[p] = done
        t[count], pixel[count], on[count] = done // 1000, p, (key & 1) == 1
        count += 1
    return t[:count], pixel[:count], on[:count], lost
