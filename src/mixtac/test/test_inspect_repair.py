# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac inspect` and `mixtac repair` on recordings that are damaged or odd."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac.main import main
from mixtac_core.recordings.importing import import_recording
from mixtac_core.recordings.summary import summarise

if TYPE_CHECKING:
    from pathlib import Path

COUNT = 1000


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Make a bag of events."""
    t = 100 * np.arange(COUNT)
    np.savez(tmp_path / 'x.npz', t=t, x=t % 346, y=t % 260, p=t % 2)
    import_recording(tmp_path / 'x.npz', tmp_path / 'bag')
    (tmp_path / 'x.npz').unlink()
    return tmp_path / 'bag'


def test_a_bag_that_was_cut_off_is_reported_and_repaired(recording: Path, capsys) -> None:
    assert main(['inspect', str(recording)]) == 0
    path = recording / 'bag.mcap'
    path.write_bytes(path.read_bytes()[:-100])
    capsys.readouterr()
    assert main(['inspect', str(recording)]) == 1
    assert 'bag.mcap' in capsys.readouterr().err
    out = recording.with_name('out')
    assert main(['repair', str(recording), '--out', str(out)]) == 0
    assert 'bag.mcap' in ' '.join(capsys.readouterr().out.split())
    (events,) = summarise(out).events.values()
    assert events.events == COUNT
    assert main(['repair', str(recording), '--out', str(out)]) == 1


def test_a_repair_that_fails_leaves_nothing(recording: Path, capsys) -> None:
    path = recording / 'bag.mcap'
    path.write_bytes(path.read_bytes()[:20])
    assert main(['repair', str(recording), '--out', str(recording.with_name('out'))]) == 1
    assert list(recording.parent.iterdir()) == [recording]
    assert capsys.readouterr().err


def test_square_brackets_in_names_are_shown_as_they_are(recording: Path, tmp_path, capsys) -> None:
    odd = tmp_path / 'left[bold]' / 'a[' / 'b]'
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
        assert ('left[bold]/a[/b]' if line[0] == 'inspect' else '[/new]') in shown


def test_an_error_is_one_line_whatever_a_name_holds(tmp_path, capsys) -> None:
    assert main(['inspect', str(tmp_path / 'odd\n\x1b[2Jname')]) == 1
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert '\x1b' not in error
