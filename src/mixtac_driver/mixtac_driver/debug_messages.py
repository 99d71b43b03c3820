# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the camera's USB controller says of itself on its debug endpoint.

| byte | meaning |
|---|---|
| 0 | 0: a message |
| 1 | code, 0 where nothing is wrong |
| 2 .. 5 | time, u32, little-endian, in the controller's own units |
| 6 .. | text, ASCII, up to 58 bytes |
"""

from __future__ import annotations

import threading
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING

from usb.core import USBError, USBTimeoutError

if TYPE_CHECKING:
    from collections.abc import Callable

MESSAGE_SIZE = 64
HEADER_SIZE = 6
READ_TIMEOUT_MS = 100
STOP_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class DebugMessage:
    """One message.

    Attributes:
        code: 0 where nothing is wrong.
        time: Time of the message on the controller's clock, in its own units.
        text: What it says.
    """

    code: int
    time: int
    text: str


def decode_message(data: bytes) -> DebugMessage | None:
    """Return the message that a transfer of the debug endpoint holds, or None if none."""
    if not HEADER_SIZE < len(data) <= MESSAGE_SIZE or data[0] != 0:
        return None
    text = data[HEADER_SIZE:].split(b'\0')[0].decode('ascii', 'replace')
    return DebugMessage(data[1], int.from_bytes(data[2:6], 'little'), text)


class DebugReader:
    """Reads the debug endpoint in a thread of its own, until stopped or until that fails.

    It is harmless where there is no such endpoint, and when the camera goes away: the reader of
    the data endpoint sees that too, and reports it.

    Args:
        read: Reads into a buffer within a time [ms] and returns the number of bytes; raises as
            pyusb does.
        on_message: Called in the thread with each message.
    """

    def __init__(
        self,
        read: Callable[[array[int], int], int],
        on_message: Callable[[DebugMessage], None],
    ) -> None:
        self._read = read
        self._on_message = on_message
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name='davis-debug', daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """End reading; returns when the thread has ended."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(STOP_TIMEOUT_S)

    def _run(self) -> None:
        buffer = array('B', bytes(MESSAGE_SIZE))
        while not self._stopping.is_set():
            try:
                count = self._read(buffer, READ_TIMEOUT_MS)
            except USBTimeoutError:
                continue
            except (USBError, OSError, ValueError, NotImplementedError):
                # pyusb: a ValueError is an endpoint that the descriptors do not name.
                return
            message = decode_message(buffer[:count].tobytes())
            if message is not None:
                self._on_message(message)
