# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual DAVIS346 as a USB device: control requests in, data out, no transport.

Any number of threads may call it: usually one produces data, one per transport connection asks.
"""

from __future__ import annotations

import time
from threading import Condition
from typing import TYPE_CHECKING, Final

from mixtac_events.arrays import Events
from mixtac_sim.usb import descriptors
from mixtac_sim.usb.control_endpoint import ControlEndpoint
from mixtac_sim.usb.errors import UsbBusy, UsbGone, UsbStall, UsbTimeout
from mixtac_sim.usb.event_filter import is_filter_register
from mixtac_sim.usb.fifo import ByteFifo
from mixtac_sim.usb.oscillator import Oscillator
from mixtac_sim.usb.registers import Aps, Board, Dvs, Imu, Module, Mux, RegisterFile, Usb
from mixtac_sim.usb.stream import StreamAssembler

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from mixtac_sim.usb.aps_words import Frame
    from mixtac_sim.usb.imu_words import ImuReading

_IN: Final = 0x80
_DEFAULT_FIFO: Final = 4 << 20


def _monotonic_us() -> Callable[[], int]:
    start = time.monotonic_ns()
    return lambda: (time.monotonic_ns() - start) // 1000


class VirtualDavis346:
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
        self.serial = serial
        self.board = board or Board()
        self._skew_ppm = skew_ppm
        self._fifo_bytes = fifo_bytes
        self._clock = clock or _monotonic_us()
        self._condition = Condition()
        self._gone = False
        self._owner: Hashable | None = None
        self._power_up()

    def _power_up(self) -> None:
        self._registers = RegisterFile(self.board)
        self._fifo = ByteFifo(self._fifo_bytes)
        self._oscillator = Oscillator(self._skew_ppm)
        self._stream = StreamAssembler(self._registers, self.board, self._oscillator, self._fifo)
        self._endpoint0 = ControlEndpoint(self._registers, self.serial, self._written)
        self._waiting_since = 0.0

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
            was_empty = not len(self._fifo)
            self._stream.advance(true_us)
            self._announce(was_empty=was_empty)

    def feed(self, words: NDArray[np.uint16]) -> bool:
        """Send raw stream words as they are, if the run bits are set and the buffer has room.

        Returns:
            Whether they were taken.
        """
        with self._condition:
            was_empty = not len(self._fifo)
            taken = self._stream.running and self._fifo.push(words)
            self._announce(was_empty=was_empty)
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
            return self._stream.running

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

    def unplug(self) -> None:
        """Remove the device: whatever is under way or asked later ends with `UsbGone`."""
        with self._condition:
            self._gone = True
            self._condition.notify_all()

    # The host's side.

    def control(
        self, request_type: int, request: int, value: int, index: int, data: bytes | int
    ) -> bytes:
        """Answer a control request.

        Args:
            request_type: ``bmRequestType``.
            request: ``bRequest``.
            value: ``wValue``.
            index: ``wIndex``.
            data: Bytes to the device, or how many are wanted from it.

        Returns:
            The answer, empty for requests to the device.

        Raises:
            UsbStall: The device does not know the request or refuses its content.
            UsbGone: The device was unplugged.
        """
        with self._condition:
            self._check_present()
            if request_type & _IN:
                wanted = data if isinstance(data, int) else len(data)
                return self._endpoint0.answer(request_type, request, value, index)[:wanted]
            sent = b'' if isinstance(data, int) else data
            self._endpoint0.obey(request_type, request, value, index, sent)
            return b''

    def read_bulk(self, endpoint: int, length: int, timeout_s: float | None) -> bytes:
        """Wait for data from an endpoint.

        The data endpoint answers when ``length`` bytes are there, or with fewer once the oldest
        has waited for the early packet delay. The debug endpoint never has anything to say.

        Args:
            endpoint: 0x82 data, 0x81 debug messages.
            length: Most bytes to return.
            timeout_s: How long to wait [s]; none waits for ever.

        Returns:
            Whole words, at least one.

        Raises:
            UsbTimeout: Nothing came in time.
            UsbStall: There is no such endpoint.
            UsbGone: The device was unplugged.
        """
        if endpoint not in {descriptors.DATA_ENDPOINT, descriptors.DEBUG_ENDPOINT}:
            raise UsbStall(f'the camera has no endpoint {endpoint:#04x}; read 0x82 or 0x81')
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        with self._condition:
            while True:
                self._check_present()
                now = time.monotonic()
                ready_at = self._ready_at(endpoint, length, now)
                if ready_at is not None and ready_at <= now:
                    self._waiting_since = now
                    return self._fifo.pop(length)
                if deadline is not None and now >= deadline:
                    raise UsbTimeout(f'no data on endpoint {endpoint:#04x} within {timeout_s} s')
                moments = [moment for moment in (ready_at, deadline) if moment is not None]
                self._condition.wait(min(moments) - now if moments else None)

    def claim(self, owner: Hashable) -> None:
        """Give the interface to one host session.

        Raises:
            UsbBusy: Another session has it.
        """
        with self._condition:
            self._check_present()
            if self._owner not in {None, owner}:
                raise UsbBusy('the virtual camera is in use by another program; close that one')
            self._owner = owner

    def release(self, owner: Hashable) -> None:
        """Take the interface back from a session that may or may not hold it."""
        with self._condition:
            if self._owner == owner:
                self._owner = None

    def reset(self) -> None:
        """Do a USB port reset: registers, buffer and clock as after power-up."""
        with self._condition:
            self._check_present()
            self._power_up()
            self._condition.notify_all()

    # Inside; the lock is held.

    def _check_present(self) -> None:
        if self._gone:
            raise UsbGone('the virtual camera was unplugged; start the virtual sensor again')

    def _announce(self, *, was_empty: bool) -> None:
        if was_empty and len(self._fifo):
            self._waiting_since = time.monotonic()
        self._condition.notify_all()

    def _ready_at(self, endpoint: int, length: int, now: float) -> float | None:
        if endpoint != descriptors.DATA_ENDPOINT or not len(self._fifo):
            return None
        if len(self._fifo) >= length & ~1:
            return now
        cycles = self._registers.read(Module.USB, Usb.EARLY_PACKET_DELAY)
        return self._waiting_since + cycles * 1e-3 / (self.board.usb_mhz * self.board.deviation)

    def _written(self, module: int, param: int, before: int, value: int) -> None:
        if module == Module.MUX and not before and value:
            if param == Mux.TIMESTAMP_RESET:
                self._stream.restart_time(self._clock(), announce=True)
                self._announce(was_empty=not len(self._fifo))
            elif param == Mux.TIMESTAMP_RUN:
                self._stream.restart_time(self._clock(), announce=False)
        if (module, param) == (Module.APS, Aps.RUN):
            self._stream.frames_switched(on=bool(value))
        if is_filter_register(module, param):
            self._stream.settings_changed()
        if not self._stream.running:
            self._fifo.clear()
