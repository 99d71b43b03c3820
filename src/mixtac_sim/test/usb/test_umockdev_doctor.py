# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the doctor finds on the USB of a machine that has a camera, measured through libusb."""

from __future__ import annotations

import json
import sys
import time

import pytest
from umockdev_scene import make_scene
from umockdev_session import Camera, bridged, need_umockdev

pytestmark = pytest.mark.umockdev

PROGRAM = """
import json, sys
from mixtac_driver.doctor import check_attached, check_running
from mixtac_driver.parameters import DriverParameters
found = [*check_attached(), *check_running(DriverParameters(), 1.0)]
found = [(f.name, f.level.name, f.found, dict(f.values)) for f in found]
json.dump(found, open(sys.argv[1], 'w'))
"""
PERIOD_US = 1_000_000


def play_again_and_again(camera, process):
    """Show the scene once a second, whatever the client does."""
    due = 0
    while process.poll() is None:
        if camera.now() + PERIOD_US // 2 > due:
            scene = make_scene().moved(due)
            camera.device.submit(scene.events, scene.frames, scene.readings)
            due += PERIOD_US
        camera.device.advance(camera.now())
        time.sleep(0.001)


def test_the_doctor_sees_a_camera_on_the_bus(tmp_path):
    need_umockdev()
    camera, out = Camera(tmp_path), tmp_path / 'findings.json'
    with bridged(camera, sys.executable, '-c', PROGRAM, str(out)) as process:
        play_again_and_again(camera, process)
    assert process.returncode == 0
    found = {
        name: (level, text, values) for name, level, text, values in json.loads(out.read_text())
    }
    assert found['camera on the USB'][1] == 'V0000346 at 1-1'
    assert found['USB speed'][2] == {'speed [Mb/s]': 5000}
    assert found['identity'][2]['firmware'] == '0.6'
    assert found['permission'][:2] == ('OK', '/dev/bus/usb/001/002 may be opened')
    assert found['identity'][2]['serial'] == 'V0000346'
    assert found['inertial samples'][2]['inertial samples [1/s]'] == pytest.approx(1000, rel=0.1)
    assert found['events'][2]['events [1/s]'] == pytest.approx(67_621, rel=0.5)
    assert found['losses'][2]['transfers_dropped'] == 0
