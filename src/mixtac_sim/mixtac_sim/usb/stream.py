# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From what the sensor saw to what waits in the camera's output buffer.

The simulation hands over events, frames and inertial samples ahead of time; each goes out when its
time has come and only if the register settings of that moment let it.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_events.arrays import Events
from mixtac_sim.usb.aps_words import Frame, ReadoutSettings, frame_blocks
from mixtac_sim.usb.event_filter import EventFilter
from mixtac_sim.usb.imu_words import ImuReading, ImuSettings, imu_blocks
from mixtac_sim.usb.registers import HEIGHT, WIDTH, Aps, Dvs, Imu, Module, Mux, Usb
from mixtac_sim.usb.word_encoder import TIMESTAMP_RESET_WORD, Blocks, WordEncoder

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from mixtac_sim.usb.fifo import ByteFifo
    from mixtac_sim.usb.oscillator import Oscillator
    from mixtac_sim.usb.registers import Board, RegisterFile

# Beyond this share of the buffer events are dropped, so that frames and time still pass.
_EVENT_SHARE: Final = 0.5
# The simulation may run ahead; more than this waiting means that nobody advances the device.
_MAX_WAITING: Final = 4096


class StreamAssembler:
    """Orders, gates, encodes and buffers the data stream. Not thread safe: the device guards it.

    Args:
        registers: The register file, read at each step.
        board: The fixed properties of the camera.
        oscillator: The camera clock.
        fifo: Where the words go.
    """

    def __init__(
        self, registers: RegisterFile, board: Board, oscillator: Oscillator, fifo: ByteFifo
    ) -> None:
        self._registers = registers
        self._board = board
        self._oscillator = oscillator
        self._fifo = fifo
        self._encoder = WordEncoder(inverted=board.dvs_inverted)
        self._filter = EventFilter.from_registers(registers)
        self._events: deque[Events] = deque(maxlen=_MAX_WAITING)
        self._frames: deque[Frame] = deque(maxlen=_MAX_WAITING)
        self._readings: deque[ImuReading] = deque(maxlen=_MAX_WAITING)
        self._readout = Blocks.empty()
        self._stalled = False
        self._snapshot = False
        self._done_us = 0
        self.frames_dropped = 0
        self.late_frames = 0

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
        self._filter = EventFilter.from_registers(self._registers)

    def frames_switched(self, *, on: bool) -> None:
        """Note that frames were switched on or off: on and at once off still gives one frame."""
        self._snapshot |= on

    def submit(
        self, events: Events, frames: Iterable[Frame], readings: Iterable[ImuReading]
    ) -> None:
        """Hand over data [us, true time] that goes out when `advance` reaches it."""
        if len(events):
            self._events.append(events)
        self._frames.extend(frames)
        self._readings.extend(readings)

    def restart_time(self, true_us: int, *, announce: bool) -> None:
        """Let the camera clock be zero at this true time; ``announce`` sends the reset word."""
        self._oscillator.reset(true_us)
        self._encoder.reset()
        self._done_us = max(self._done_us, true_us)
        if announce and self.running:
            self._fifo.push(np.array([TIMESTAMP_RESET_WORD], np.uint16))

    def advance(self, true_us: int) -> None:
        """Send everything with a time before ``true_us`` [us, true time]."""
        events = self._due_events(true_us)
        blocks = self._due_blocks(true_us)
        if not self.running:
            self._readout = Blocks.empty()
            self._fifo.clear()
            return
        if not self._registers.read(Module.DVS, Dvs.RUN):
            events = Events.empty()
        else:
            events, filtered = self._filter.apply(events)
            self._registers.count(Module.DVS, Dvs.FILTERED_PIXELS, filtered)
        self._send(events, blocks, self._oscillator.now(true_us))

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

    def _due_blocks(self, true_us: int) -> Blocks:
        frames = []
        while self._frames and self._frames[0].frame_start_us < true_us:
            frames.append(self._begin_frame(self._frames.popleft()))
        if frames:
            self._readout = Blocks.merge([self._readout, *frames])
        # What is left of a frame is large: it is cut first, and small things join what is due.
        due, self._readout = self._readout.split(true_us)
        samples = self._due_samples(true_us)
        if samples:
            due = Blocks.merge([due, *samples])
        self._done_us = true_us
        return Blocks(self._oscillator.to_camera(due.t), due.stamped, due.end, due.words)

    def _due_samples(self, true_us: int) -> list[Blocks]:
        if not (self._readings and self._readings[0].t_us < true_us):
            return []
        settings, samples = self.imu_settings(), []
        while self._readings and self._readings[0].t_us < true_us:
            reading = self._readings.popleft()
            if settings.running and reading.t_us >= self._oscillator.origin_us:
                samples.append(imu_blocks(reading, reading.t_us, settings))
        return samples

    def _begin_frame(self, frame: Frame) -> Blocks:
        run = self._registers.read(Module.APS, Aps.RUN)
        if not (run or self._snapshot) or frame.frame_start_us < self._oscillator.origin_us:
            return Blocks.empty()
        self._snapshot = False
        self.late_frames += frame.frame_start_us < self._done_us
        times = (
            *(frame.frame_start_us, frame.exposure_start_us),
            *(frame.exposure_end_us, frame.frame_end_us),
        )
        return frame_blocks(frame, np.array(times, np.int64), self._readout_settings())

    def _readout_settings(self) -> ReadoutSettings:
        def read(param: int) -> int:
            return self._registers.read(Module.APS, param)

        region = (
            *(min(read(Aps.START_COLUMN), WIDTH - 1), min(read(Aps.START_ROW), HEIGHT - 1)),
            *(min(read(Aps.END_COLUMN), WIDTH - 1), min(read(Aps.END_ROW), HEIGHT - 1)),
        )
        return ReadoutSettings(
            region=region,
            exposure_cycles=read(Aps.EXPOSURE),
            global_shutter=bool(read(Aps.GLOBAL_SHUTTER)),
            orientation=self._board.aps_orientation,
        )

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

    def _send(self, events: Events, blocks: Blocks, until_us: int) -> None:
        before = self._encoder.save()
        if len(self._fifo) <= _EVENT_SHARE * (len(self._fifo) + self._fifo.free):
            if self._push(events, blocks, until_us):
                self._count_sent(len(events), self._encoder.rows_sent - int(before[-1]))
                return
            self._encoder.restore(before)
        self._count_dropped(len(events))
        if not self._push(Events.empty(), blocks, until_us):
            self._encoder.restore(before)
            self._stalled = True
            self._drop_readout(blocks)

    def _push(self, events: Events, blocks: Blocks, until_us: int) -> bool:
        words: NDArray[np.uint16] = self._encoder.encode(
            events, blocks, until_us, coalesce=self._stalled
        )
        fitted = self._fifo.push(words)
        self._stalled = self._stalled and not fitted
        return fitted

    def _drop_readout(self, blocks: Blocks) -> None:
        if len(blocks.t) or len(self._readout.t):
            self.frames_dropped += 1
        self._readout = Blocks.empty()

    def _count_sent(self, events: int, rows: int) -> None:
        self._registers.count(Module.DVS, Dvs.ROW_EVENTS, rows)
        self._registers.count(Module.DVS, Dvs.COLUMN_EVENTS, events)

    def _count_dropped(self, events: int) -> None:
        at_mux = self._registers.read(Module.MUX, Mux.DROP_DVS_ON_TRANSFER_STALL)
        module, param = (Module.MUX, Mux.DVS_DROPPED) if at_mux else (Module.DVS, Dvs.DROPPED)
        self._registers.count(module, param, events)
