# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The asynchronous part of libusb, as its documentation describes it, over a script of data."""

from __future__ import annotations

import ctypes
import threading
import time
from collections import deque

from usb.backend import libusb1

COMPLETED, FAILED, TIMED_OUT, CANCELLED, STALLED, NO_DEVICE, OVERFLOW = range(7)
ERROR_NO_DEVICE, ERROR_NO_MEMORY = -4, -11


class FakeLibusb:
    """Answers transfers in the order in which they were submitted.

    Attributes:
        submitted: Addresses of the transfers that wait, oldest first.
        allocated: Transfers not yet freed.
        submit_error: Code that every submission returns while it is not 0.
        gives_back: False for a kernel that never finishes cancelled transfers.
    """

    def __init__(self):
        self.submitted = deque()
        self.allocated = {}
        self.submit_error = 0
        self.gives_back = True
        self._done = deque()
        self._changed = threading.Condition()

    def libusb_alloc_transfer(self, _packets):
        transfer = libusb1._libusb_transfer()
        pointer = ctypes.pointer(transfer)
        self.allocated[ctypes.addressof(transfer)] = pointer
        return pointer

    def libusb_free_transfer(self, pointer):
        address = ctypes.addressof(pointer.contents)
        assert address not in self.submitted, 'freed while it waits'
        del self.allocated[address]

    def libusb_submit_transfer(self, pointer):
        if self.submit_error:
            return self.submit_error
        address = ctypes.addressof(pointer.contents)
        with self._changed:
            assert address not in self.submitted, 'submitted twice'
            self.submitted.append(address)
        return 0

    def libusb_cancel_transfer(self, pointer):
        address = ctypes.addressof(pointer.contents)
        with self._changed:
            if self.gives_back and address in self.submitted:
                self._finish(address, CANCELLED, b'')
        return 0

    def libusb_handle_events_timeout(self, _context, time_pointer):
        fields = ctypes.cast(time_pointer, ctypes.POINTER(ctypes.c_long * 2)).contents
        deadline = time.monotonic() + fields[0] + fields[1] / 1e6
        with self._changed:
            while not self._done and time.monotonic() < deadline:
                self._changed.wait(max(deadline - time.monotonic(), 0))
            done, self._done = self._done, deque()
        for address in done:
            pointer = self.allocated[address]
            pointer.contents.callback(pointer)
        return 0

    def send(self, data, status=COMPLETED):
        """Finish the oldest transfer that waits."""
        with self._changed:
            self._finish(self.submitted[0], status, data)

    def _finish(self, address, status, data):
        self.submitted.remove(address)
        transfer = self.allocated[address].contents
        assert len(data) <= transfer.length
        ctypes.memmove(transfer.buffer, data, len(data))
        transfer.actual_length, transfer.status = len(data), status
        self._done.append(address)
        self._changed.notify_all()
