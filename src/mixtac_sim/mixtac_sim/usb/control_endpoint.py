# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoint 0 of the camera: standard requests and the register requests of the vendor."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from mixtac_sim.usb import descriptors
from mixtac_sim.usb.errors import UsbStall

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_sim.usb.registers import RegisterFile

REQUEST_REGISTER: Final = 0xBF
REQUEST_REGISTERS: Final = 0xC2
_VENDOR_OUT: Final = 0x40
_VENDOR_IN: Final = 0xC0
_TYPE_MASK: Final = 0x60
_VALUE: Final = struct.Struct('>I')
_ENTRY: Final = struct.Struct('>BBI')
_CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS = 1, 3, 5
_GET_STATUS, _GET_DESCRIPTOR, _GET_CONFIGURATION, _GET_INTERFACE = 0, 6, 8, 10
_SET_CONFIGURATION, _SET_INTERFACE = 9, 11
_ACCEPTED: Final = {_CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS}


class ControlEndpoint:
    """Decodes control requests. Not thread safe: the device guards it.

    Args:
        registers: The register file.
        serial: Serial number for the string descriptor.
        on_write: Called after each register write with module, parameter, old and new value.
    """

    def __init__(
        self,
        registers: RegisterFile,
        serial: str,
        on_write: Callable[[int, int, int, int], None],
    ) -> None:
        self._registers = registers
        self._serial = serial
        self._on_write = on_write
        self._configuration = 1

    def answer(self, request_type: int, request: int, value: int, index: int) -> bytes:
        """Answer a request for data.

        Raises:
            UsbStall: The camera does not know the request.
        """
        answer: bytes | None = None
        if request_type == _VENDOR_IN and request == REQUEST_REGISTER:
            answer = _VALUE.pack(self._registers.read(value, index))
        elif not request_type & _TYPE_MASK:
            answer = self._standard_answer(request, value)
        if answer is None:
            raise UsbStall(f'the camera knows no request {request_type:#04x}/{request:#04x}')
        return answer

    def _standard_answer(self, request: int, value: int) -> bytes | None:
        if request == _GET_DESCRIPTOR:
            return self._descriptor(value >> 8, value & 0xFF)
        fixed = {
            _GET_STATUS: b'\0\0',
            _GET_CONFIGURATION: bytes((self._configuration,)),
            _GET_INTERFACE: b'\0',
        }
        return fixed.get(request)

    def _descriptor(self, kind: int, index: int) -> bytes | None:
        if kind == 1:
            return descriptors.device_descriptor()
        if kind == 2 and index == 0:
            return descriptors.configuration_descriptor()
        if kind == 3:
            return descriptors.string_descriptor(index, self._serial)
        return None

    def obey(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """Carry out a request that sends data or none.

        Raises:
            UsbStall: The camera does not know the request or its data have the wrong length.
        """
        if request_type == _VENDOR_OUT:
            self._write_registers(request, value, index, data)
        elif request_type & _TYPE_MASK:
            raise UsbStall(f'the camera knows no request {request_type:#04x}/{request:#04x}')
        else:
            self._standard(request, value)

    def _standard(self, request: int, value: int) -> None:
        if request == _SET_CONFIGURATION and value in {0, 1}:
            self._configuration = value
        elif request not in _ACCEPTED and not (request == _SET_INTERFACE and value == 0):
            raise UsbStall(f'the camera refuses standard request {request} with value {value}')

    def _write_registers(self, request: int, value: int, index: int, data: bytes) -> None:
        if request == REQUEST_REGISTER and len(data) == _VALUE.size:
            self._write(value, index, _VALUE.unpack(data)[0])
        elif request == REQUEST_REGISTERS and len(data) == _ENTRY.size * value:
            for module, param, setting in _ENTRY.iter_unpack(data):
                self._write(module, param, setting)
        else:
            raise UsbStall(f'the camera refuses request {request:#04x} with {len(data)} bytes')

    def _write(self, module: int, param: int, value: int) -> None:
        before = self._registers.read(module, param)
        self._registers.write(module, param, value)
        self._on_write(module, param, before, value)
