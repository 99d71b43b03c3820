# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the camera shows to the clients: a mixed scene, and word by word what is hard to decode."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mixtac_core.events.arrays import Events
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.words import ImuReading

DURATION_US = 1_000_000
WRAP_US = 0x8000
EDGE_CODES = (3, 2, 4, 17, 16)
FULL = (0, 0, 345, 259)


def times_of(frame):
    """Return the times of a frame: start, start and end of the exposure, end [us]."""
    return (
        *(frame.frame_start_us, frame.exposure_start_us),
        *(frame.exposure_end_us, frame.frame_end_us),
    )


@dataclass
class Scene:
    """What the camera sees [us]."""

    events: Events
    frames: list
    readings: list
    edges: list

    def moved(self, by):
        """Return the scene later by a time [us]."""
        return Scene(
            self.events.shifted(by),
            [ApsFrame(*(t + by for t in times_of(f)), f.reset, f.signal) for f in self.frames],
            [replace(r, t_us=r.t_us + by) for r in self.readings],
            [(t + by, code) for t, code in self.edges],
        )


def samples(rng):
    """Return reset and signal samples that reach every branch of the subtraction."""
    reset = rng.integers(370, 1024, (260, 346)).astype(np.uint16)
    return reset, rng.integers(0, 1024, (260, 346)).astype(np.uint16)


def make_scene():
    """Events of 1 to 8 per row and bursts of whole rows, frames, inertial samples, edges.

    Edges come at odd times and everything else at even ones (columns of frames every 20 us), so
    that no word is stamped with the time of the word before it: the camera never does so.
    """
    rng = np.random.default_rng(346)
    frames = [
        ApsFrame(start, start + 5_200, start + 9_200, start + 14_400, *samples(rng))
        for start in range(5_000, DURATION_US - 40_000, 100_000)
    ]
    readings = [
        ImuReading(t, (k % 200 * 0.01, -1.0, 0.5), (k % 100 - 50.0, 20.0, 0.0), 30 + k % 100 * 0.1)
        for k, t in enumerate(range(500, DURATION_US, 1_000))
    ]
    edges = [(t, EDGE_CODES[k % 5]) for k, t in enumerate(range(3_333, DURATION_US, 7_778))]
    return Scene(row_events(rng), frames, readings, edges)


