# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of the virtual camera as a host sees them, in process and over the socket."""

from __future__ import annotations

import errno
import struct
import threading
import time

import numpy as np
import pytest
import usb.core
import usb.util

from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.faults import Fault, FaultKind, UsbGone, UsbTimeout, VirtualUsbError
from mixtac_sim.usb.pyusb_backend import in_process_backend, open_backend
from mixtac_sim.usb.server import UsbServer

WORDS = np.arange(100, 400, dtype=np.uint16)
DATA = WORDS.astype('<u2').tobytes()


class Camera:
    """A started virtual camera and the host's view of it."""

    def __init__(self, device, backend):
        self.device, self.backend, self.inject = device, backend, device.inject
        self.open()

    def open(self):
        self.usb = usb.core.find(idVendor=0x152A, idProduct=0x841A, backend=self.backend)
        for module, param in ((0, 3), (9, 0), (0, 1), (0, 0)):
            self.write(module, param, 1)

    def write(self, module, param, value):
        self.usb.ctrl_transfer(0x40, 0xBF, module, param, struct.pack('>I', value), 1000)

    def register(self, module, param):
        answer = self.usb.ctrl_transfer(0xC0, 0xBF, module, param, 4, 1000)
        return struct.unpack('>I', answer)[0]

    def read(self, length=4096, timeout_ms=2000):
        return self.usb.read(0x82, length, timeout_ms).tobytes()

    def fails(self, number, call, *args):
        with pytest.raises(usb.core.USBError) as failure:
            call(*args)
        assert failure.value.errno == number


@pytest.fixture(params=['in_process', 'socket'])
def camera(request, tmp_path):
    device = VirtualDavis346('V0000042')
    if request.param == 'in_process':
        camera = Camera(device, in_process_backend(device))
        yield camera
    else:
        path = str(tmp_path / 'camera.sock')
        server = UsbServer(device, path)
        camera = Camera(device, open_backend(f'virtual:{path}'))
        yield camera
        server.close()
    usb.util.dispose_resources(camera.usb)


def test_unplugged_camera_is_gone_and_comes_back_as_after_power_up(camera):
    camera.device.unplug()
    assert usb.core.find(idVendor=0x152A, backend=camera.backend) is None
    camera.fails(errno.ENODEV, camera.register, 6, 0)
    camera.device.plug_in()
    camera.fails(errno.ENODEV, camera.register, 6, 0)
    camera.fails(errno.ENODEV, camera.read)
    old = camera.usb
    assert not camera.device.streaming
    camera.open()
    assert camera.device.streaming
    camera.fails(errno.ENODEV, old.ctrl_transfer, 0xC0, 0xBF, 6, 0, 4)


def test_it_comes_back_by_itself_with_another_serial_number(camera):
    camera.device.unplug(0.05, 'V0000099')
    while (found := usb.core.find(idVendor=0x152A, backend=camera.backend)) is None:
        time.sleep(0.005)
    assert found.serial_number == 'V0000099'


def test_stalled_endpoint_stays_halted_until_the_halt_is_cleared(camera):
    camera.device.feed(WORDS)
    camera.inject(Fault(FaultKind.STALL_DATA, count=2))
    for _ in range(2):
        camera.fails(errno.EPIPE, camera.read)
        camera.fails(errno.EPIPE, camera.read)
        camera.usb.clear_halt(0x82)
    assert camera.read() == DATA


def test_requests_that_stall(camera):
    camera.inject(Fault(FaultKind.STALL_CONTROL, count=2))
    camera.fails(errno.EPIPE, camera.register, 6, 0)
    camera.fails(errno.EPIPE, camera.write, 5, 10, 1)
    assert camera.register(6, 0) == 18
    assert camera.register(5, 10) == 0


def test_requests_that_time_out_until_the_camera_answers_again(camera):
    camera.inject(Fault(FaultKind.TIMEOUT_CONTROL, count=1))
    camera.fails(errno.ETIMEDOUT, camera.register, 6, 0)
    assert camera.register(6, 0) == 18
    camera.inject(Fault(FaultKind.TIMEOUT_CONTROL, seconds=0.04))
    assert camera.register(6, 0) == 18


def test_registers_that_read_as_garbage(camera):
    camera.inject(Fault(FaultKind.GARBAGE_REGISTERS, count=3, seed=1))
    assert len({camera.register(6, 0) for _ in range(4)} - {18}) == 3
    assert camera.register(6, 0) == 18


def test_short_reads_keep_every_word_that_was_not_cut(camera):
    camera.inject(Fault(FaultKind.SHORT_READS, count=1000, seed=2))
    camera.write(9, 1, 0)
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
    camera.write(9, 1, 0)
    camera.inject(Fault(FaultKind.DROP_BYTES, size=7))
    camera.device.feed(WORDS)
    assert camera.read() == DATA[8:]


def test_frozen_stream_goes_on_after_its_time_or_a_restart(camera):
    camera.device.feed(WORDS)
    camera.inject(Fault(FaultKind.FREEZE, seconds=0.5))  # longer than a busy host's pauses
    camera.fails(errno.ETIMEDOUT, camera.read, 4096, 10)
    assert camera.read(timeout_ms=5000) == DATA
    camera.inject(Fault(FaultKind.FREEZE))
    camera.device.feed(WORDS)
    camera.fails(errno.ETIMEDOUT, camera.read, 4096, 10)
    camera.write(0, 0, 0)
    camera.write(0, 0, 1)
    camera.device.feed(WORDS)
    assert camera.read() == DATA


@pytest.mark.parametrize(
    ('kind', 'number'), [(FaultKind.BABBLE, errno.EOVERFLOW), (FaultKind.READ_ERROR, errno.EIO)]
)
def test_reads_that_fail_on_the_bus(camera, kind, number):
    camera.device.feed(WORDS)
    camera.inject(Fault(kind, count=1))
    camera.fails(number, camera.read)
    assert camera.read() == DATA


def test_clock_reset_is_announced(camera):
    camera.write(9, 1, 0)
    origin = camera.device.clock_origin_us
    camera.device.restart_clock()
    assert camera.read() == b'\1\0'
    assert camera.device.clock_origin_us > origin


def test_hung_read_ignores_its_time_out_until_the_port_is_reset():
    device = VirtualDavis346('V0000042')
    device.inject(Fault(FaultKind.HANG_READS))
    errors = []

    def host():
        with pytest.raises(VirtualUsbError) as failure:
            device.read_bulk(0x82, 64, 0.01)
        errors.append(failure.value)

    thread = threading.Thread(target=host)
    thread.start()
    thread.join(0.1)
    assert thread.is_alive()
    device.reset()
    thread.join(5.0)
    assert not isinstance(errors[0], (UsbTimeout, UsbGone))


def test_clearing_ends_everything(camera):
    for kind in (FaultKind.STALL_DATA, FaultKind.FREEZE, FaultKind.GARBAGE_REGISTERS):
        camera.inject(Fault(kind))
    camera.device.feed(WORDS)
    camera.fails(errno.EPIPE, camera.read)
    camera.device.clear_faults()
    assert camera.register(6, 0) == 18
    assert camera.read() == DATA
