# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual DAVIS346 as a USB device: control requests in, data out, no transport.

It may be called from any number of threads: usually one that produces data, and one per connection.
"""

from __future__ import annotations

import math
import struct
import sys
import time
from collections.abc import Callable, Iterable
from errno import EBUSY, ENODEV, EPIPE, ETIMEDOUT
from threading import Condition
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from usb.core import USBError, USBTimeoutError

from mixtac_core.events.arrays import Events
from mixtac_sim.pixels.aps import ApsFrame
from mixtac_sim.usb import endpoints
from mixtac_sim.usb.registers import (
    CLOCK_DEVIATION,
    USB_MHZ,
    Aps,
    Dvs,
    Imu,
    Module,
    Mux,
    RegisterFile,
    Usb,
    adc_cycles_to_us,
)
from mixtac_sim.usb.stream import FILTER_REGISTERS, Oscillator, StreamAssembler
from mixtac_sim.usb.words import ImuReading

_IN: Final = 0x80
_VENDOR_OUT: Final = 0x40
_VENDOR_IN: Final = 0xC0
_TYPE_MASK: Final = 0x60
_REGISTER: Final = 0xBF
_REGISTERS: Final = 0xC2
_VALUE: Final = struct.Struct('>I')
_ENTRY: Final = struct.Struct('>BBI')
# Standard requests (USB 3.0, table 9-4).
_CLEAR_FEATURE: Final = 1
_GET_DESCRIPTOR: Final = 6
_GET_CONFIGURATION: Final = 8
_SET_CONFIGURATION: Final = 9
_ENDPOINTS: Final = {endpoints.DATA_ENDPOINT, endpoints.DEBUG_ENDPOINT}
_LONGEST_WAIT_S: Final = 3600.0


class VirtualDavis346:
    """A DAVIS346 that exists in software only.

    Args:
        serial: Serial number, at most eight characters.
        clock: Returns true time now [us].
        skew_ppm: Rate of the camera clock over true time, less one [1e-6].
        fifo_bytes: Output buffer; events are dropped (and counted) beyond half of it.

    Attributes:
        serial: Serial number.
        settings_version: Power-ups and register writes so far; unchanged as long as no setting
            changed.
    """

    def __init__(
        self,
        serial: str,
        *,
        clock: Callable[[], int] = lambda: time.monotonic_ns() // 1000,
        skew_ppm: float = 0.0,
        fifo_bytes: int = 4 << 20,
    ) -> None:
        self.serial = serial
        self._skew_ppm = skew_ppm
        self._clock = clock
        self._condition = Condition()
        # A session that began before the last plugging-in is dead, like a handle of its file.
        self._plugs, self._present = 0, True
        self._owner: Session | None = None
        self._oldest_s, self._wanted = 0.0, sys.maxsize
        self._stream = StreamAssembler(fifo_bytes)
        self.settings_version = 0
        self.plug_in()

    # The host's side.

    def unplug(self) -> None:
        """Remove the device: requests under way and later ones end with `UsbGone`."""
        with self._condition:
            self._present = False
            self._condition.notify_all()

    def plug_in(self, serial: str = '') -> None:
        """Attach the device again, as after power-up; sessions from before do not continue.

        Args:
            serial: Serial number to come back with, empty for the same.
        """
        with self._condition:
            self.serial = serial or self.serial
            self._present, self._owner = True, None
            self._plugs += 1
            self._power_up()
            self._condition.notify_all()

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
            The response; empty for requests to the device.

        Raises:
            USBError: EPIPE, the device does not know the request or refuses its content; or ENODEV,
                it was unplugged.
        """
        with self._condition:
            self.check_present()
            if request_type & _IN:
                wanted = data if isinstance(data, int) else len(data)
                return self._answer(request_type, request, value, index)[:wanted]
            sent = b'' if isinstance(data, int) else data
            self._obey(request_type, request, value, index, sent)
            return b''

    def read_bulk(self, endpoint: int, length: int, timeout_s: float | None) -> bytes:
        """Wait for data from an endpoint.

        The data endpoint answers when ``length`` bytes are there, or with fewer once the oldest
        has waited for the early packet delay. The debug endpoint never has data.

        Args:
            endpoint: 0x82 data, 0x81 debug messages.
            length: Most bytes to return.
            timeout_s: Longest wait [s]; None waits without limit.

        Returns:
            Whole words, at least one.

        Raises:
            USBTimeoutError: Nothing came in time.
            USBError: EPIPE, there is no such endpoint; or ENODEV, the device was unplugged.
        """
        if endpoint not in _ENDPOINTS:
            text = f'the camera has no endpoint {endpoint:#04x}; read 0x82 or 0x81'
            raise USBError(text, errno=EPIPE)
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        most, fifo = length & ~1, self._stream.fifo
        with self._condition:
            plugs = self._plugs
            while True:
                self.check_present(plugs)
                now = time.monotonic()
                ready_at = math.inf
                if fifo and endpoint == endpoints.DATA_ENDPOINT:
                    ready_at = now if len(fifo) >= most else self._oldest_s + self._early_packet_s()
                if ready_at <= now:
                    self._oldest_s, self._wanted = now, sys.maxsize
                    data = bytes(fifo[:most])
                    del fifo[:most]
                    return data
                if now >= deadline:
                    text = f'no data on endpoint {endpoint:#04x} within {timeout_s} s'
                    raise USBTimeoutError(text, errno=ETIMEDOUT)
                self._wanted = min(self._wanted, most)
                self._condition.wait(min(ready_at, deadline, now + _LONGEST_WAIT_S) - now)

    @property
    def plugs(self) -> int:
        """Number of times the device was plugged in; a session keeps it for `check_present`."""
        with self._condition:
            return self._plugs

    def check_present(self, plugs: int | None = None) -> None:
        """Check that the device is present.

        Args:
            plugs: What `plugs` was when the session began; None for any.

        Raises:
            USBError: ENODEV, it was unplugged, now or since then.
        """
        with self._condition:
            if not self._present:
                text = 'the virtual camera was unplugged; start the virtual sensor again'
                raise USBError(text, errno=ENODEV)
            if plugs not in (None, self._plugs):
                raise USBError('the virtual camera was unplugged; open it again', errno=ENODEV)

    def claim(self, owner: Session) -> None:
        """Give the interface to one session.

        Raises:
            USBError: EBUSY, another session has it.
        """
        with self._condition:
            self.check_present()
            if self._owner not in {None, owner}:
                text = 'the virtual camera is in use by another program; close that one'
                raise USBError(text, errno=EBUSY)
            self._owner = owner

    def release(self, owner: Session) -> None:
        """Release the interface if a session holds it."""
        with self._condition:
            if self._owner == owner:
                self._owner = None

    # The producer's side.

    def submit(
        self,
        events: Events | None = None,
        frames: Iterable[ApsFrame] = (),
        readings: Iterable[ImuReading] = (),
    ) -> None:
        """Hand over data that the camera sends when `advance` reaches its time.

        Args:
            events: Sorted by ``t`` [us, true time]; none before the events of earlier calls.
            frames: Frames in order of time.
            readings: Inertial samples in order of time.
        """
        with self._condition:
            self._stream.submit(events or Events.empty(), frames, readings)

    def advance(self, true_us: int) -> None:
        """Advance true time [us]: send what is due and the wraps of the camera clock."""
        with self._condition:
            was_empty = not self._stream.fifo
            # What is sent may be as old as the whole step, as far as the early packet delay goes.
            age_us = true_us - self._stream.done_us
            self._stream.advance(true_us)
            self._announce(was_empty=was_empty, age_s=1e-6 * age_us)

    def feed(self, words: NDArray[np.uint16]) -> bool:
        """Send raw stream words as they are, if the run bits are set and the buffer has room.

        Returns:
            Whether they were taken.
        """
        with self._condition:
            was_empty = not self._stream.fifo
            taken = self._stream.running and self._stream.push(words)
            self._announce(was_empty=was_empty)
            return taken

    def register(self, module: int, param: int) -> int:
        """Return a register as the host would read it."""
        with self._condition:
            return self._registers.read(module, param)

    @property
    def backlog(self) -> int:
        """Bytes that the host has not read yet."""
        return len(self._stream.fifo)

    @property
    def exposure_us(self) -> int:
        """Exposure set by the host [us]."""
        return adc_cycles_to_us(self.register(Module.APS, Aps.EXPOSURE))

    @property
    def frame_interval_us(self) -> int:
        """Time between frame starts set by the host [us]; 0 as fast as possible."""
        return adc_cycles_to_us(self.register(Module.APS, Aps.FRAME_INTERVAL))

    @property
    def imu_interval_us(self) -> int:
        """Time between inertial samples set by the host [us]; 0 while they are off."""
        with self._condition:
            settings = self._stream.imu_settings()
            divider = self._registers.read(Module.IMU, Imu.SAMPLE_RATE_DIVIDER)
            return 1000 * (1 + divider) if settings.running and self._stream.running else 0

    @property
    def clock_origin_us(self) -> int:
        """True time [us] of the camera's last timestamp reset."""
        return self._oscillator.origin_us

    def stamp_us(self, true_us: int) -> int:
        """Return a true time [us] as a driver publishes it.

        Returns:
            Host time of the camera's last timestamp reset, plus its time since [us since the Unix
            epoch].
        """
        with self._condition:
            return self._reset_host_us + self._oscillator.now(true_us)

    @property
    def streaming(self) -> bool:
        """Whether the host has set the run bits."""
        with self._condition:
            return self._stream.running and self._present

    @property
    def losses(self) -> dict[str, int]:
        """Losses since power-up: events and frames that found the buffer full."""
        with self._condition:
            counts = self._registers.counts
            dropped = counts[Module.MUX, Mux.DVS_DROPPED] + counts[Module.DVS, Dvs.DROPPED]
            return {'events_dropped': dropped, 'frames_dropped': self._stream.frames_dropped}

    # Internal; the lock is held.

    def _power_up(self) -> None:
        self.settings_version += 1
        self._registers = RegisterFile()
        self._oscillator = Oscillator(self._skew_ppm)
        self._reset_host_us = time.time_ns() // 1000 - self._clock()
        self._stream.power_up(self._registers, self._oscillator)
        self._configuration = 1

    def _early_packet_s(self) -> float:
        cycles = self._registers.read(Module.USB, Usb.EARLY_PACKET_DELAY)
        return cycles * 1e-6 / (USB_MHZ * CLOCK_DEVIATION * 1e-3)

    def _announce(self, *, was_empty: bool, age_s: float = 0.0) -> None:
        """Wake readers if one of them may have enough data now.

        Args:
            was_empty: Whether the buffer was empty before.
            age_s: Age of the oldest of the new data [s].
        """
        if was_empty and self._stream.fifo:
            self._oldest_s = time.monotonic() - age_s
        elif len(self._stream.fifo) < self._wanted:
            return
        self._condition.notify_all()

    def _restart_time(self, *, announce: bool) -> None:
        was_empty = not self._stream.fifo
        self._reset_host_us = time.time_ns() // 1000
        self._stream.restart_time(self._clock(), announce=announce)
        self._announce(was_empty=was_empty)

    def _answer(self, request_type: int, request: int, value: int, index: int) -> bytes:
        """Answer a request for data."""
        if (request_type, request) == (_VENDOR_IN, _REGISTER):
            return _VALUE.pack(self._registers.read(value, index))
        if not request_type & _TYPE_MASK and request == _GET_CONFIGURATION:
            return bytes((self._configuration,))
        if not request_type & _TYPE_MASK and request == _GET_DESCRIPTOR:
            answer = endpoints.descriptor(value >> 8, value & 0xFF, self.serial)
            if answer is not None:
                return answer
        raise USBError(f'unknown request {request_type:#04x}/{request:#04x}', errno=EPIPE)

    def _obey(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """Carry out a request that sends data or none."""
        size = len(data)
        if (request_type, request, size) == (_VENDOR_OUT, _REGISTER, _VALUE.size):
            self._write(value, index, _VALUE.unpack(data)[0])
        elif (request_type, request, size) == (_VENDOR_OUT, _REGISTERS, _ENTRY.size * value):
            for entry in _ENTRY.iter_unpack(data):
                self._write(*entry)
        elif not request_type & _TYPE_MASK and request == _SET_CONFIGURATION and value < 2:
            self._configuration = value
        elif request_type & _TYPE_MASK or request != _CLEAR_FEATURE:
            name = f'{request_type:#04x}/{request:#04x}'
            raise USBError(f'unknown request {name} of {value} with {size} bytes', errno=EPIPE)

    def _write(self, module: int, param: int, value: int) -> None:
        before = self._registers.read(module, param)
        self._registers.write(module, param, value)
        self.settings_version += 1
        if module == Module.MUX and not before and value:
            if param == Mux.TIMESTAMP_RESET:
                self._restart_time(announce=True)
            elif param == Mux.TIMESTAMP_RUN:
                self._restart_time(announce=False)
        if (module, param) == (Module.APS, Aps.RUN) and value:
            self._stream.snapshot = True
        if module == Module.USB:
            self._condition.notify_all()
        if module == Module.DVS and param in FILTER_REGISTERS:
            self._stream.settings_changed()
        if not self._stream.running:
            self._stream.fifo.clear()


Setup: TypeAlias = tuple[int, int, int, int]
"""``bmRequestType``, ``bRequest``, ``wValue`` and ``wIndex`` of a control request."""


class Session:
    """What a host does from opening to closing the camera; it ends when the camera is unplugged.

    Args:
        device: The camera.
    """

    def __init__(self, device: VirtualDavis346) -> None:
        self._device = device
        self._plugs = device.plugs

    def control(self, setup: Setup, data: bytes | int) -> bytes:
        """Make a control request; see `VirtualDavis346.control`."""
        self._device.check_present(self._plugs)
        return self._device.control(*setup, data)

    def read(self, endpoint: int, length: int, timeout_ms: int) -> bytes:
        """Read from an endpoint; see `VirtualDavis346.read_bulk`. 0 waits without limit."""
        self._device.check_present(self._plugs)
        return self._device.read_bulk(endpoint, length, timeout_ms / 1000 or None)

    def claim(self) -> None:
        """Claim the interface for this session; EBUSY if another one has it."""
        self._device.check_present(self._plugs)
        self._device.claim(self)

    def close(self) -> None:
        """Give the interface back."""
        self._device.release(self)

    release = close
