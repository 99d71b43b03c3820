# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A virtual camera that fails on request."""

from __future__ import annotations

import errno
import math
import random
import struct
import time
from dataclasses import dataclass

from usb.core import USBError, USBTimeoutError

from mixtac_sim.usb.device import VirtualDavis346


@dataclass(frozen=True)
class Fault:
    """A fault that ends after some seconds, reads or requests; at the latest when it is cleared.

    Kinds of requests: 'refused', 'no answer', 'garbage' (random answers). Kinds of reads: 'stall'
    (the endpoint halts until the host clears the halt), 'babble', 'bus error', 'short' (a random
    number of bytes; half of a word that was cut is lost), 'lost' (5002 bytes are), 'frozen' (no
    data, until the host restarts the stream), 'hung' (reads do not end at their time-out).
    """

    kind: str
    seconds: float = math.inf
    count: float = math.inf


READ_ERRORS = {'babble': errno.EOVERFLOW, 'bus error': errno.EIO}
MUX_RUN = (0x40, 0xBF, 0, 0, struct.pack('>I', 1))


class FaultyDavis346(VirtualDavis346):
    """Has one fault at a time."""

    def __init__(self, *args, **options):
        self.clear_faults()
        super().__init__(*args, **options)

    def inject(self, fault):
        self._until_s, self._left = time.monotonic() + fault.seconds, fault.count
        self._kind = fault.kind

    def clear_faults(self):
        self._kind, self._until_s, self._left, self._halted = '', 0.0, 0.0, False

    def control(self, request_type, request, value, index, data):
        if request_type & 0x40 and self._take('refused'):
            raise USBError('injected', errno=errno.EPIPE)
        if request_type & 0x40 and self._take('no answer'):
            raise USBTimeoutError('injected', errno=errno.ETIMEDOUT)
        answer = super().control(request_type, request, value, index, data)
        if (request_type, request, index) == (0x02, 1, 0x82):
            self._halted = False
        if (request_type, request, value, index, data) == MUX_RUN and self._is('frozen'):
            self.clear_faults()
        garbage = request_type == 0xC0 and self._take('garbage')
        return random.randbytes(len(answer)) if garbage else answer

    def read_bulk(self, endpoint, length, timeout_s):
        self._halted = self._halted or self._take('stall')
        if self._halted:
            raise USBError('injected', errno=errno.EPIPE)
        for kind, number in READ_ERRORS.items():
            if self._take(kind):
                raise USBError('injected', errno=number)
        deadline_s = time.monotonic() + (timeout_s or math.inf)
        while self._is('hung') or self._is('frozen'):
            self.check_present()
            if self._is('frozen') and time.monotonic() > deadline_s:
                raise USBTimeoutError('injected', errno=errno.ETIMEDOUT)
            time.sleep(0.002)
        if self._take('lost'):
            super().read_bulk(endpoint, 5002, timeout_s)
        wanted = random.randint(1, 1500) if self._take('short') else length
        return super().read_bulk(endpoint, wanted + wanted % 2, timeout_s)[:wanted]

    def _is(self, kind):
        return self._kind == kind and self._left > 0 and time.monotonic() < self._until_s

    def _take(self, kind):
        active = self._is(kind)
        self._left -= active
        return active
