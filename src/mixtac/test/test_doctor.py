# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac doctor`: what it prints, writes and returns."""

from __future__ import annotations

import json
import math
import os
import sys
import zipfile

import pytest
import typer
from typer.testing import CliRunner

from mixtac import doctor
from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_driver.doctor import Finding, Level, RawData, ok
from mixtac_driver.errors import UnknownDeviceError
from mixtac_driver.parameters import DriverParameters
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.server import UsbServer

TEXTS = ('findings.json', 'versions.json', 'registers.json', 'driver.yaml')
WARNING = Finding('disk', Level.WARN, '1 GB free', 'use another disk', {'free [GB]': math.nan})
ERROR = Finding('libusb', Level.ERROR, 'libusb is missing', 'install [it]')


def run_with(monkeypatch, tmp_path, *findings):
    """Run the command as if it had found this; return exit status, output and JSON."""
    sections = [('one', [ok('kernel', 'Linux', realtime=False)]), ('two', list(findings))]
    monkeypatch.setattr(doctor, 'examine', lambda *_, **__: iter(sections))
    app, path = typer.Typer(), tmp_path / 'new' / 'doctor.json'
    app.command()(doctor.doctor)
    result = CliRunner().invoke(app, ['--json', str(path)])
    return result.exit_code, result.output, json.loads(path.read_text())


@pytest.mark.parametrize(
    ('findings', 'exit_status', 'level', 'verdict'),
    [
        ([], 0, 'ok', 'no problems found'),
        ([WARNING], 0, 'warn', 'disk: use another disk'),
        ([WARNING, ERROR], 1, 'error', 'libusb: install [it]'),
    ],
)
def test_the_verdict_is_that_of_the_worst_finding(
    monkeypatch, tmp_path, findings, exit_status, level, verdict
):
    status, output, content = run_with(monkeypatch, tmp_path, *findings)
    assert (status, content['device'], content['level']) == (exit_status, 'davis346', level)
    assert output.splitlines()[-1] == content['verdict']
    assert content['verdict'].endswith(verdict)
    # JSON has no NaN.
    values = [each['values'] for each in content['findings']]
    assert values[:2] == [{'realtime': False}, {'free [GB]': None}][: len(values)]


def test_without_a_camera_the_virtual_one_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, 'check_model', lambda: ok('model', 'left out'))
    (tmp_path / 'sys/bus/usb/devices').mkdir(parents=True)
    sections = dict(doctor.examine(DriverParameters(), 1.0, root=tmp_path))
    assert list(sections) == ['software', 'camera', 'computer']
    findings = [each for found in sections.values() for each in found]
    errors = [f for f in findings if f.level is Level.ERROR and f.name != 'ROS 2']
    assert [f.name for f in errors] == ['camera on the USB']
    assert '--device virtual' in errors[0].remedy


def test_an_unknown_device_is_refused_before_anything():
    with pytest.raises(UnknownDeviceError) as caught:
        next(doctor.examine(DriverParameters(device='davis640'), 1.0))
    assert 'davis640' in str(caught.value)


def test_a_named_virtual_sensor_is_used_if_it_runs(tmp_path):
    path = str(tmp_path / 'camera.sock')
    for level in (Level.OK, Level.ERROR):
        server = UsbServer(VirtualDavis346('V0000007'), path) if level is Level.OK else None
        with doctor.virtual_camera(f'virtual:{path}') as (backend, finding):
            assert (backend is not None) == (level is Level.OK)
            assert finding.level is level
            assert bool(finding.remedy) == (level is Level.ERROR)
        if server is not None:
            server.close()


@pytest.mark.live
def test_a_sensor_of_its_own_is_measured(monkeypatch, tmp_path):
    # Where nobody serves a virtual sensor.
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path))
    monkeypatch.setattr(doctor, 'check_model', lambda: ok('model', 'left out'))
    raw = RawData()
    sections = dict(doctor.examine(DriverParameters(device='virtual'), 3.0, raw=raw))
    assert [found.level for found in sections['camera']] == [Level.OK]
    measured = sections['measured']
    names = [f.name for f in measured]
    assert names[:4] == ['identity', 'events', 'frames', 'inertial samples']
    found = {f.name: f.values for f in measured}
    # A busy computer may miss some.
    assert 0 < found['frames']['frames [1/s]'] < 28
    assert 0 < found['inertial samples']['inertial samples [1/s]'] < 1100
    doctor.write_bundle(tmp_path / 'bundle.zip', {}, DriverParameters(), raw)
    with zipfile.ZipFile(tmp_path / 'bundle.zip') as bundle:
        names = bundle.namelist()
        registers = json.loads(bundle.read('registers.json'))
        decoder = StreamDecoder(Geometry())
        batches = [*decoder.push(bundle.read('words.bin'))]
    assert names == [*TEXTS, 'words.bin']
    assert registers['6:0'] == 18
    assert sum(len(batch.frames) for batch in batches) > 0


def test_ros_is_named_or_its_absence(monkeypatch):
    pytest.importorskip('rclpy', reason='needs ROS 2')
    finding = doctor.check_ros(os.environ)
    assert finding.level is Level.OK
    assert str(finding.values['rmw']).startswith('rmw_')
    monkeypatch.setitem(sys.modules, 'rclpy.utilities', None)
    finding = doctor.check_ros(os.environ)
    assert finding.level is Level.WARN
    assert finding.remedy


def test_the_model_is_loaded(monkeypatch, tmp_path):
    assert doctor.check_model().level is Level.OK
    monkeypatch.setattr('mixtac_fger.weights.DEFAULT_MODEL', f'{tmp_path}/none.safetensors')
    finding = doctor.check_model()
    assert (finding.level, bool(finding.remedy)) == (Level.ERROR, True)
