# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What `mixtac doctor --acceptance` prints, writes and asks; the checks are the driver's."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from mixtac_cli import acceptance, doctor
from mixtac_cli.bundle import hashed
from mixtac_driver.doctor.stretch import Check, Outcome, judged, skipped
from mixtac_sim.usb.device import VirtualDavis346
from mixtac_sim.usb.faults import FaultKind
from mixtac_sim.usb.server import UsbServer

CHECKS = [
    judged(1, 12.0, good=True, limit='100 ppm', found='12 ppm'),
    skipped(3, 'no signal'),
    judged(6, 2.5, good=False, limit='1 Hz', found='2.5 [Hz]'),
    judged(2, float('nan'), good=True, limit='', found='too few data'),
]


@pytest.fixture
def stubbed(monkeypatch, tmp_path):
    """The command, on a virtual camera of which each check is known."""
    server = UsbServer(VirtualDavis346('V0000003'), str(tmp_path / 'camera.sock'))

    def accept(_parameters, _seconds, _person, *, backend, identify, settle_s):
        assert backend is not None
        assert settle_s > 0
        identify({'serial': 'V0000003', 'chip': 'DAVIS346B', 'firmware': '0.6', 'logic': '18.1'})
        yield from CHECKS

    monkeypatch.setattr(acceptance, 'accept', accept)
    app = typer.Typer()
    app.command()(doctor.doctor)

    def run(*arguments):
        words = ['--acceptance', '--device', f'virtual:{server.path}', *arguments]
        return CliRunner().invoke(app, [str(word) for word in words])

    yield run
    server.close()


def test_the_report_has_every_check_and_the_row(stubbed, tmp_path):
    path = tmp_path / 'report.json'
    done = stubbed('--json', path)
    assert done.exit_code == 1
    report = json.loads(path.read_text())
    assert [check['number'] for check in report['checks']] == [1, 2, 3, 6]
    assert {c['number']: c['outcome'] for c in report['checks']} == {
        1: 'pass', 2: 'fail', 3: 'skip', 6: 'fail',
    }  # fmt: skip
    assert report['camera']['serial'] == hashed('V0000003')
    assert report['row'] in done.output
    assert report['row'].count('|') == acceptance.header().splitlines()[0].count('|')
    assert 'virtual' in report['row']


def test_a_good_camera_ends_with_0(stubbed, monkeypatch):
    monkeypatch.setattr(acceptance, 'failures', lambda _: 0)
    monkeypatch.setattr(doctor, 'failures', lambda _: 0)
    assert stubbed().exit_code == 0


def test_nobody_is_asked_where_nobody_can_answer():
    console = Console(file=io.StringIO())
    who = acceptance.person(console, flash=False, unplug=False, edges_hz=5.0)
    assert (who.flash, who.unplug, who.edges_hz) == (None, None, 5.0)
    announced = acceptance.person(console, flash=True, unplug=True, edges_hz=0.0)
    announced.flash(3.0)
    announced.unplug()
    assert console.file.getvalue().count('\n') == 2


def test_the_virtual_camera_does_everything_itself():
    faults = []

    class Backend:
        inject = staticmethod(faults.append)

    who = acceptance.automatic(Backend)
    who.flash(6.0)
    who.unplug()
    kinds = [fault.kind for fault in faults]
    assert kinds[0] is FaultKind.EDGES
    assert kinds[-1] is FaultKind.UNPLUG
    assert kinds.count(FaultKind.FLASH) == len(kinds) - 2
    ends = [fault.delay + fault.seconds for fault in faults[1:-1]]
    assert max(ends) < 6.0


def test_figures_without_a_number_are_none():
    assert CHECKS[3] == Check(2, Outcome.FAIL, 'too few data', None, '')


def test_the_page_of_reports_has_the_columns_of_a_row():
    page = Path(__file__).parents[3] / 'docs' / 'hardware_reports.md'
    assert acceptance.header() in page.read_text()
