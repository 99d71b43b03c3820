# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of the virtual camera as a host sees them."""

from __future__ import annotations

import struct
import threading

import numpy as np
import pytest

from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.faults import (
    Fault,
    FaultKind,
    UsbOverflow,
    UsbStall,
    UsbTimeout,
    VirtualUsbError,
)

WORDS = np.arange(100, 400, dtype=np.uint16)
DATA = WORDS.astype('<u2').tobytes()
LOGIC_VERSION = 18


class Camera:
    """A started virtual camera that sends what it has at once."""

    def __init__(self):
        self.device = VirtualDavis346('V0000042')
        for module, param in ((0, 3), (9, 0), (0, 1), (0, 0)):
            self.write(module, param, 1)
        self.write(9, 1, 0)

    def inject(self, kind, **options):
        self.device.inject(Fault(kind, **options))

    def write(self, module, param, value):
        self.device.control(0x40, 0xBF, module, param, struct.pack('>I', value), 1.0)

    def version(self, timeout_s=1.0):
        answer = self.device.control(0xC0, 0xBF, 6, 0, 4, timeout_s)
        return struct.unpack('>I', answer)[0]

    def read(self, timeout_s=2.0):
        return self.device.read_bulk(0x82, 4096, timeout_s)


@pytest.fixture
def camera():
    return Camera()


def test_stalled_endpoint_stays_halted_until_the_halt_is_cleared(camera):
    camera.device.feed(WORDS)
    camera.inject(FaultKind.STALL_DATA, count=2)
    for _ in range(2):
        for _ in range(2):
            with pytest.raises(UsbStall):
                camera.read()
        camera.device.control(0x02, 1, 0, 0x82, b'')
    assert camera.read() == DATA


def test_vendor_requests_that_stall_or_time_out(camera):
    camera.inject(FaultKind.STALL_CONTROL, count=1)
    with pytest.raises(UsbStall):
        camera.version()
    assert camera.version() == LOGIC_VERSION
    camera.inject(FaultKind.TIMEOUT_CONTROL, count=1)
    assert len(camera.device.control(0x80, 6, 0x0100, 0, 18)) == 18
    with pytest.raises(UsbTimeout):
        camera.version(0.01)
    camera.inject(FaultKind.TIMEOUT_CONTROL, seconds=0.04)
    assert camera.version(60.0) == LOGIC_VERSION


def test_registers_that_read_as_garbage(camera):
    camera.inject(FaultKind.GARBAGE_REGISTERS, count=3, seed=1)
    assert len({camera.version() for _ in range(4)} - {LOGIC_VERSION}) == 3
    assert camera.version() == LOGIC_VERSION


def test_short_reads_keep_every_word_that_was_not_cut(camera):
    camera.inject(FaultKind.SHORT_READS, count=1000, seed=2)
    camera.device.feed(WORDS)
    got, lengths, lost = [], set(), 0
    while len(got) + lost < len(WORDS):
        data = camera.read()
        lengths.add(len(data) % 2)
        got += struct.unpack(f'<{len(data) // 2}H', data[: len(data) // 2 * 2])
        lost += len(data) % 2
    assert lengths == {0, 1}
    assert set(got) <= set(WORDS.tolist())
    assert len(got) == len(WORDS) - lost


def test_lost_bytes_are_whole_words(camera):
    camera.inject(FaultKind.DROP_BYTES, size=7)
    camera.device.feed(WORDS)
    assert camera.read() == DATA[8:]


def test_frozen_stream_goes_on_after_its_time_or_a_restart(camera):
    camera.device.feed(WORDS)
    camera.inject(FaultKind.FREEZE, seconds=0.5)  # longer than a busy host's pauses
    with pytest.raises(UsbTimeout):
        camera.read(0.01)
    assert camera.read(60.0) == DATA
    camera.inject(FaultKind.FREEZE)
    camera.device.feed(WORDS)
    with pytest.raises(UsbTimeout):
        camera.read(0.01)
    camera.write(0, 0, 0)
    camera.write(0, 0, 1)
    camera.device.feed(WORDS)
    assert camera.read() == DATA


@pytest.mark.parametrize(
    ('kind', 'error'), [(FaultKind.BABBLE, UsbOverflow), (FaultKind.READ_ERROR, VirtualUsbError)]
)
def test_reads_that_fail_on_the_bus(camera, kind, error):
    camera.device.feed(WORDS)
    camera.inject(kind, count=1)
    with pytest.raises(error):
        camera.read()
    assert camera.read() == DATA


def test_a_hung_read_ignores_its_time_out_until_the_fault_ends(camera):
    camera.inject(FaultKind.HANG_READS)
    done = threading.Event()

    def host():
        with pytest.raises(UsbTimeout):
            camera.read(0.01)
        done.set()

    threading.Thread(target=host, daemon=True).start()
    assert not done.wait(0.1)
    camera.device.clear_faults()
    assert done.wait(5.0)


def test_clearing_ends_everything(camera):
    for kind in (FaultKind.STALL_DATA, FaultKind.FREEZE, FaultKind.GARBAGE_REGISTERS):
        camera.inject(kind)
    camera.device.feed(WORDS)
    with pytest.raises(UsbStall):
        camera.read()
    camera.device.clear_faults()
    assert camera.version() == LOGIC_VERSION
    assert camera.read() == DATA
