# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where recorded data go: one class per format, all with the same methods."""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any, Protocol

import cv2
import numpy as np

from mixtac_bringup.errors import BagError
from mixtac_bringup.export import aedat4_packets as packets
from mixtac_bringup.export.aedat4_file import Aedat4Writer
from mixtac_bringup.export.growing_npz import GrowingNpz

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mixtac_driver.readings import Edges, Frame, InertialSamples
    from mixtac_driver.recordings.pieces import RecordingInfo
    from mixtac_events.arrays import Events

FORMATS = ('aedat4', 'csv', 'npz')


class Sink(Protocol):
    """Takes recorded data, each kind in order of time."""

    def events(self, events: Events) -> None:
        """Take events, at least one."""

    def frame(self, frame: Frame) -> None:
        """Take a frame."""

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples, at least one."""

    def edges(self, edges: Edges) -> None:
        """Take edges, at least one."""

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take stamps [ns, clock of the topic], shape (N,), and wrenches [N, N m], (N, 6)."""

    def close(self) -> None:
        """Finish the files."""


class Aedat4Sink:
    """One AEDAT4 file; wrenches have no place in it and are left out.

    Args:
        folder: Where to put it.
        info: What is known of the recording.
    """

    def __init__(self, folder: Path, info: RecordingInfo) -> None:
        size = (info.width, info.height)
        self._file = Aedat4Writer(folder / 'recording.aedat4', size, info.camera or 'DAVIS346')

    def events(self, events: Events) -> None:
        """Take events."""
        span = (int(events.t[0]), int(events.t[-1]))
        self._file.write('EVTS', packets.events_packet(events), len(events), *span)

    def frame(self, frame: Frame) -> None:
        """Take a frame."""
        t_us = frame.exposure_start_us
        self._file.write('FRME', packets.frame_packet(frame), 1, t_us, t_us)

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples."""
        span = (int(samples.t[0]), int(samples.t[-1]))
        self._file.write('IMUS', packets.samples_packet(samples), len(samples.t), *span)

    def edges(self, edges: Edges) -> None:
        """Take edges."""
        span = (int(edges.t[0]), int(edges.t[-1]))
        self._file.write('TRIG', packets.edges_packet(edges), len(edges.t), *span)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Leave wrenches out."""

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


CAMERA = 'us, camera clock'
IMU_COLUMNS = (
    f't [{CAMERA}]',
    *(f'acceleration_{axis} [m/s^2]' for axis in 'xyz'),
    *(f'angular_velocity_{axis} [rad/s]' for axis in 'xyz'),
    'temperature [degC]',
)
FRAME_COLUMNS = (
    'file',
    f'exposure_start [{CAMERA}]',
    f'exposure_end [{CAMERA}]',
    'x [px]',
    'y [px]',
)
WRENCH_COLUMNS = (
    't [ns, clock of the topic]',
    *(f'force_{axis} [N]' for axis in 'xyz'),
    *(f'torque_{axis} [N m]' for axis in 'xyz'),
)
HEADINGS = {
    'events': (f't [{CAMERA}]', 'x [px]', 'y [px]', 'polarity [1 = brighter]'),
    'frames': FRAME_COLUMNS,
    'imu': IMU_COLUMNS,
    'edges': (f't [{CAMERA}]', 'kind [2 falling, 3 rising, 4 pulse, 16 and 17 generator]'),
}


def topic_file(topic: str) -> str:
    """Return the name under which a topic is exported."""
    return topic.strip('/').replace('/', '_')


