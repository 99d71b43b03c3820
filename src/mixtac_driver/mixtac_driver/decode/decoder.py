# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Decoder of the data stream: bytes of USB transfers in, events, frames and samples out.

Words are 16-bit, little-endian and know nothing of transfers, so everything half done is kept from
one transfer to the next. That includes half a word: an odd byte at the end of a full transfer
waits for its other half. At the end of a short packet it cannot come any more (the camera ended
the packet there), so it is dropped and counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_driver.decode import state as s
from mixtac_driver.decode.kernel import decode_words, drop_items
from mixtac_driver.decode.state import DecoderCounters
from mixtac_driver.errors import DriverError
from mixtac_events.arrays import Events
from mixtac_events.readings import (
    NO_EDGES,
    NO_SAMPLES,
    DecodedBatch,
    Edges,
    Frame,
    InertialSamples,
    inertial_samples,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from mixtac_driver.davis346.model import Geometry
    from mixtac_driver.usb.transport import Gap, Octets


DEFAULT_CAPACITY = 32768
SAMPLE_CAPACITY = 256
WORD = np.dtype('<u2')


class StreamDecoder:
    """Decodes the stream of one camera.

    Args:
        geometry: Pixel arrays of the camera.
        imu_flips: Axes (x, y, z) of the inertial unit that point the other way.
        imu_type: 1 for MPU6050, 2 for MPU9250.
        capacity: Events per batch; longer bursts come as several batches.
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
        self._state = _new_state(geometry)
        self._counters = np.zeros(s.COUNTER_SIZE, np.int64)
        self._t = np.empty(capacity, np.int64)
        self._row = np.empty(capacity, np.uint16)
        self._column = np.empty(capacity, np.uint16)
        self._polarity_bytes = np.empty(capacity, np.uint8)
        self._polarity = self._polarity_bytes.view(np.bool_)
        inverted = geometry.dvs_inverted
        self._x, self._y = (self._row, self._column) if inverted else (self._column, self._row)
        self._imu_t = np.empty(SAMPLE_CAPACITY, np.int64)
        self._imu_raw = np.zeros((SAMPLE_CAPACITY + 1, s.IMU_BYTES + 1), np.uint8)
        self._edge_t = np.empty(SAMPLE_CAPACITY, np.int64)
        self._edge_kind = np.empty(SAMPLE_CAPACITY, np.uint8)
        pixels = geometry.aps_columns * geometry.aps_rows
        self._reset_samples = np.zeros(pixels, np.uint16)
        self._image = np.zeros(pixels, np.uint16)
        self._half_word = b''
        self._resets = 0
        self._busy = False
        # The first calls compile, or load what was compiled: not while data wait.
        drop_items(self._state, self._counters)
        self._run(self._words(b'', short_packet=True), 0, 0)

    @property
    def counters(self) -> DecoderCounters:
        """Everything seen and dropped so far."""
        return DecoderCounters(*self._counters.tolist())

    @property
    def time_us(self) -> int:
        """Time that the stream has reached [us, camera clock]."""
        return int(self._state[s.TIME])

    def push(self, data: Octets, *, short_packet: bool = True) -> Iterator[DecodedBatch]:
        """Decode the bytes of one transfer.

        Args:
            data: Bytes as they came.
            short_packet: True where the camera ended the transfer early, as it does unless the
                transfer was filled to the last byte.

        Yields:
            At least one batch, more after bursts and resets of the clock.

        Raises:
            DriverError: The batches of the transfer before were not all taken.
        """
        if self._busy:
            raise DriverError('the batches of the transfer before must all be taken first')
        self._busy = True
        words = self._words(data, short_packet=short_packet)
        i, reason = 0, s.FULL
        while reason != s.DONE:
            frames: list[Frame] = []
            i, n, reason = self._run(words, i, 0)
            while reason == s.FRAME:
                frames.append(self._frame())
                i, n, reason = self._run(words, i, n)
            time_us = self._state[s.TIME_BEFORE_RESET if reason == s.RESET else s.TIME]
            yield self._batch(n, tuple(frames), int(time_us))
            self._resets += reason == s.RESET
        self._busy = False

    def skip(self, gap: Gap) -> None:
        """Go on after bytes that were lost before they could be pushed.

        Items in progress are dropped, and so is the row address; time goes on over the gap.

        Args:
            gap: What was lost.
        """
        drop_items(self._state, self._counters)
        self._half_word = b''
        self._state[s.ROW] = -1
        if gap.resets:
            self._state[s.WRAP_BASE] = 0
            self._state[s.TIME] = 0
            self._resets += gap.resets
        if gap.wraps:
            self._state[s.WRAP_BASE] += gap.wraps * 0x8000
            self._state[s.TIME] = self._state[s.WRAP_BASE]
        self._counters[s.C_BYTES_LOST] += gap.size

    def _words(self, data: Octets, *, short_packet: bool) -> NDArray[np.uint16]:
        octets = np.frombuffer(data, np.uint8)
        if self._half_word:
            octets = np.concatenate((np.frombuffer(self._half_word, np.uint8), octets))
            self._half_word = b''
        if len(octets) % 2:
            if short_packet:
                self._counters[s.C_BYTES_DROPPED] += 1
            else:
                self._half_word = octets[-1:].tobytes()
            octets = octets[:-1]
        words: NDArray[np.uint16] = octets.view(WORD)
        # One array type, whatever the buffer: the kernel is compiled once, not while data wait.
        words = words if words.flags.aligned else words.copy()
        words.setflags(write=False)
        return words

    def _run(self, words: NDArray[np.uint16], i: int, n: int) -> Any:  # noqa: ANN401
        return decode_words(
            words,
            i,
            self._state,
            self._counters,
            self._t,
            self._row,
            self._column,
            self._polarity_bytes,
            n,
            self._imu_t,
            self._imu_raw,
            self._edge_t,
            self._edge_kind,
            self._reset_samples,
            self._image,
        )

    def _batch(self, n: int, frames: tuple[Frame, ...], time_us: int) -> DecodedBatch:
        samples, edges = self._state[s.IMU_SAMPLES : s.EDGES + 1].tolist()
        return DecodedBatch(
            events=Events(self._t[:n], self._x[:n], self._y[:n], self._polarity[:n]),
            frames=frames,
            imu=self._take_imu(samples) if samples else NO_SAMPLES,
            edges=self._take_edges(edges) if edges else NO_EDGES,
            time_us=time_us,
            resets=self._resets,
        )

    def _take_imu(self, count: int) -> InertialSamples:
        samples = inertial_samples(
            self._imu_t[:count], self._imu_raw[:count], self._imu_flips, self._imu_type
        )
        # A sample in progress lives in the slot after the complete ones.
        self._imu_raw[0] = self._imu_raw[count]
        self._state[s.IMU_SAMPLES] = 0
        return samples

    def _take_edges(self, count: int) -> Edges:
        self._state[s.EDGES] = 0
        return Edges(self._edge_t[:count].copy(), self._edge_kind[:count].copy())

    def _frame(self) -> Frame:
        state = self._state
        width, height = int(state[s.SIZE_X]), int(state[s.SIZE_Y])
        return Frame(
            image=_arrange(self._image[: width * height], self._geometry, width, height),
            x=int(state[s.ROI_0]),
            y=int(state[s.ROI_1]),
            frame_start_us=int(state[s.FRAME_START]),
            exposure_start_us=int(state[s.EXPOSURE_START]),
            exposure_end_us=int(state[s.EXPOSURE_END]),
            frame_end_us=int(state[s.FRAME_END]),
            exposure_cycles=int(state[s.EXPOSURE_CYCLES]),
            global_shutter=bool(state[s.FRAME_GLOBAL]),
        )


def _arrange(
    samples: NDArray[np.uint16], geometry: Geometry, width: int, height: int
) -> NDArray[np.uint16]:
    """Return a copy, turned from the order of the wire (column by column) to the user's."""
    if geometry.aps_inverted:
        columns = samples.reshape(height, width)
    else:
        columns = samples.reshape(width, height)
    turned = columns[:: -1 if geometry.aps_flip_x else 1, :: -1 if geometry.aps_flip_y else 1]
    return np.array(turned if geometry.aps_inverted else turned.T, order='C')


def _new_state(geometry: Geometry) -> NDArray[np.int64]:
    state = np.zeros(s.STATE_SIZE, np.int64)
    state[s.ROW] = -1
    state[s.DVS_ROWS] = geometry.dvs_rows
    state[s.DVS_COLUMNS] = geometry.dvs_columns
    state[s.APS_COLUMNS] = geometry.aps_columns
    state[s.APS_ROWS] = geometry.aps_rows
    state[s.APS_INVERTED] = geometry.aps_inverted
    state[s.COLUMN_TYPE] = -1
    state[s.IMU_INDEX] = s.IMU_OUTSIDE
    return state
