# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plain pyusb on a virtual camera, in process and over the socket."""

from __future__ import annotations

import array
import errno
import socket
import stat
import struct
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest
import usb.core
import usb.util

from mixtac_sim import SimulationError
from mixtac_sim.usb import wire
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.pyusb_backend import in_process_backend, open_backend
from mixtac_sim.usb.server import UsbServer, check_free


@pytest.fixture
def device():
    return VirtualDavis346('V0000042')


@pytest.fixture
def path(monkeypatch):
    # pytest's folders, with the user's name and the test's, are too long for a socket.
    with tempfile.TemporaryDirectory(prefix='mixtac-') as folder:
        monkeypatch.setenv('XDG_RUNTIME_DIR', folder)
        monkeypatch.setenv('ROS_DOMAIN_ID', '17')
        yield wire.default_socket_path()


@pytest.fixture
def server(device, path):
    server = UsbServer(device, path)
    yield server
    server.close()


@pytest.fixture(params=['in_process', 'socket'])
def backend(request, device):
    if request.param == 'in_process':
        return in_process_backend(device)
    request.getfixturevalue('server')
    return open_backend('virtual')


def find(backend):
    camera = usb.core.find(idVendor=0x152A, idProduct=0x841A, backend=backend)
    assert camera is not None
    return camera


def start(camera):
    for module, param in ((0, 3), (9, 0), (0, 1), (0, 0)):
        camera.ctrl_transfer(0x40, 0xBF, module, param, struct.pack('>I', 1))


def test_pyusb_finds_configures_and_describes_the_camera(backend):
    assert usb.core.find(idVendor=0x152A, idProduct=0x841B, backend=backend) is None
    camera = find(backend)
    assert camera.serial_number == 'V0000042'
    assert (camera.manufacturer, camera.product) == ('iniVation', 'DAVIS346')
    assert camera.bcdDevice == 6
    camera.set_configuration()
    configuration = camera.get_active_configuration()
    endpoints = [e.bEndpointAddress for e in configuration[(0, 0)]]
    assert endpoints == [0x82, 0x81]
    usb.util.claim_interface(camera, 0)
    camera.clear_halt(0x82)
    usb.util.dispose_resources(camera)


def test_control_and_data(backend, device):
    camera = find(backend)
    camera.set_configuration(1)
    start(camera)
    value = camera.ctrl_transfer(0xC0, 0xBF, 6, 0, 4)
    assert bytes(value) == struct.pack('>I', 18)
    words = np.random.default_rng(1).integers(0, 1 << 16, 60_000).astype(np.uint16)
    device.feed(words)
    data = b''
    buffer = array.array('B', bytes(8192))
    while len(data) < words.nbytes:
        data += buffer[: camera.read(0x82, buffer, 1000)].tobytes()
    assert data == words.astype('<u2').tobytes()
    usb.util.dispose_resources(camera)


def test_failures_have_pyusb_errors(backend):
    camera = find(backend)
    camera.set_configuration()
    with pytest.raises(usb.core.USBTimeoutError) as timeout:
        camera.read(0x82, 64, 5)
    assert timeout.value.errno == errno.ETIMEDOUT
    fails(errno.EPIPE, camera.ctrl_transfer, 0x40, 0xB1, 2, 0, None)
    other = find(backend)
    fails(errno.EBUSY, usb.util.claim_interface, other, 0)
    usb.util.dispose_resources(other)


def test_unplugged_camera_is_gone_and_comes_back_as_another(backend, device):
    camera = find(backend)
    start(camera)
    device.unplug()
    assert usb.core.find(idVendor=0x152A, backend=backend) is None
    for _ in range(2):
        fails(errno.ENODEV, camera.read, 0x82, 64, 1000)
        fails(errno.ENODEV, camera.ctrl_transfer, 0xC0, 0xBF, 6, 0, 4)
        device.plug_in('V0000099')
    assert find(backend).serial_number == 'V0000099'
    assert not device.streaming


def fails(number, call, *arguments):
    with pytest.raises(usb.core.USBError) as failure:
        call(*arguments)
    assert failure.value.errno == number


def test_server_end_is_a_disconnect(server):
    camera = find(open_backend('virtual'))
    camera.set_configuration()
    thread = threading.Thread(target=fails, args=(errno.ENODEV, camera.read, 0x82, 64, 0))
    thread.start()
    server.close()
    thread.join(10.0)
    fails(errno.ENODEV, camera.ctrl_transfer, 0xC0, 0xBF, 6, 0, 4)
    assert not Path(server.path).exists()


def test_socket_is_private_and_removed(device, path):
    server = UsbServer(device, path)
    assert stat.S_IMODE(Path(path).stat().st_mode) == 0o600
    with pytest.raises(SimulationError):
        UsbServer(VirtualDavis346('V0000043'), path)
    with pytest.raises(SimulationError):
        check_free(path)
    server.close()
    assert not list(Path(path).parent.iterdir())
    check_free(path)
    assert not list(Path(path).parent.iterdir())


def test_socket_of_a_killed_server_is_replaced(path):
    script = (
        'import os, sys\n'
        'from mixtac_sim.usb.device import VirtualDavis346\n'
        'from mixtac_sim.usb.server import UsbServer\n'
        "server = UsbServer(VirtualDavis346('V0000042'), sys.argv[1])\n"
        'os.kill(os.getpid(), 9)\n'
    )
    subprocess.run([sys.executable, '-c', script, path], check=False)
    assert Path(path).is_socket()
    server = UsbServer(VirtualDavis346('V0000043'), path)
    assert find(open_backend('virtual')).serial_number == 'V0000043'
    server.close()


@pytest.mark.parametrize('kind', [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_sockets_of_other_programs_are_left_alone(path, kind):
    with socket.socket(socket.AF_UNIX, kind) as other:
        other.bind(path)
        if kind == socket.SOCK_STREAM:
            other.listen()
        inode = Path(path).stat().st_ino
        with pytest.raises(SimulationError):
            UsbServer(VirtualDavis346('V0000042'), path)
        assert Path(path).stat().st_ino == inode


def test_without_a_server_the_error_names_the_socket(path):
    with pytest.raises(SimulationError) as failure:
        open_backend('virtual')
    assert path in str(failure.value)
