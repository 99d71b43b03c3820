# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise events (shot noise, hot pixels, bursts from frames) and the readout queue of the array.

A crossing is packed into one integer that sorts by time, then row, column and polarity:
(time in the block [ns]) << 18 | pixel << 1 | ON. The arbiter takes 80 ns per event, 12 Mev/s at
most, so bursts come late and in rows; a pixel that waits to be read cannot fire again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_sim.grids import PADDED, PIXELS, WIDTH, BlockStreams
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread


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

    def __init__(self, service_ns: int, latency_ns: int, jitter_ns: float) -> None:
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
            block_ns: Start of the block [ns of true time].
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


BURST_NS = 60_000
"""Time over which a frame's reset or readout disturbs pixels [ns] (estimate)."""


class NoiseSource:
    """Noise events, block by block; the light at rest sets their rates.

    Args:
        light_lux: Light at rest [pixels] [lx].
        settings: Settings of the chip.
        spread: Differences between pixels, for its hot pixels.
        frame_burst: Share of pixels that fire when a frame is reset or read.
        seed: Seed of the trial.
    """

    def __init__(
        self,
        light_lux: NDArray[np.float32],
        settings: PixelSettings,
        spread: PixelSpread,
        frame_burst: float,
        seed: int,
    ) -> None:
        # Shot noise, both polarities [Hz]; less in the light.
        rate_hz = settings.shot_hz / (1.0 + light_lux.astype(np.float64) / settings.shot_lux)
        self._cumulative = np.cumsum(rate_hz)
        self._hot_pixel = spread.hot_pixel.astype(np.int64)
        self._hot = np.cumsum(spread.hot_hz)
        self._frame_burst = frame_burst
        self._streams = BlockStreams(seed, 'noise events')

    def block(self, index: int, span_ns: int, bursts_ns: Sequence[int]) -> NDArray[np.int64]:
        """Return the packed noise events of one block.

        Args:
            index: Number of the block.
            span_ns: Length of the block [ns].
            bursts_ns: Resets and readouts of frames in it, from its start [ns].
        """
        rng = self._streams.block(index)
        parts = [self._shot(rng, span_ns), self._hot_events(rng, span_ns)]
        parts += [self._burst(rng, at) for at in bursts_ns]
        return np.concatenate(parts)

    def _shot(self, rng: np.random.Generator, span_ns: int) -> NDArray[np.int64]:
        count = rng.poisson(self._cumulative[-1] * 1e-9 * span_ns)
        drawn = rng.random(count) * self._cumulative[-1]
        pixel = np.minimum(np.searchsorted(self._cumulative, drawn), PIXELS - 1)
        return pack(rng.integers(0, span_ns, count), pixel, rng.integers(0, 2, count))

    def _hot_events(self, rng: np.random.Generator, span_ns: int) -> NDArray[np.int64]:
        if not len(self._hot):
            return np.empty(0, np.int64)
        count = rng.poisson(self._hot[-1] * 1e-9 * span_ns)
        chosen = np.searchsorted(self._hot, rng.random(count) * self._hot[-1])
        pixel = self._hot_pixel[np.minimum(chosen, len(self._hot_pixel) - 1)]
        return pack(rng.integers(0, span_ns, count), pixel, np.ones(count, np.int64))

    def _burst(self, rng: np.random.Generator, at_ns: int) -> NDArray[np.int64]:
        count = rng.poisson(self._frame_burst * PIXELS)
        times = at_ns + rng.integers(0, BURST_NS, count)
        return pack(times, rng.integers(0, PIXELS, count), rng.integers(0, 2, count))
