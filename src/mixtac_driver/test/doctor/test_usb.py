# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the doctor says of cameras that are plugged in, on made-up system files."""

from __future__ import annotations

import os

import pytest

from mixtac_driver.doctor import usb
from mixtac_driver.doctor.computer import (
    Finding,
    HostFiles,
    Level,
    first_to_do,
    ok,
    worst,
)
from mixtac_driver.doctor.usb import check_attached
from mixtac_driver.parameters import DriverParameters

NODE = 'dev/bus/usb/002/005'


def plug_in(root, port='2-1', **changes):
    """Write the files that the kernel shows for a camera."""
    files = {
        'idVendor': '152a',
        'idProduct': '841a',
        'bcdDevice': '0006',
        'busnum': '2',
        'devnum': '5',
        'speed': '5000',
        'serial': '00000123',
        'power/control': 'on',
        **changes,
    }
    folder = root / 'sys/bus/usb/devices' / port
    (folder / 'power').mkdir(parents=True)
    for name, text in files.items():
        if text is not None:
            (folder / name).write_text(f'{text}\n')
    node = root / 'dev/bus/usb' / f'{int(files["busnum"]):03d}' / f'{int(files["devnum"]):03d}'
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()
    return HostFiles(root)


def camera_of(files):
    (camera,) = usb.cameras_on_bus(files)
    return camera


def test_a_camera_is_read_from_the_kernels_files(tmp_path):
    camera = camera_of(plug_in(tmp_path))
    assert camera == usb.AttachedCamera('2-1', '/dev/bus/usb/002/005', 5000.0, 0x0006, '00000123')


def test_what_is_no_camera_is_passed_over(tmp_path):
    plug_in(tmp_path, 'usb1', idVendor='1d6b', idProduct='0003')
    plug_in(tmp_path, '2-1:1.0', idVendor=None)
    files = plug_in(tmp_path, '2-3')
    assert [camera.port for camera in usb.cameras_on_bus(files)] == ['2-3']


def test_no_usb_at_all_is_an_error_that_names_the_virtual_device(tmp_path):
    (finding,) = [f for f in check_attached(HostFiles(tmp_path)) if f.level is Level.ERROR]
    assert finding.name == 'camera on the USB'
    assert '--device virtual' in finding.remedy


def test_no_camera_is_an_error_that_names_the_virtual_device(tmp_path):
    (tmp_path / 'sys/bus/usb/devices').mkdir(parents=True)
    finding = first_to_do(check_attached(HostFiles(tmp_path)))
    assert finding is not None
    assert '152a:841a' in finding.found
    assert '--device virtual' in finding.remedy


def test_several_cameras_need_a_serial_number(tmp_path):
    plug_in(tmp_path, '2-1')
    files = plug_in(tmp_path, '2-2', serial='00000124', devnum='6')
    cameras = usb.cameras_on_bus(files)
    assert usb.check_presence(files, cameras, '').level is Level.ERROR
    assert usb.check_presence(files, cameras, '00000124').level is Level.OK
    missing = usb.check_presence(files, cameras, '9')
    assert (missing.level, '00000124 at 2-2' in missing.found) == (Level.ERROR, True)
    assert sum(f.name == 'USB speed' for f in check_attached(files, '00000124')) == 1


@pytest.mark.parametrize(
    ('speed', 'level'),
    [
        ('20000', Level.OK),
        ('10000', Level.OK),
        ('5000', Level.OK),
        ('480', Level.WARN),
        ('12', Level.ERROR),
        ('1.5', Level.ERROR),
        (None, Level.OK),
    ],
)
def test_speed(tmp_path, speed, level):
    finding = usb.check_speed(camera_of(plug_in(tmp_path, speed=speed)))
    assert finding.level is level
    assert ('USB 3 port' in finding.remedy) == (level > Level.OK)


@pytest.mark.parametrize(
    ('release', 'level'),
    [('0006', Level.OK), ('0009', Level.OK), ('0005', Level.ERROR), ('0100', Level.ERROR)],
)
def test_firmware(tmp_path, release, level):
    finding = usb.check_release(camera_of(plug_in(tmp_path, bcdDevice=release)))
    assert finding.level is level
    assert bool(finding.remedy) == (level > Level.OK)


