# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A decoder of the DAVIS stream, word by word in plain Python, written from the protocol alone.

It shares no code and no tables with the decoder under test.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

G = 9.80665


@dataclass
class OpenFrame:
    """A frame on its way."""

    global_shutter: bool
    start: int
    exposure_bits: list[int] = field(default_factory=list)
    roi_high: int = 0
    roi: list[int] = field(default_factory=list)
    exposure_start: int | None = None
    exposure_end: int | None = None
    column: tuple[str, list[int]] | None = None
    resets: list[list[int]] = field(default_factory=list)
    signals: list[list[int]] = field(default_factory=list)
    broken: bool = False


class Oracle:
    """Decodes words one at a time; results pile up in lists."""

    def __init__(self, geometry):
        self.g = geometry
        self.t = self.base = self.resets = 0
        self.row = None
        self.frame = None
        self.imu = None
        self.events, self.frames, self.samples, self.edges = [], [], [], []
        self.dropped_frames = self.dropped_imu = self.unexpected = 0
        aps = (geometry.aps_columns, geometry.aps_rows)
        self.width, self.height = aps[::-1] if geometry.aps_inverted else aps

    def words(self, words):
        for word in words:
            self.word(int(word))
        return self

    def word(self, word):
        if not self.accepts(word):
            self.unexpected += 1

    def accepts(self, word):
        """Take a word; return whether it is known and belongs where it is."""
        if word & 0x8000:
            before, stamp = self.t, self.base + (word & 0x7FFF)
            self.t = max(before, stamp)
            return stamp >= before
        kind, low = word >> 12, word & 0xFFF
        if kind == 0:
            return self.special(low)
        if kind == 1 and low < self.g.dvs_rows:
            self.row = low
            return True
        if kind in (2, 3):
            return self.column_address(low, kind == 3)
        if kind == 4:
            return self.adc(word & 0x3FF)
        if kind == 5:
            return self.misc8(low >> 8, low & 0xFF)
        if kind == 6 and low >> 10 == 0 and self.frame and len(self.frame.exposure_bits) < 3:
            self.frame.exposure_bits.append(low & 0x3FF)
            return True
        if kind == 7 and low:
            self.base += low * 32768
            self.t = self.base
            return True
        return False

    def column_address(self, low, on):
        if low >= self.g.dvs_columns or self.row is None:
            return False
        x, y = (self.row, low) if self.g.dvs_inverted else (low, self.row)
        self.events.append((self.resets, self.t, x, y, on))
        return True

    def special(self, code):
        if code == 1:
            self.drop_frame()
            self.drop_imu()
            self.t = self.base = 0
            self.resets += 1
        elif code in (2, 3, 4, 16, 17):
            self.edges.append((self.resets, self.t, code))
        elif code == 5:
            self.drop_imu()
            self.imu = []
        elif code == 7:
            return self.imu_end()
        elif code in (8, 9):
            self.drop_frame()
            self.frame = OpenFrame(code == 8, self.t)
        else:
            return self.frame is not None and self.frame_special(code)
        return True

    def frame_special(self, code):
        frame = self.frame
        if code == 10:
            self.frame_end()
        elif code in (11, 12):
            done = frame.resets if code == 11 else frame.signals
            bad = len(frame.roi) < 4 or len(done) >= self.expected()[0]
            bad = bad or (code == 12 and len(frame.signals) >= len(frame.resets))
            frame.broken = frame.broken or bad
            frame.column = None if bad else ('reset' if code == 11 else 'signal', [])
            return not bad
        elif code == 13 and frame.column:
            kind, samples = frame.column
            frame.broken = frame.broken or len(samples) != self.expected()[1]
            (frame.resets if kind == 'reset' else frame.signals).append(samples)
            frame.column = None
        elif code == 14:
            frame.exposure_start = self.t
        elif code == 15:
            frame.exposure_end = self.t
        else:
            return False
        return True

    def region(self):
        """Start column, start row, width, height in user orientation."""
        (x0, y0, x1, y1), (w, h) = self.frame.roi, (self.width, self.height)
        x0, y0 = (x0 if x0 < w else 0), (y0 if y0 < h else 0)
        x1 = x1 if x0 <= x1 < w else w - 1
        y1 = y1 if y0 <= y1 < h else h - 1
        return x0, y0, x1 + 1 - x0, y1 + 1 - y0

    def expected(self):
        """Columns and samples per column."""
        _, _, width, height = self.region()
        return (height, width) if self.g.aps_inverted else (width, height)

    def adc(self, value):
        column = self.frame.column if self.frame else None
        fits = column is not None and len(column[1]) < self.expected()[1]
        if fits:
            column[1].append(value)
        return fits

    def misc8(self, code, data):
        frame, imu = self.frame, self.imu
        if code == 1 and frame and len(frame.roi) < 4:
            frame.roi_high = data << 8
        elif code == 2 and frame and len(frame.roi) < 4:
            frame.roi.append(frame.roi_high | data)
            if len(frame.roi) == 4:
                (x0, y0, x1, y1), (w, h) = frame.roi, (self.width, self.height)
                self.unexpected += not x0 <= x1 < w
                self.unexpected += not y0 <= y1 < h
        elif code == 0 and imu and len(imu) - 1 < self.imu_length():
            imu.append(data)
        elif code == 3:
            awaited = imu == []
            if awaited and data & 0xE0:
                imu.append(data)
            else:
                self.drop_imu()
            return awaited
        else:
            return False
        return True

    def imu_length(self):
        info = self.imu[0]
        return 6 * bool(info & 0x80) + 6 * bool(info & 0x40) + 2 * bool(info & 0x20)

    def imu_end(self):
        begun = self.imu is not None
        if self.imu and len(self.imu) - 1 == self.imu_length():
            info, rest = self.imu[0], self.imu[1:]

            def take(n):
                out = [
                    int.from_bytes(rest[2 * i : 2 * i + 2], 'big', signed=True) for i in range(n)
                ]
                del rest[: 2 * n]
                return out

            accel = take(3) if info & 0x80 else [math.nan] * 3
            temp = take(1)[0] / 333.87 + 21 if info & 0x20 else math.nan
            gyro = take(3) if info & 0x40 else [math.nan] * 3
            accel = [a / (65536 / (4 << (info >> 2 & 3))) * G for a in accel]
            gyro = [math.radians(r / (65536 / (500 << (info & 3)))) for r in gyro]
            self.samples.append((self.resets, self.t, accel, gyro, temp))
            self.imu = None
        else:
            self.drop_imu()
        return begun

    def drop_imu(self):
        self.dropped_imu += self.imu is not None
        self.imu = None

    def drop_frame(self):
        self.dropped_frames += self.frame is not None
        self.frame = None

    def frame_end(self):
        frame = self.frame
        columns = self.expected()[0] if len(frame.roi) == 4 else None
        if frame.broken or not len(frame.resets) == len(frame.signals) == columns:
            self.drop_frame()
            return
        start, end = frame.exposure_start, frame.exposure_end
        if start is None or end is None or end < start:
            start, end = frame.start, self.t
        times = (frame.start, start, end, self.t)
        exposure = sum(v << 10 * i for i, v in enumerate(frame.exposure_bits))
        self.frames.append(
            (self.resets, times, self.region()[:2], frame.global_shutter, exposure, self.image())
        )
        self.frame = None

    def image(self):
        _, _, width, height = self.region()
        columns, samples = self.expected()
        image = [[None] * width for _ in range(height)]
        for c, (resets, signals) in enumerate(
            zip(self.frame.resets, self.frame.signals, strict=True)
        ):
            for r, (reset, signal) in enumerate(zip(resets, signals, strict=True)):
                cx = columns - 1 - c if self.g.aps_flip_x else c
                cy = samples - 1 - r if self.g.aps_flip_y else r
                x, y = (cy, cx) if self.g.aps_inverted else (cx, cy)
                white = reset < 384 or signal == 0
                image[y][x] = 1023 if white else min(max(reset - signal, 0), 1023)
        return image
