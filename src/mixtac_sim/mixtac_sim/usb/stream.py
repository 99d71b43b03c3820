# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stream of the camera: from the data of the sensor to the bytes in the output buffer.

The simulation provides events, frames and inertial samples ahead of time. Each is sent at its time
on the camera clock, and only if the register settings at that time allow it: event filters, region
of interest, enabled modules. The buffer is bounded.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mixtac_core.events.arrays import Events
from mixtac_sim.grids import HEIGHT, WIDTH
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb.registers import Aps, Dvs, Imu, Module, Mux, RegisterFile, Usb
from mixtac_sim.usb.words import (
    ROW_WORD,
    TIMESTAMP_RESET_WORD,
    ImuReading,
    ImuSettings,
    TimedWords,
    WordEncoder,
    frame_words,
    imu_words,
)

FILTER_REGISTERS = range(Dvs.FIRST_PIXEL_ROW, Dvs.SUPPRESS_TYPE + 1)
"""Parameters of module DVS that can change what the filters pass."""


class EventFilter:
    """The filter settings at one moment, ready to apply.

    Args:
        registers: The settings; regions and pixels are in user orientation, ends inclusive.
    """

    def __init__(self, registers: RegisterFile) -> None:
        def read(param: int) -> int:
            return registers.read(Module.DVS, param)

        self._keep = np.zeros((HEIGHT, WIDTH), np.bool_)
        rows = slice(read(Dvs.ROI_START_ROW), read(Dvs.ROI_END_ROW) + 1)
        self._keep[rows, read(Dvs.ROI_START_COLUMN) : read(Dvs.ROI_END_COLUMN) + 1] = True
        self._muted = np.zeros((HEIGHT, WIDTH), np.bool_)
        for param in range(Dvs.FIRST_PIXEL_ROW, Dvs.FIRST_PIXEL_ROW + 16, 2):
            row, column = read(param), read(param + 1)
            if row < HEIGHT and column < WIDTH:
                self._muted[row, column] = True
        self._suppressed = bool(read(Dvs.SUPPRESS_TYPE)) if read(Dvs.SUPPRESS) else None
        self._flatten = bool(read(Dvs.FLATTEN))
        whole = self._keep.all() and not self._muted.any()
        self._idle = whole and self._suppressed is None and not self._flatten

    def apply(self, events: Events) -> tuple[Events, int]:
        """Return the events that pass and how many the pixel filter rejected."""
        if self._idle:
            return events, 0
        passing = self._keep[events.y, events.x]
        muted = passing & self._muted[events.y, events.x]
        passing &= ~muted
        if self._suppressed is not None:
            passing &= events.polarity != self._suppressed
        events = events[passing]
        if self._flatten:
            off = np.zeros(len(events), np.bool_)
            events = Events(events.t, events.x, events.y, off)
        return events, int(np.count_nonzero(muted))


