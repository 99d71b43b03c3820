# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cameras that speak another protocol are refused: by our driver where the others refuse them."""

from __future__ import annotations

import time

import pytest
from umockdev_session import CLIENTS, HERE, Camera, bridged, client_python, need_umockdev

from mixtac_sim.usb.device import VirtualDavis346

pytestmark = pytest.mark.umockdev

READ_REGISTER = (0xC0, 0xBF)
LOGIC_VERSION = (6, 0)
DEVICE_DESCRIPTOR = (0x80, 6, 0x0100)
RELEASE_AT = 12


class OtherLogic(VirtualDavis346):
    """A camera with FPGA logic 17."""

    def control(self, request_type, request, value, index, *rest):
        if (request_type, request) == READ_REGISTER and (value, index) == LOGIC_VERSION:
            return (17).to_bytes(4, 'big')
        return super().control(request_type, request, value, index, *rest)


class OtherFirmware(VirtualDavis346):
    """A camera with USB firmware 0.5."""

    firmware = 0x0005

    def control(self, request_type, request, value, *rest):
        answer = super().control(request_type, request, value, *rest)
        if (request_type, request, value) != DEVICE_DESCRIPTOR:
            return answer
        return answer[:RELEASE_AT] + self.firmware.to_bytes(2, 'little') + answer[RELEASE_AT + 2 :]


class NextFirmware(OtherFirmware):
    """A camera with USB firmware 1.6, whose protocol is another."""

    firmware = 0x0106


def refusal(client, kind, folder):
    """Return what a client says when it refuses a camera."""
    need_umockdev()
    python = client_python(client)
    camera, said = Camera(folder, kind), folder / 'stderr'
    script, ready = str(HERE / 'umockdev_clients.py'), folder / 'ready'
    arguments = client, str(folder / 'out'), str(ready), str(folder / 'done')
    with (
        said.open('w') as stderr,
        bridged(camera, python, script, *arguments, stderr=stderr) as process,
    ):
        while process.poll() is None:
            assert not ready.exists(), 'the client streams'
            camera.device.advance(camera.now())
            time.sleep(0.005)
    assert process.returncode != 0
    return said.read_text()


@pytest.mark.parametrize('client', CLIENTS)
@pytest.mark.parametrize(
    ('kind', 'part', 'version'), [(OtherLogic, 'logic', '17'), (OtherFirmware, 'firmware', '5')]
)
def test_other_versions_are_refused(client, kind, part, version, tmp_path, capfd):
    # libcaer writes to the standard output.
    text = refusal(client, kind, tmp_path) + ''.join(capfd.readouterr())
    assert part in text.lower()
    assert version in text


def test_the_next_firmware_is_refused_by_our_driver(tmp_path):
    """libcaer looks at its minor version only and opens it."""
    assert 'firmware 1.6' in refusal('ours', NextFirmware, tmp_path)
