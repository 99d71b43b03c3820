# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The packets of AEDAT4 streams from what was recorded; times [us] are those of the recording.

Field numbers are those of the published schemas of EventPacket, Frame, IMUPacket, TriggerPacket.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_bringup.export.flatbuffer_writer import FlatBufferWriter
from mixtac_driver.readings import STANDARD_GRAVITY, EdgeKind, Edges, Frame, InertialSamples

if TYPE_CHECKING:
    from mixtac_events.arrays import Events

EVENT = np.dtype(
    {
        'names': ['t', 'x', 'y', 'p'],
        'formats': ['<i8', '<i2', '<i2', 'u1'],
        'offsets': [0, 8, 10, 12],
        'itemsize': 16,
    }
)
TRIGGERS = {
    EdgeKind.EXTERNAL_RISING: 1,
    EdgeKind.EXTERNAL_FALLING: 2,
    EdgeKind.EXTERNAL_PULSE: 3,
    EdgeKind.GENERATOR_RISING: 4,
    EdgeKind.GENERATOR_FALLING: 5,
}
SIXTEEN_BIT = 2
"""OpenCV's number of images of 16 bits and one channel."""
FROM_SENSOR = 1
LEFT_ALIGNED = 6


def events_packet(events: Events) -> bytes:
    """Return the buffer of events."""
    rows = np.zeros(len(events), EVENT)
    rows['t'], rows['x'], rows['y'], rows['p'] = events.t, events.x, events.y, events.polarity
    return _with_vector('EVTS', len(rows), rows.tobytes())


def frame_packet(frame: Frame) -> bytes:
    """Return the buffer of a frame: 10 bits left-aligned in 16, as on `image_raw`.

    Its time is the beginning of the exposure, as dv-processing has it.
    """
    buffer = FlatBufferWriter('FRME')
    height, width = frame.image.shape
    table, fields = buffer.table(
        {
            0: ('q', frame.exposure_start_us),
            1: ('q', frame.frame_start_us),
            2: ('q', frame.frame_end_us),
            3: ('q', frame.exposure_start_us),
            4: ('q', frame.exposure_end_us),
            5: ('b', SIXTEEN_BIT),
            6: ('h', width),
            7: ('h', height),
            8: ('h', frame.x),
            9: ('h', frame.y),
            10: ('O', 0),
            11: ('q', frame.exposure_end_us - frame.exposure_start_us),
            12: ('b', FROM_SENSOR),
        }
    )
    pixels = np.left_shift(frame.image, LEFT_ALIGNED).astype('<u2').tobytes()
    buffer.refer(fields[10], buffer.vector(len(pixels), pixels))
    return buffer.finish(table)


def samples_packet(samples: InertialSamples) -> bytes:
    """Return the buffer of inertial samples, in g, degrees per second and degrees Celsius."""
    acceleration = (samples.acceleration / STANDARD_GRAVITY).tolist()
    rotation = np.rad2deg(samples.angular_velocity).tolist()
    rows: list[dict[int, tuple[str, float]]] = []
    for index, t_us in enumerate(samples.t.tolist()):
        values = (float(samples.temperature[index]), *acceleration[index], *rotation[index])
        row: dict[int, tuple[str, float]] = {0: ('q', t_us)}
        row |= {1 + number: ('f', value) for number, value in enumerate(values)}
        rows.append(row)
    return _with_tables('IMUS', rows)


def edges_packet(edges: Edges) -> bytes:
    """Return the buffer of edges at the synchronisation connector."""
    kinds = [TRIGGERS[EdgeKind(int(kind))] for kind in edges.kind]
    rows = zip(edges.t.tolist(), kinds, strict=True)
    return _with_tables('TRIG', [{0: ('q', t_us), 1: ('b', kind)} for t_us, kind in rows])


def _with_vector(identifier: str, count: int, octets: bytes) -> bytes:
    buffer = FlatBufferWriter(identifier)
    table, fields = buffer.table({0: ('O', 0)})
    buffer.refer(fields[0], buffer.vector(count, octets))
    return buffer.finish(table)


def _with_tables(identifier: str, rows: list[dict[int, tuple[str, float]]]) -> bytes:
    buffer = FlatBufferWriter(identifier)
    table, fields = buffer.table({0: ('O', 0)})
    vector, places = buffer.references(len(rows))
    buffer.refer(fields[0], vector)
    for place, row in zip(places, rows, strict=True):
        position, _ = buffer.table(row)
        buffer.refer(place, position)
    return buffer.finish(table)