def row_events(rng):
    """Return about 70,000 events in rows: mostly 1 to 8, now and then a burst of full rows."""
    rows = 14_000
    t = 2 * rng.integers(0, DURATION_US // 2, rows)
    burst = rng.random(rows) < 0.002
    t[burst] = 600_000 + 2 * rng.integers(0, 2, burst.sum())
    t = np.sort(t)
    counts = np.where(t // 4 == 150_000, 260, rng.integers(1, 9, rows))
    times, x = np.repeat(t, counts), np.repeat(rng.integers(0, 346, rows), counts)
    y = rng.integers(0, 260, len(times))
    polarity = rng.random(len(times)) < 0.5
    return Events(times.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), polarity)


@dataclass
class HardWords:
    """Writes stream words by hand and notes what they mean.

    Attributes:
        base: Time of the last wrap [us].
        words: The words.
        events: (time, x, y, polarity) [us].
        marks: Frames and times [us] by name.
    """

    base: int
    words: list = field(default_factory=list)
    events: list = field(default_factory=list)
    marks: dict = field(default_factory=dict)

    def wrap(self, count=1):
        self.words.append(0x7000 | count)
        self.base += count * WRAP_US

    def at(self, offset, *words):
        """Stamp and write words; return the time."""
        self.words += [0x8000 | offset, *words]
        return self.base + offset

    def event(self, offset, x, y, polarity):
        t = self.at(offset, 0x1000 | x, (0x3000 if polarity else 0x2000) | y)
        self.events.append((t, x, y, polarity))

    def reset(self):
        self.words.append(0x0001)
        self.base = 0

    def header(self, offset, *, rolling=False, region=FULL):
        words = [9 if rolling else 8, *(0x6000 | v for v in (123, 0, 0))]
        for value in region:
            words += [0x5100 | value >> 8, 0x5200 | value & 0xFF]
        return self.at(offset, *words)

    def column(self, values, *, signal):
        self.words += [12 if signal else 11, *(0x4000 | int(v) for v in values), 13]

    def frame(self, offset, reset, signal, *, region=FULL, signal_columns=None):
        """Write a frame of a global shutter; return its times and samples.

        The columns of the wire run along the rows of the picture, as in the retail chip. With
        fewer signal columns than rows it is incomplete.
        """
        x0, y0, x1, y1 = region
        reset, signal = reset[y0 : y1 + 1, x0 : x1 + 1], signal[y0 : y1 + 1, x0 : x1 + 1]
        start = self.header(offset, region=region)
        for row in reset:
            self.column(row, signal=False)
        exposed, closed = self.at(offset + 1000, 14), self.at(offset + 2000, 15)
        for row in signal[:signal_columns]:
            self.column(row, signal=True)
        return ApsFrame(start, exposed, closed, self.at(offset + 3000, 10), reset, signal)

    def rolling_frame(self, offset, reset, signal, lag=9):
        """Write a frame of a rolling shutter: a row's signal follows its reset by some rows."""
        start = self.header(offset, rolling=True)
        self.column(reset[0], signal=False)
        exposed, closed = self.at(offset + 100, 14), 0
        for k in range(1, len(reset) + lag):
            if k < len(reset):
                self.column(reset[k], signal=False)
            if k == lag:
                closed = self.at(offset + 900, 15)
            if k >= lag:
                self.column(signal[k - lag], signal=True)
        return ApsFrame(start, exposed, closed, self.at(offset + 3000, 10), reset, signal)

    def imu(self, offset, values, *, until=14):
        """Write a sample of all groups (4 g, 500 deg/s); cut after some bytes it has no end."""
        data = np.asarray(values, '>i2').tobytes()
        t = self.at(offset, 5, 0x53E5, *(0x5000 | byte for byte in data[:until]))
        if until == len(data):
            self.words.append(7)
        return t


IMU_RAW = (8192, -8192, 4096, 3339, 6554, -6554, 0)
"""1, -1, 0.5 g; 31.0 degrees Celsius; 100, -100, 0 deg/s."""
IMU_REST = range(7)
CUT_COLUMNS = 110
SIGNAL_COLUMNS = 200
REGION = (40, 30, 139, 89)


def make_hard_words(base):
    """Write what decoders trip over, from the time of a wrap on [us].

    In order: a frame of a region, one of a rolling shutter, an incomplete one, a wrap word that
    counts three, a reset of the clock amid a frame and an inertial sample, and after it what must
    arrive again.
    """
    rng = np.random.default_rng(18)
    hard = HardWords(base)
    marks = hard.marks
    hard.wrap()
    hard.event(10, 1, 2, 1)
    marks['region'] = hard.frame(1000, *samples(rng), region=REGION)
    marks['rolling'] = hard.rolling_frame(8000, *samples(rng))
    hard.frame(15_000, *samples(rng), signal_columns=SIGNAL_COLUMNS)
    hard.event(30_000, 3, 4, 0)
    hard.wrap(3)
    hard.event(5, 5, 6, 1)
    hard.event(12_000, 11, 12, 0)
    hard.event(24_000, 13, 14, 1)
    cut_reset, _ = samples(rng)
    hard.header(25_000)
    for row in cut_reset[:100]:
        hard.column(row, signal=False)
    hard.imu(26_000, IMU_RAW, until=7)
    hard.reset()
    # The rest of what the reset cut: none of it may appear.
    hard.words += [*(0x5000 | byte for byte in IMU_REST), 7]
    for row in cut_reset[100:CUT_COLUMNS]:
        hard.column(row, signal=False)
    hard.event(50, 7, 8, 0)
    hard.at(60, 10)
    marks['imu'] = hard.imu(1000, IMU_RAW)
    marks['rising'] = hard.at(2000, 3)
    marks['whole'] = hard.frame(3000, *samples(rng))
    hard.event(20_000, 9, 10, 1)
    return hard