class CsvSink:
    """Tables with units in their headings; frames as PNG files of 16 bits, 10 left-aligned.

    Args:
        folder: Where to put them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, IO[str]] = {}
        self._frames = 0

    def events(self, events: Events) -> None:
        """Take events."""
        columns = (events.t, events.x, events.y, events.polarity.astype(np.uint8))
        rows = zip(*(column.tolist() for column in columns), strict=True)
        self._write('events', HEADINGS['events'], '%d,%d,%d,%d\n', rows)

    def frame(self, frame: Frame) -> None:
        """Take a frame."""
        name = f'frames/{self._frames:06d}.png'
        self._frames += 1
        path = self._folder / name
        path.parent.mkdir(exist_ok=True)
        if not cv2.imwrite(str(path), np.left_shift(frame.image, packets.LEFT_ALIGNED)):
            raise BagError(f'cannot write {path}: free some space')
        row = (name, frame.exposure_start_us, frame.exposure_end_us, frame.x, frame.y)
        self._write('frames', HEADINGS['frames'], '%s,%d,%d,%d,%d\n', [row])

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples."""
        table = np.column_stack(
            (samples.acceleration, samples.angular_velocity, samples.temperature)
        )
        rows = [(t, *row) for t, row in zip(samples.t.tolist(), table.tolist(), strict=True)]
        self._write('imu', HEADINGS['imu'], '%d' + ',%.9g' * 7 + '\n', rows)

    def edges(self, edges: Edges) -> None:
        """Take edges."""
        rows = zip(edges.t.tolist(), edges.kind.tolist(), strict=True)
        self._write('edges', HEADINGS['edges'], '%d,%d\n', rows)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take wrenches."""
        table = [(t, *row) for t, row in zip(rows.tolist(), values.tolist(), strict=True)]
        self._write(topic_file(topic), WRENCH_COLUMNS, '%d' + ',%.17g' * 6 + '\n', table)

    def close(self) -> None:
        """Finish the files."""
        for file in self._files.values():
            file.close()

    def _write(self, name: str, headings: tuple[str, ...], form: str, rows: Any) -> None:  # noqa: ANN401
        if name not in self._files:
            self._files[name] = (self._folder / f'{name}.csv').open('x', encoding='utf8')
            self._files[name].write(','.join(f'"{each}"' for each in headings) + '\n')
        self._files[name].write(''.join([form % row for row in rows]))


class NpzSink:
    """One .npz per kind of data; `units.txt` says what the arrays are.

    Args:
        folder: Where to put them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, GrowingNpz] = {}

    def events(self, events: Events) -> None:
        """Take events."""
        self._append('events', t=events.t, x=events.x, y=events.y, polarity=events.polarity)

    def frame(self, frame: Frame) -> None:
        """Take a frame."""
        self._append(
            'frames',
            exposure_start=np.array([frame.exposure_start_us]),
            exposure_end=np.array([frame.exposure_end_us]),
            origin=np.array([[frame.x, frame.y]]),
            image=frame.image[None],
        )

    def samples(self, samples: InertialSamples) -> None:
        """Take inertial samples."""
        self._append(
            'imu',
            t=samples.t,
            acceleration=samples.acceleration,
            angular_velocity=samples.angular_velocity,
            temperature=samples.temperature,
        )

    def edges(self, edges: Edges) -> None:
        """Take edges."""
        self._append('edges', t=edges.t, kind=edges.kind)

    def wrenches(self, topic: str, rows: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Take wrenches."""
        self._append(topic_file(topic), t=rows, force=values[:, :3], torque=values[:, 3:])

    def close(self) -> None:
        """Finish the files."""
        for file in self._files.values():
            file.close()
        (self._folder / 'units.txt').write_text(UNITS, encoding='utf8')

    def _append(self, name: str, **arrays: NDArray[Any]) -> None:
        file = self._files.get(name)
        if file is None:
            file = self._files[name] = GrowingNpz(self._folder / f'{name}.npz')
        for key, rows in arrays.items():
            file.append(key, rows)


UNITS = """\
events.npz  t [us, camera clock], x, y [px], polarity (true: brighter)
frames.npz  exposure_start, exposure_end [us, camera clock], origin (x, y of the first pixel),
            image [n, height, width], 0 .. 1023
imu.npz     t [us, camera clock], acceleration [m/s^2], angular_velocity [rad/s], temperature [degC]
edges.npz   t [us, camera clock], kind (2 falling, 3 rising, 4 pulse, 16 and 17 generator)
others      named after their topic: t [ns, clock of the topic], force [N], torque [N m]
"""