class Oscillator:
    """Maps true time to the camera clock.

    Both are int64 microseconds; true time counts from the construction of the device on the
    host's monotonic clock, camera time from the last timestamp reset.

    Args:
        skew_ppm: Rate of the camera clock over true time, less one [1e-6], kept to 1e-9.
    """

    def __init__(self, skew_ppm: float) -> None:
        self._skew_ppb = round(skew_ppm * 1000)
        self.origin_us = 0

    def reset(self, true_us: int) -> None:
        """Restart camera time at zero at this true time."""
        self.origin_us = true_us

    def to_camera(self, true_us: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert true times [us, int64 array] to camera time, rounded down to whole us."""
        elapsed = true_us - np.int64(self.origin_us)
        drift = elapsed * self._skew_ppb // 1_000_000_000
        return np.asarray(elapsed + drift, np.int64)

    def now(self, true_us: int) -> int:
        """Convert one true time [us] to camera time [us]."""
        return int(self.to_camera(np.array([true_us], np.int64))[0])


# Beyond this share of the buffer events are dropped, so that frames and time still pass.
_EVENT_SHARE: Final = 0.5
# The simulation may run ahead: a minute of inertial samples. More means that the device is not
# advanced; then the oldest go, and events are counted.
_MAX_WAITING: Final = 1 << 16


class StreamAssembler:
    """Orders, gates, encodes and buffers the data stream. Not thread safe: the device guards it.

    Before all else comes `power_up`.

    Args:
        capacity: Size of the buffer [bytes].

    Attributes:
        fifo: Bytes that the host has not read yet, words little-endian.
        done_us: True time up to which everything was sent [us].
        snapshot: Whether one more frame is sent even if frames are off.
        frames_dropped: Frames that found the buffer full since power-up.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self.fifo = bytearray()
        self._events: deque[Events] = deque(maxlen=_MAX_WAITING)
        self._frames: deque[ApsFrame] = deque(maxlen=_MAX_WAITING)
        self._readings: deque[ImuReading] = deque(maxlen=_MAX_WAITING)

    def power_up(self, registers: RegisterFile, oscillator: Oscillator) -> None:
        """Begin anew, with what was handed over ahead of time.

        Args:
            registers: The register file, read at each step.
            oscillator: The camera clock.
        """
        self._registers = registers
        self._oscillator = oscillator
        self._encoder = WordEncoder()
        self._readout = TimedWords.at(0)
        self.snapshot = False
        self.fifo.clear()
        self.settings_changed()
        self.done_us = 0
        self.frames_dropped = 0

    def push(self, words: NDArray[np.uint16]) -> bool:
        """Append words to the buffer, all or nothing.

        Returns:
            Whether they fitted.
        """
        fits = 2 * len(words) <= self._capacity - len(self.fifo)
        if fits:
            self.fifo += words.astype('<u2', copy=False).tobytes()
        return fits

    @property
    def running(self) -> bool:
        """Whether the run bits let data through to the host."""
        read = self._registers.read
        return bool(
            read(Module.USB, Usb.RUN)
            and read(Module.MUX, Mux.RUN)
            and read(Module.MUX, Mux.TIMESTAMP_RUN)
        )

    def settings_changed(self) -> None:
        """Read the event filter settings again."""
        self._filter = EventFilter(self._registers)

    def submit(
        self, events: Events, frames: Iterable[ApsFrame], readings: Iterable[ImuReading]
    ) -> None:
        """Hand over data [us, true time] that goes out when `advance` reaches it."""
        if len(events):
            if len(self._events) == _MAX_WAITING:
                self._count_dropped(len(self._events[0]))
            self._events.append(events)
        self._frames.extend(frames)
        self._readings.extend(readings)

    def restart_time(self, true_us: int, *, announce: bool) -> None:
        """Restart the camera clock at zero at this true time; ``announce`` sends the reset word."""
        self._oscillator.reset(true_us)
        self._encoder.reset()
        self.done_us = max(self.done_us, true_us)
        if announce and self.running:
            self.push(np.array([TIMESTAMP_RESET_WORD], np.uint16))

    def advance(self, true_us: int) -> None:
        """Send everything with a time before ``true_us`` [us, true time]."""
        events = self._due_events(true_us)
        others = self._due_words(true_us)
        if not self.running:
            self._readout = TimedWords.at(0)
            self.fifo.clear()
            return
        if not self._registers.read(Module.DVS, Dvs.RUN):
            events = Events.empty()
        else:
            events, filtered = self._filter.apply(events)
            self._registers.counts[Module.DVS, Dvs.FILTERED_PIXELS] += filtered
        self._send(events, others, self._oscillator.now(true_us))

    def _due_events(self, true_us: int) -> Events:
        parts = []
        while self._events and self._events[0].t[0] < true_us:
            events = self._events.popleft()
            due = int(np.searchsorted(events.t, true_us))
            if due < len(events):
                self._events.appendleft(events[due:])
            parts.append(events[:due])
        events = Events.concatenate(parts)
        events = events[int(np.searchsorted(events.t, self._oscillator.origin_us)) :]
        camera_us = self._oscillator.to_camera(events.t)
        return Events(camera_us, events.x, events.y, events.polarity)

    def _due_words(self, true_us: int) -> TimedWords:
        frames = []
        while self._frames and self._frames[0].frame_start_us < true_us:
            frames.append(self._begin_frame(self._frames.popleft()))
        if frames:
            self._readout = TimedWords.merge([self._readout, *frames])
        # What is left of a frame is large: it is cut first, and small things join what is due.
        due, self._readout = self._readout.split(true_us)
        parts, settings = [due], self.imu_settings()
        while self._readings and self._readings[0].t_us < true_us:
            reading = self._readings.popleft()
            if settings.running and reading.t_us >= self._oscillator.origin_us:
                parts.append(imu_words(reading, settings))
        due = TimedWords.merge(parts)
        self.done_us = true_us
        return TimedWords(self._oscillator.to_camera(due.t), due.words)

    def _begin_frame(self, frame: ApsFrame) -> TimedWords:
        run = self._registers.read(Module.APS, Aps.RUN)
        if not (run or self.snapshot) or frame.frame_start_us < self._oscillator.origin_us:
            return TimedWords.at(0)
        self.snapshot = False

        def read(param: int) -> int:
            return self._registers.read(Module.APS, param)

        region = (
            *(min(read(Aps.START_COLUMN), WIDTH - 1), min(read(Aps.START_ROW), HEIGHT - 1)),
            *(min(read(Aps.END_COLUMN), WIDTH - 1), min(read(Aps.END_ROW), HEIGHT - 1)),
        )
        cycles, shutter = read(Aps.EXPOSURE), bool(read(Aps.GLOBAL_SHUTTER))
        return frame_words(frame, region, cycles, global_shutter=shutter)

    def imu_settings(self) -> ImuSettings:
        """Return what the registers ask of the inertial unit."""

        def read(param: int) -> int:
            return self._registers.read(Module.IMU, param)

        return ImuSettings(
            accel=bool(read(Imu.RUN_ACCEL)),
            gyro=bool(read(Imu.RUN_GYRO)),
            temperature=bool(read(Imu.RUN_TEMPERATURE)),
            accel_scale=read(Imu.ACCEL_FULL_SCALE) & 3,
            gyro_scale=read(Imu.GYRO_FULL_SCALE) & 3,
        )

    def _send(self, events: Events, others: TimedWords, until_us: int) -> None:
        before = self._encoder.state.copy()
        if len(self.fifo) > _EVENT_SHARE * self._capacity:
            self._count_dropped(len(events))
            events = Events.empty()
        words = self._encoder.encode(events, others, until_us)
        if self.push(words):
            rows = int(np.count_nonzero(words & 0xF000 == ROW_WORD))
            self._registers.counts[Module.DVS, Dvs.ROW_EVENTS] += rows
            self._registers.counts[Module.DVS, Dvs.COLUMN_EVENTS] += len(events)
            return
        self._encoder.state[:] = before
        self._count_dropped(len(events))
        self.frames_dropped += bool(len(others.t) or len(self._readout.t))
        self._readout = TimedWords.at(0)

    def _count_dropped(self, events: int) -> None:
        at_mux = self._registers.read(Module.MUX, Mux.DROP_DVS_ON_TRANSFER_STALL)
        place = (Module.MUX, Mux.DVS_DROPPED) if at_mux else (Module.DVS, Dvs.DROPPED)
        self._registers.counts[place] += events
