# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual DAVIS346 as a USB device: control requests in, data out, no transport.

Any number of threads may call it: usually one produces data, one per transport connection asks.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from mixtac_events.arrays import Events
from mixtac_sim.usb.control_endpoint import ControlEndpoint
from mixtac_sim.usb.event_filter import is_filter_register
from mixtac_sim.usb.host_side import HostSide
from mixtac_sim.usb.oscillator import Oscillator
from mixtac_sim.usb.registers import Aps, Board, Dvs, Imu, Module, Mux, RegisterFile, Usb
from mixtac_sim.usb.stream import StreamAssembler

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from mixtac_sim.usb.aps_words import Frame
    from mixtac_sim.usb.imu_words import ImuReading

_DEFAULT_FIFO: Final = 4 << 20


def _monotonic_us() -> Callable[[], int]:
    start = time.monotonic_ns()
    return lambda: (time.monotonic_ns() - start) // 1000


class VirtualDavis346(HostSide):
    """A DAVIS346 that exists in software only.

    Args:
        serial: Serial number, at most eight characters.
        board: Fixed properties of the camera.
        skew_ppm: How much faster than true time the camera counts [1e-6].
        fifo_bytes: Output buffer; events are dropped (and counted) beyond half of it.
        clock: True time now [us]; by default the host's monotonic clock since construction.
    """

    def __init__(
        self,
        serial: str,
        *,
        board: Board | None = None,
        skew_ppm: float = 0.0,
        fifo_bytes: int = _DEFAULT_FIFO,
        clock: Callable[[], int] | None = None,
    ) -> None:
        self.board = board or Board()
        self._skew_ppm = skew_ppm
        self._clock = clock or _monotonic_us()
        super().__init__(serial, fifo_bytes)

    # The producer's side.

    def submit(
        self,
        events: Events | None = None,
        frames: Iterable[Frame] = (),
        readings: Iterable[ImuReading] = (),
    ) -> None:
        """Hand over data that the camera sends when `advance` reaches its time.

        Args:
            events: Sorted by ``t`` [us, true time], not before those of earlier calls.
            frames: Frames in order of time.
            readings: Inertial samples in order of time.
        """
        with self._condition:
            self._stream.submit(events or Events.empty(), frames, readings)

    def advance(self, true_us: int) -> None:
        """Let true time [us] pass: send what is due and the wraps of the camera clock."""
        with self._condition:
            self._plug_in_if_due()
            was_empty = not len(self._fifo)
            self._stream.advance(true_us)
            self._data.announce(was_empty=was_empty)

    def feed(self, words: NDArray[np.uint16]) -> bool:
        """Send raw stream words as they are, if the run bits are set and the buffer has room.

        Returns:
            Whether they were taken.
        """
        with self._condition:
            was_empty = not len(self._fifo)
            taken = self._stream.running and self._fifo.push(words)
            self._data.announce(was_empty=was_empty)
            return taken

    def register(self, module: int, param: int) -> int:
        """Return a register as the host would read it."""
        with self._condition:
            return self._registers.read(module, param)

    @property
    def exposure_us(self) -> int:
        """Exposure that the host asked for [us]."""
        return self.board.adc_cycles_to_us(self.register(Module.APS, Aps.EXPOSURE))

    @property
    def frame_interval_us(self) -> int:
        """Time between frame starts that the host asked for [us]; 0 as fast as possible."""
        return self.board.adc_cycles_to_us(self.register(Module.APS, Aps.FRAME_INTERVAL))

    @property
    def imu_interval_us(self) -> int:
        """Time between inertial samples that the host asked for [us]; 0 while they are off."""
        with self._condition:
            settings = self._stream.imu_settings()
            divider = self._registers.read(Module.IMU, Imu.SAMPLE_RATE_DIVIDER)
            return 1000 * (1 + divider) if settings.running and self._stream.running else 0

    @property
    def clock_origin_us(self) -> int:
        """True time [us] of the camera's last timestamp reset."""
        return self._oscillator.origin_us

    @property
    def streaming(self) -> bool:
        """Whether the host has set the run bits."""
        with self._condition:
            return self._stream.running and not self._presence.is_gone

    @property
    def losses(self) -> dict[str, int]:
        """What was lost since power-up: events and frames that found the buffer full."""
        with self._condition:
            read = self._registers.read
            mux = read(Module.MUX, Mux.DVS_DROPPED) << 32 | read(Module.MUX, Mux.DVS_DROPPED + 1)
            dvs = read(Module.DVS, Dvs.DROPPED) << 32 | read(Module.DVS, Dvs.DROPPED + 1)
            return {
                'events_dropped': mux + dvs,
                'frames_dropped': self._stream.frames_dropped,
                'frames_late': self._stream.late_frames,
            }

    # Inside; the lock is held.

    def _power_up(self) -> None:
        self._registers = RegisterFile(self.board)
        self._fifo.clear()
        self._oscillator = Oscillator(self._skew_ppm)
        self._stream = StreamAssembler(self._registers, self.board, self._oscillator, self._fifo)
        self._endpoint0 = ControlEndpoint(self._registers, self.serial, self._written)

    def _early_packet_s(self) -> float:
        cycles = self._registers.read(Module.USB, Usb.EARLY_PACKET_DELAY)
        return cycles * 1e-6 / (self.board.usb_mhz * self.board.deviation * 1e-3)

    def _restart_clock(self) -> None:
        self._restart_time(announce=True)

    def _restart_time(self, *, announce: bool) -> None:
        was_empty = not len(self._fifo)
        self._stream.restart_time(self._clock(), announce=announce)
        self._data.announce(was_empty=was_empty)

    def _written(self, module: int, param: int, before: int, value: int) -> None:
        if module == Module.MUX and not before and value:
            if param == Mux.TIMESTAMP_RESET:
                self._restart_time(announce=True)
            elif param == Mux.TIMESTAMP_RUN:
                self._restart_time(announce=False)
            elif param == Mux.RUN:
                self._faults.restarted()
        if (module, param) == (Module.APS, Aps.RUN):
            self._stream.frames_switched(on=bool(value))
        if module == Module.USB:
            self._condition.notify_all()
        if is_filter_register(module, param):
            self._stream.settings_changed()
        if not self._stream.running:
            self._fifo.clear()
