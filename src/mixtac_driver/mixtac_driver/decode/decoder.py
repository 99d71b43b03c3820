# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Decoder of the data stream: bytes of USB transfers in; events, frames and samples out.

Words are 16-bit, little-endian and independent of transfers, so everything incomplete is kept from
one transfer to the next. Transfers hold whole words; an odd byte is dropped and counted.

Per transfer, the decoder creates a handful of small Python objects and no array of events: batches
are views of its own arrays. Only frames, inertial samples and edges are copied out.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_core.events.readings import (
    NO_EDGES,
    NO_SAMPLES,
    DecodedBatch,
    Edges,
    Frame,
    InertialSamples,
    inertial_samples,
)
from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.kernel import DONE, FRAME, FULL, RESET, decode_words
from mixtac_driver.decode.state import DecoderCounters, new_buffers

Octets = bytes | bytearray | memoryview | NDArray[Any]
DEFAULT_CAPACITY = 32768
WORD = np.dtype('<u2')


class StreamDecoder:
    """Decodes the stream of one camera.

    Args:
        geometry: Pixel arrays of the camera.
        imu_flips: Axes (x, y, z) of the inertial unit that are reversed.
        imu_type: 1 for MPU6050, 2 for MPU9250.
        capacity: Events per batch; longer bursts are split into several batches.

    Attributes:
        waiting: Whether something was decoded that comes with the next batch.
    """

    def __init__(
        self,
        geometry: Geometry,
        *,
        imu_flips: tuple[bool, bool, bool] = (False, False, False),
        imu_type: int = 2,
        capacity: int = DEFAULT_CAPACITY,
    ) -> None:
        self._geometry = geometry
        self._imu_flips = imu_flips
        self._imu_type = imu_type
        self._buffers = b = new_buffers(geometry, capacity)
        self._state, self._counters, self._readings = b.state[0], b.counters[0], b.readings[0]
        self._image = b.pixels[0]['image']
        x, y = (b.row, b.column) if geometry.dvs_inverted else (b.column, b.row)
        self._events = Events(b.t, x, y, b.polarity.view(np.bool_))
        self._resets = self._held = 0
        self.waiting = False
        # The first call compiles, or loads compiled code: do it now, before data arrive.
        decode_words(self._words(b''), 0, 0, b)

    @property
    def counters(self) -> DecoderCounters:
        """What was dropped or unknown so far."""
        return DecoderCounters(*self._counters.item())

    @property
    def time_us(self) -> int:
        """Latest time in the stream [us, camera clock]."""
        return int(self._state['time'])

    def push(self, data: Octets, *, until_us: int = 0) -> Iterator[DecodedBatch]:
        """Decode the bytes of one transfer; take all batches before the next one.

        Args:
            data: Bytes as they came: whole words; an odd byte at the end is counted.
            until_us: Time before which no batch is due [us, camera clock]: what is decoded stays
                for the next call, unless it holds a frame.

        Yields:
            Batches: one without `until_us`, more after bursts and resets of the clock.
        """
        words = self._words(data)
        i, n, reason = 0, self._held, FULL
        self._held, self.waiting = 0, False
        while reason != DONE:
            frames: tuple[Frame, ...] = ()
            i, n, reason = decode_words(words, i, n, self._buffers)
            while reason == FRAME:
                frames += (self._frame(),)
                i, n, reason = decode_words(words, i, n, self._buffers)
            if reason == DONE and not frames and self.time_us < until_us:
                self._held, self.waiting = n, True
                break
            yield self._batch(n, frames, 'time_before_reset' if reason == RESET else 'time')
            if reason == RESET:
                self._resets += 1
                until_us = 0
            n = 0

    def _words(self, data: Octets) -> NDArray[np.uint16]:
        octets = np.frombuffer(data, np.uint8)
        if len(octets) % 2:
            self._counters['bytes_dropped'] += 1
            octets = octets[:-1]
        words: NDArray[np.uint16] = octets.view(WORD)
        # Always the same array type, whatever the buffer, so that the kernel is compiled only once.
        words = words if words.flags.aligned else words.copy()
        words.setflags(write=False)
        return words

    def _batch(self, n: int, frames: tuple[Frame, ...], time: str) -> DecodedBatch:
        samples, edges = self._readings['imu_count'], self._readings['edge_count']
        return DecodedBatch(
            events=self._events[:n],
            frames=frames,
            imu=self._take_imu(samples) if samples else NO_SAMPLES,
            edges=self._take_edges(edges) if edges else NO_EDGES,
            time_us=int(self._state[time]),
            resets=self._resets,
        )

    def _take_imu(self, count: int) -> InertialSamples:
        t, raw = self._readings['imu_t'], self._readings['imu_raw']
        samples = inertial_samples(t[:count], raw[:count], self._imu_flips, self._imu_type)
        # A sample in progress is stored behind the complete ones.
        raw[0] = raw[count]
        self._readings['imu_count'] = 0
        return samples

    def _take_edges(self, count: int) -> Edges:
        t, kind = self._readings['edge_t'], self._readings['edge_kind']
        self._readings['edge_count'] = 0
        return Edges(t[:count].copy(), kind[:count].copy())

    def _frame(self) -> Frame:
        state = self._state
        width, height = int(state['width']), int(state['height'])
        x, y, _, _ = state['roi'].tolist()
        return Frame(
            image=_arrange(self._image[: width * height], self._geometry, width, height),
            x=x,
            y=y,
            frame_start_us=int(state['frame_start']),
            exposure_start_us=int(state['exposure_start']),
            exposure_end_us=int(state['exposure_end']),
            frame_end_us=int(state['frame_end']),
            exposure_cycles=int(state['exposure_cycles']),
            global_shutter=bool(state['frame_global']),
        )


def _arrange(
    samples: NDArray[np.uint16], geometry: Geometry, width: int, height: int
) -> NDArray[np.uint16]:
    """Return a copy, reordered from column by column as on the wire to rows of an image."""
    if geometry.aps_inverted:
        columns = samples.reshape(height, width)
    else:
        columns = samples.reshape(width, height)
    turned = columns[:: -1 if geometry.aps_flip_x else 1, :: -1 if geometry.aps_flip_y else 1]
    return np.array(turned if geometry.aps_inverted else turned.T, order='C')
