# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the doctor finds: on made-up system files, on a virtual camera, and in figures."""

from __future__ import annotations

import dataclasses
import os

import pytest
from davis_fake import FakeBackend, FakeCamera
from virtual_scene import Scene

from mixtac_core.events.clock_map import ClockEstimate
from mixtac_driver import doctor
from mixtac_driver.camera import Davis346
from mixtac_driver.doctor import Finding, Level, Measurement, check_measurement, check_running, ok
from mixtac_driver.parameters import DriverParameters
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.pyusb_backend import in_process_backend

VIRTUAL = DriverParameters(device='virtual')


def test_what_to_do_first_is_the_first_of_the_worst():
    warning, error = Finding('b', Level.WARN, 'b'), Finding('c', Level.ERROR, 'c', 'mend c')
    findings = [ok('a', 'a'), warning, error, Finding('d', Level.ERROR, 'd')]
    assert doctor.first_to_do(findings) is error
    assert doctor.first_to_do(findings[:2]) is warning
    assert doctor.first_to_do(findings[:1]) is None
    assert doctor.worst([]) is Level.OK


def plug_in(root, port='2-1', **changes):
    """Write the files that the kernel shows for a camera."""
    files = {
        'idVendor': '152a',
        'idProduct': '841a',
        'busnum': '2',
        'devnum': '5',
        'speed': '5000',
        'serial': '00000123',
        **changes,
    }
    folder = root / doctor.DEVICES / port
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name).write_text(f'{text}\n')
    node = root / f'dev/bus/usb/002/{int(files["devnum"]):03d}'
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()
    return root


def finding_of(root, name, serial=''):
    return {each.name: each for each in doctor.check_attached(serial, root)}[name]


@pytest.mark.parametrize('usb', [False, True])
def test_no_camera_is_an_error_that_names_the_virtual_device(tmp_path, usb):
    if usb:
        (tmp_path / doctor.DEVICES).mkdir(parents=True)
    (finding,) = doctor.check_attached(root=tmp_path)
    assert finding.level is Level.ERROR
    assert '152a:841a' in finding.found
    assert '--device virtual' in finding.remedy


@pytest.mark.parametrize(
    ('serial', 'level', 'speeds'),
    [('', Level.ERROR, 2), ('00000124', Level.OK, 1), ('9', Level.ERROR, 0)],
)
def test_several_cameras_need_a_serial_number(tmp_path, serial, level, speeds):
    plug_in(tmp_path, '2-1')
    plug_in(tmp_path, '2-2', serial='00000124', devnum='6')
    finding = finding_of(tmp_path, 'camera on the USB', serial)
    assert (finding.level, '00000124 at 2-2' in finding.found) == (level, True)
    names = [each.name for each in doctor.check_attached(serial, tmp_path)]
    assert names.count('USB speed') == speeds


@pytest.mark.parametrize(
    ('speed', 'level'),
    [('5000', Level.OK), ('480', Level.WARN), ('1.5', Level.ERROR)],
)
def test_speed(tmp_path, speed, level):
    finding = finding_of(plug_in(tmp_path, speed=speed), 'USB speed')
    assert finding.level is level
    assert ('USB 3 port' in finding.remedy) == (level > Level.OK)


def test_permission(tmp_path, monkeypatch):
    root = plug_in(tmp_path)
    assert finding_of(root, 'permission').level is Level.OK
    monkeypatch.setattr(os, 'access', lambda *_: False)  # root may open everything
    assert f'sudo cp {doctor.RULE_FILE} /etc' in finding_of(root, 'permission').remedy
    (root / 'dev/bus/usb/002/005').unlink()
    finding = finding_of(root, 'permission')
    assert (finding.level, '--device=/dev/bus/usb' in finding.remedy) == (Level.ERROR, True)


def test_the_rule_that_is_named_matches_the_camera():
    assert 'ATTRS{idVendor}=="152a"' in doctor.RULE_FILE.read_text()


CLOCK = ClockEstimate(offset_us=0.0, skew_ppm=12.0, span_s=11.0, steps=0)
GOOD = Measurement(
    seconds=2.0,
    events=100_000,
    frames=50,
    samples=2000,
    clock=CLOCK,
)


@pytest.fixture(scope='module')
def identity():
    with Davis346(backend=FakeBackend(FakeCamera())) as camera:
        return camera.identity


@pytest.mark.parametrize(
    ('name', 'changes', 'level'),
    [
        ('events', {'events': 0}, Level.WARN),
        ('frames', {'frames': 0}, Level.ERROR),
        ('frames', {'frames': 40}, Level.WARN),
        ('inertial samples', {'samples': 1500}, Level.WARN),
        ('losses', {'losses': {'frames dropped': 2}}, Level.WARN),
        ('losses', {'dropped': 3}, Level.WARN),
        ('camera clock', {'clock': None}, Level.WARN),
        ('camera clock', {'clock_resets': 1}, Level.WARN),
        ('camera clock', {'clock': dataclasses.replace(CLOCK, skew_ppm=-150.0)}, Level.WARN),
        ('camera clock', {'clock': dataclasses.replace(CLOCK, span_s=2.0)}, Level.OK),
        ('losses', {'seconds': 0.0}, Level.OK),
    ],
)
def test_figures_are_judged(identity, name, changes, level):
    result = dataclasses.replace(GOOD, **changes)
    findings = check_measurement(result, DriverParameters(), identity)
    finding = {each.name: each for each in findings}[name]
    assert finding.level is level
    assert bool(finding.remedy) == (level > Level.OK)


@pytest.fixture
def scene():
    scene = Scene()
    yield scene
    scene.close()


@pytest.mark.live
def test_a_running_camera_is_measured(scene):
    backend = in_process_backend(scene.device)
    found = {f.name: f for f in check_running(VIRTUAL, 2.0, backend=backend)}
    assert found['identity'].values['serial'] == 'V0000042'
    assert found['identity'].values['chip'] == 'DAVIS346B'
    # A busy host counts fewer than the scene has.
    for name in ('events', 'frames', 'inertial samples'):
        assert found[name].values[f'{name} [1/s]'] > 0
    # There are 200 per second, the camera would have 1000.
    assert found['inertial samples'].level is Level.WARN
    # It was given back: another may have it at once.
    assert next(check_running(VIRTUAL, 0.1, backend=backend)).name == 'identity'


def test_a_camera_that_cannot_be_opened_or_is_unplugged_is_an_error(scene):
    other = VirtualDavis346('V0000001')
    other.claim('another program')
    (finding,) = check_running(VIRTUAL, 0.1, backend=in_process_backend(other))
    assert (finding.name, finding.level) == ('opening the camera', Level.ERROR)
    findings = check_running(VIRTUAL, 30.0, backend=in_process_backend(scene.device))
    assert next(findings).name == 'identity'
    scene.device.unplug()
    (finding,) = findings
    assert (finding.name, finding.level) == ('data stream', Level.ERROR)
