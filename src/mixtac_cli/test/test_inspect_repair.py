# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac inspect` and `mixtac repair` on recordings that are damaged or odd."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_cli.main import main
from mixtac_events.arrays import Events
from mixtac_recordings.aedat4 import events_packet
from mixtac_recordings.aedat4_file import Aedat4File, Aedat4Writer
from mixtac_recordings.summary import summarise

if TYPE_CHECKING:
    from pathlib import Path

START_US = 1_700_000_000_000_000


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Write an AEDAT4 file of four packets, 250 events each, some of them outside."""
    path, rng = tmp_path / 'x.aedat4', np.random.default_rng(1)
    with contextlib.closing(Aedat4Writer(path, (100, 100), 'camera')) as writer:
        for start_us in range(START_US, START_US + 40_000, 10_000):
            t = start_us + np.sort(rng.integers(0, 10_000, 250))
            x, y = rng.integers(0, 110, (2, 250)).astype(np.uint16)
            data = events_packet(Events(t, x, y, np.ones(250, np.bool_)))
            writer.write('EVTS', data, 250, int(t[0]), int(t[-1]))
    return path


def damage(path: Path) -> int:
    """Damage the second packet; return where it begins."""
    with contextlib.closing(Aedat4File(path)) as file:
        at = int(file.index()[1]['offset'])
    data = bytearray(path.read_bytes())
    data[at : at + 4] = b'....'
    path.write_bytes(data)
    return at - 8


def test_events_outside_of_the_sensor_are_counted(recording: Path, capsys) -> None:
    assert main(['inspect', str(recording)]) == 0
    events = summarise(recording).events['events']
    assert events.outside > 0
    assert events.events + events.outside == 1000
    assert str(events.outside) in capsys.readouterr().out.split('warning')[1]


def test_a_damaged_packet_is_reported_and_a_repair_leaves_it_out(recording: Path, capsys) -> None:
    before = summarise(recording).events['events']
    at = damage(recording)
    assert main(['inspect', str(recording)]) == 1
    assert f' {at} ' in capsys.readouterr().err
    out = recording.with_name('out')
    assert main(['repair', str(recording), '--out', str(out)]) == 0
    assert f' {at} ' in ' '.join(capsys.readouterr().out.split())
    found = summarise(out / 'recording.aedat4')
    assert found.damage == ''
    assert 0 < found.events['events'].events < before.events
    assert main(['repair', str(recording), '--out', str(out)]) == 1


def test_a_repair_that_fails_leaves_nothing(recording: Path, capsys) -> None:
    recording.write_bytes(recording.read_bytes()[:200])
    assert main(['repair', str(recording), '--out', str(recording.with_name('out'))]) == 1
    assert list(recording.parent.iterdir()) == [recording]
    assert capsys.readouterr().err


def test_square_brackets_in_names_are_shown_as_they_are(recording: Path, tmp_path, capsys) -> None:
    odd = tmp_path / 'left[bold]' / 'a[' / 'b].aedat4'
    odd.parent.mkdir(parents=True)
    recording.rename(odd)
    out = tmp_path / '[' / 'new]'
    for line in (
        ['inspect', str(odd)],
        ['export', str(odd), '--to', 'csv', '--out', str(out / 'csv')],
        ['import', str(odd), '--out', str(out / 'bag')],
        ['repair', str(odd), '--out', str(out / 'whole')],
    ):
        assert main(line) == 0
        shown = capsys.readouterr().out.replace('\n', '')
        assert ('left[bold]/a[/b].aedat4' if line[0] == 'inspect' else '[/new]') in shown


def test_an_error_is_one_line_whatever_a_name_holds(tmp_path, capsys) -> None:
    assert main(['inspect', str(tmp_path / 'odd\n\x1b[2Jname')]) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert '\x1b' not in error
