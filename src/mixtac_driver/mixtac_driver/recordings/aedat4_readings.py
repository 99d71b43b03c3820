# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the packets of AEDAT4 streams hold; times [us] are those of the file.

Field numbers are those of the published schemas of EventPacket, Frame, IMUPacket and TriggerPacket.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_driver.errors import DamagedRecordingError, RecordingError
from mixtac_driver.readings import STANDARD_GRAVITY, EdgeKind, Edges, Frame, InertialSamples
from mixtac_driver.recordings import flatbuffer
from mixtac_driver.recordings.aedat4_file import EVENT
from mixtac_events.arrays import Events

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from mixtac_driver.recordings.flatbuffer import Octets

SLICE_US = 1000
"""Longest stretch of time in one piece: what is merged behind it comes that much too late."""
_FORMATS: dict[int, np.dtype[Any]] = {0: np.dtype(np.uint8), 2: np.dtype('<u2')}
"""OpenCV's numbers of the two monochrome formats."""
_EDGES = {
    1: EdgeKind.EXTERNAL_RISING,
    2: EdgeKind.EXTERNAL_FALLING,
    3: EdgeKind.EXTERNAL_PULSE,
    4: EdgeKind.GENERATOR_RISING,
    5: EdgeKind.GENERATOR_FALLING,
}


def events(data: Octets) -> Iterator[Events]:
    """Yield the events of a packet in stretches of at most SLICE_US.

    Raises:
        DamagedRecordingError: The packet is damaged.
    """
    flatbuffer.check(data, 'EVTS')
    packed = flatbuffer.structs(data, flatbuffer.root(data), 0, EVENT)
    every = Events(*(packed[name].copy() for name in ('t', 'x', 'y', 'polarity')))
    for start, end in _slices(every.t):
        yield every[start:end]


def frame(data: Octets) -> Frame:
    """Return the frame of a packet; 8-bit pixels become the upper bits of 10.

    Raises:
        DamagedRecordingError: The packet is damaged.
        RecordingError: Its frame is in colour.
    """
    flatbuffer.check(data, 'FRME')
    table = flatbuffer.root(data)

    def number(index: int, dtype: str = '<i8', default: int = 0) -> int:
        return int(flatbuffer.column(data, table, index, dtype, default)[0])

    image = _pixels(data, number(5, 'i1'), number(6, '<i2'), number(7, '<i2'))
    stamp_us = number(0)
    start_us = number(3) or stamp_us
    end_us = number(4) or start_us + number(11)
    return Frame(
        image=image,
        x=number(8, '<i2'),
        y=number(9, '<i2'),
        frame_start_us=number(1) or start_us,
        exposure_start_us=start_us,
        exposure_end_us=end_us,
        frame_end_us=number(2) or end_us,
        exposure_cycles=end_us - start_us,
        global_shutter=True,
    )


def samples(data: Octets) -> Iterator[InertialSamples]:
    """Yield the inertial samples of a packet in stretches of at most SLICE_US, in SI units.

    Raises:
        DamagedRecordingError: The packet is damaged.
    """
    flatbuffer.check(data, 'IMUS')
    rows = flatbuffer.tables(data, flatbuffer.root(data), 0)
    t = flatbuffer.column(data, rows, 0, '<i8', 0).astype(np.int64)
    columns = [flatbuffer.column(data, rows, index, '<f4', 0.0) for index in range(1, 8)]
    # Values that are not numbers may raise a flag on the way to more bits.
    with np.errstate(invalid='ignore'):
        temperature, ax, ay, az, wx, wy, wz = np.array(columns).astype(np.float64)
    acceleration = np.stack((ax, ay, az), 1) * STANDARD_GRAVITY
    rotation = np.deg2rad(np.stack((wx, wy, wz), 1))
    for start, end in _slices(t):
        part = slice(start, end)
        yield InertialSamples(t[part], acceleration[part], rotation[part], temperature[part])


def edges(data: Octets) -> Iterator[Edges]:
    """Yield the edges of a packet in stretches of at most SLICE_US; other triggers are left out.

    Raises:
        DamagedRecordingError: The packet is damaged.
    """
    flatbuffer.check(data, 'TRIG')
    rows = flatbuffer.tables(data, flatbuffer.root(data), 0)
    t = flatbuffer.column(data, rows, 0, '<i8', 0).astype(np.int64)
    recorded = flatbuffer.column(data, rows, 1, 'i1', 0)
    known = np.isin(recorded, list(_EDGES))
    t, kinds = t[known], np.array([_EDGES[int(each)] for each in recorded[known]], np.uint8)
    for start, end in _slices(t):
        yield Edges(t[start:end], kinds[start:end])


def _pixels(data: Octets, number: int, width: int, height: int) -> NDArray[np.uint16]:
    if number not in _FORMATS:
        raise RecordingError(
            f'its frames have OpenCV format {number}, not 8 or 16 bits of one channel: set '
            'playback_image_topic to none'
        )
    dtype = _FORMATS[number]
    octets = flatbuffer.structs(data, flatbuffer.root(data), 10, np.dtype(np.uint8))
    if width <= 0 or height <= 0 or len(octets) < width * height * dtype.itemsize:
        raise DamagedRecordingError(f'{len(octets)} bytes in a frame of {width} x {height}')
    image = octets[: width * height * dtype.itemsize].view(dtype).reshape(height, width)
    wide: NDArray[np.uint16] = image.astype(np.uint16)
    return wide << np.uint16(2) if dtype.itemsize == 1 else wide >> np.uint16(6)


def _slices(t: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    if not len(t):
        return
    cells = t // SLICE_US
    cuts = np.flatnonzero(np.diff(cells)) + 1
    yield from zip([0, *cuts.tolist()], [*cuts.tolist(), len(t)], strict=True)