class Forbidden(HostFiles):
    """Files of a user who may not open the camera; root may open everything."""

    def may_use(self, absolute):
        return False


def test_permission(tmp_path):
    files = plug_in(tmp_path)
    camera = camera_of(files)
    assert usb.check_permission(files, camera).level is Level.OK
    finding = usb.check_permission(Forbidden(tmp_path), camera)
    assert finding.level is Level.ERROR
    assert f'sudo cp {usb.rule_file()} /etc/udev/rules.d/' in finding.remedy
    assert 'udevadm control --reload' in finding.remedy


def test_permission_with_the_rule_installed_asks_for_the_group(tmp_path):
    camera = camera_of(plug_in(tmp_path))
    (tmp_path / 'etc/udev/rules.d').mkdir(parents=True)
    (tmp_path / 'etc/udev/rules.d/65-mixtac.rules').touch()
    finding = usb.check_permission(Forbidden(tmp_path), camera)
    assert finding.level is Level.ERROR
    assert 'usermod -aG plugdev' in finding.remedy


def test_permission_without_the_device_node(tmp_path):
    files = plug_in(tmp_path)
    (tmp_path / NODE).unlink()
    finding = usb.check_permission(files, camera_of(files))
    assert (finding.level, '--device=/dev/bus/usb' in finding.remedy) == (Level.ERROR, True)


def test_the_rule_that_is_named_exists_and_matches_the_camera():
    text = usb.rule_file().read_text()
    assert 'ATTRS{idVendor}=="152a"' in text
    assert 'ATTRS{idProduct}=="84[0-1]?"' in text


def test_another_program_that_has_the_camera_open(tmp_path):
    files = plug_in(tmp_path)
    camera = camera_of(files)
    descriptors = tmp_path / 'proc/4242/fd'
    descriptors.mkdir(parents=True)
    (tmp_path / 'proc/4242/comm').write_text('guvcview\n')
    (descriptors / '0').symlink_to('/dev/null')
    assert usb.check_holders(files, camera).level is Level.OK
    (descriptors / '3').symlink_to(camera.node)
    finding = usb.check_holders(files, camera)
    assert (finding.level, finding.values) == (Level.WARN, {'process': 4242})
    assert 'guvcview' in finding.found


def test_this_process_is_no_other_program(tmp_path):
    files = plug_in(tmp_path)
    descriptors = tmp_path / f'proc/{os.getpid()}/fd'
    descriptors.mkdir(parents=True)
    (descriptors / '3').symlink_to('/dev/bus/usb/002/005')
    assert usb.check_holders(files, camera_of(files)).level is Level.OK


@pytest.mark.parametrize(
    ('limit', 'level'),
    [(16, Level.OK), (0, Level.OK), (8, Level.OK), (7, Level.WARN), (3, Level.ERROR)],
)
def test_usb_memory(tmp_path, limit, level):
    path = tmp_path / 'sys/module/usbcore/parameters/usbfs_memory_mb'
    path.parent.mkdir(parents=True)
    path.write_text(f'{limit}\n')
    settings = DriverParameters(usb_transfers=64, usb_transfer_size=65536)  # 4 MiB
    finding = usb.check_usb_memory(HostFiles(tmp_path), settings)
    assert finding.level is level
    assert ('sudo tee' in finding.remedy) == (level > Level.OK)
    assert usb.check_usb_memory(HostFiles(tmp_path / 'none')).level is Level.OK


def test_without_libusb_the_remedy_names_the_package(monkeypatch):
    import libusb_package

    monkeypatch.setattr(libusb_package, 'get_libusb1_backend', lambda: None)
    finding = usb.check_libusb()
    assert (finding.level, 'libusb-1.0-0' in finding.remedy) == (Level.ERROR, True)


def test_what_to_do_first_is_the_first_of_the_worst():
    warning, error = Finding('b', Level.WARN, 'b'), Finding('c', Level.ERROR, 'c', 'mend c')
    findings = [ok('a', 'a'), warning, error, Finding('d', Level.ERROR, 'd')]
    assert first_to_do(findings) is error
    assert first_to_do(findings[:2]) is warning
    assert first_to_do(findings[:1]) is None
    assert worst([]) is Level.OK
