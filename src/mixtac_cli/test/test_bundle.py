# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The bundle of the doctor and `mixtac capture`: what they hold, and what they do not tell."""

from __future__ import annotations

import io
import json
import threading
import time
import zipfile

import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from mixtac_cli import doctor
from mixtac_cli.bundle import Bundle, hashed, usb_tree
from mixtac_driver.camera import CameraBatch
from mixtac_driver.clock import Origin
from mixtac_driver.doctor.computer import HostFiles
from mixtac_driver.usb.capture import SERIAL, Request, read_capture, string_descriptor
from mixtac_events.arrays import Events
from mixtac_events.readings import NO_EDGES, NO_SAMPLES, DecodedBatch
from mixtac_node.files import FileError
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.server import UsbServer

NUMBER = '84010042'


def batch(time_us):
    t = np.arange(time_us - 1000, time_us, 100)
    events = Events(t, np.full(10, 3, np.uint16), np.full(10, 4, np.uint16), t % 200 == 0)
    decoded = DecodedBatch(events, (), NO_SAMPLES, NO_EDGES, time_us, 0)
    return CameraBatch(decoded, Origin(0, 0), time_us * 1000 + 500_000)


def collected(**options):
    """Return a bundle of two seconds of a camera."""
    bundle = Bundle(**options)
    bundle.capture.describe(Silent(), NUMBER)
    bundle.capture.arrival(b'\1\0', 5)
    for k in range(1, 20):
        bundle.watch(batch(k * 100_000))
    return bundle


class Silent:
    """A device that has no descriptors."""

    def ctrl_transfer(self, *_):
        return b''


@pytest.fixture
def files(tmp_path):
    device = tmp_path / 'root/sys/bus/usb/devices/2-1'
    device.mkdir(parents=True)
    for name, text in (
        *(('idVendor', '152a'), ('idProduct', '841a'), ('speed', '5000')),
        *(('serial', NUMBER), ('product', 'DAVIS346')),
    ):
        (device / name).write_text(f'{text}\n')
    return HostFiles(tmp_path / 'root')


REPORT = {'findings': [{'name': 'identity', 'values': {'serial': NUMBER}, 'found': NUMBER}]}


def written(bundle, files, path):
    """Write a bundle; return its files by name."""
    bundle.write(
        path, bundle.members(REPORT, files, 'davis346'), Console(file=io.StringIO(), width=200)
    )
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_a_bundle_holds_what_it_lists(files, tmp_path):
    members = written(collected(), files, tmp_path / 'bundle.zip')
    listed = members.pop('README.txt').decode()
    assert all(f'{name}: ' in listed for name in members)
    events = np.load(io.BytesIO(members['events.npz']))
    # A second of the two that came.
    assert len(events['t']) == 100
    assert len(np.load(io.BytesIO(members['clock.npz']))['camera_us']) == 19
    assert json.loads(members['clock.json'])['pairs'] > 10
    assert 'mixtac_driver' in json.loads(members['versions.json'])['packages']
    assert b'ros__parameters' in members['parameters.yaml']
    assert read_capture(tmp_path / 'bundle.zip').arrivals[0].data == b'\1\0'


def test_serial_numbers_are_hashed_unless_kept(files, tmp_path):
    hidden = written(collected(), files, tmp_path / 'hidden.zip')
    wide = NUMBER.encode('utf-16-le')
    assert not any(NUMBER.encode() in content or wide in content for content in hidden.values())
    assert hashed(NUMBER) in hidden['usb.txt'].decode()
    assert hashed(NUMBER) in hidden['findings.json'].decode()
    kept = written(collected(keep_serials=True), files, tmp_path / 'kept.zip')
    assert NUMBER in kept['usb.txt'].decode()
    capture = read_capture(tmp_path / 'kept.zip')
    assert capture.descriptors()[SERIAL] == string_descriptor(NUMBER)


@pytest.mark.parametrize('home', ['/', '/home/somebody'])
def test_paths_are_whole_but_for_the_home_folder(files, tmp_path, monkeypatch, home):
    monkeypatch.setenv('HOME', home)
    monkeypatch.setitem(REPORT, 'device', '/home/somebody/camera.pcap')
    found = json.loads(written(collected(), files, tmp_path / 'bundle.zip')['findings.json'])
    expected = '/home/somebody' if home == '/' else '~'
    assert found['device'] == f'{expected}/camera.pcap'


def test_no_bundle_is_written_against_a_no(files, tmp_path, monkeypatch):
    monkeypatch.setattr('sys.stdin', Answering())
    monkeypatch.setattr(typer, 'confirm', no)
    with pytest.raises(typer.Abort):
        written(collected(), files, tmp_path / 'bundle.zip')
    assert not (tmp_path / 'bundle.zip').exists()


class Answering(io.StringIO):
    """Somebody at a terminal."""

    def isatty(self):
        return True


def no(*_, **__):
    raise typer.Abort


def test_a_machine_without_usb_says_so(tmp_path):
    assert 'no USB' in usb_tree(HostFiles(tmp_path), str)


@pytest.fixture
def camera(tmp_path):
    """The socket of a virtual camera that sends its time."""
    start, ending = time.monotonic_ns(), threading.Event()
    device = VirtualDavis346('V0000009', clock=lambda: (time.monotonic_ns() - start) // 1000)
    server = UsbServer(device, str(tmp_path / 'camera.sock'))

    def advance():
        while not ending.wait(0.005):
            device.advance((time.monotonic_ns() - start) // 1000)

    thread = threading.Thread(target=advance)
    thread.start()
    yield f'virtual:{server.path}'
    ending.set()
    thread.join()
    server.close()


def run(*arguments):
    app = typer.Typer()
    app.command()(doctor.capture)
    return CliRunner().invoke(app, [str(each) for each in arguments])


def test_capture_writes_a_file_that_can_be_replayed(camera, tmp_path):
    path, result = tmp_path / 'new.pcap', tmp_path / 'result.json'
    done = run(path, '--device', camera, '--seconds', '0.3', '--json', result)
    assert done.exit_code == 0, done.output
    capture, counts = read_capture(path), json.loads(result.read_text())
    assert len(capture.requests) == counts['requests'] > 100
    assert sum(len(arrival.data) for arrival in capture.arrivals) == counts['bytes'] > 0
    name = capture.descriptors()[SERIAL][2:].decode('utf-16-le')
    assert name == hashed('V0000009')
    assert isinstance(capture.requests[0], Request)


def test_bad_targets_of_a_capture_are_refused(camera, tmp_path):
    assert run(tmp_path / 'new.bin', '--device', camera).exit_code == 2
    assert isinstance(run('/proc/none/new.pcap', '--device', camera).exception, FileError)
    gone = run(tmp_path / 'new.pcap', '--device', f'virtual:{tmp_path}/none.sock')
    assert gone.exit_code == 1
    assert not (tmp_path / 'new.pcap').exists()
