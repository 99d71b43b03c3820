# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac export`, `import`, `inspect` and `repair` as they are typed, also on damaged bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac.main import main
from mixtac_core.recordings.dataset import FILE_NAME, read_recordings
from mixtac_core.recordings.summary import summarise

COUNT = 300


@pytest.fixture
def events(tmp_path: Path) -> Path:
    """A table of events."""
    t = 1000 * np.arange(COUNT)
    np.savez(tmp_path / 'events.npz', t=t, x=t % 346, y=t % 260, p=np.arange(COUNT) % 2)
    return tmp_path / 'events.npz'


@pytest.fixture
def recording(events: Path) -> Path:
    """A bag of events."""
    out = events.with_name('bag')
    assert main(['import', str(events), '--out', str(out)]) == 0
    events.unlink()
    return out


def test_a_description_of_another_kind_is_refused_before_anything_is_written(
    events: Path, capsys: pytest.CaptureFixture[str]
):
    folder = events.parent
    (folder / FILE_NAME).write_text('schema: other\n')
    assert main(['import', str(events), '--out', str(folder / 'bag'), '--profile', 'static']) == 1
    assert FILE_NAME in capsys.readouterr().err
    assert not (folder / 'bag').exists()


def test_an_import_is_described_and_fitted(events: Path):
    folder = events.parent
    (folder / 'forces.csv').write_text('t,fz\n0,1\n0.1,2\n')
    options = ['--forces', str(folder / 'forces.csv'), '--same-clock', '--split', 'test']
    assert main(['import', str(events), '--out', str(folder / 'bag'), *options]) == 0
    (trial,) = read_recordings(folder / FILE_NAME)['trials']
    assert (trial['events'], trial['forces'], trial['split']) == (COUNT, 2, 'test')
    assert len(list(folder.glob('*.json'))) == 1


def test_a_stream_is_chosen_by_its_name(recording: Path, capsys: pytest.CaptureFixture[str]):
    folder = recording.parent
    words = ['export', str(recording), '--to', 'csv', '--out']
    assert main([*words, str(folder / 'a'), '--events', '/mixtac/events', '--imu', 'none']) == 0
    assert main([*words, str(folder / 'b'), '--events', '/other']) == 1
    assert '--events' in capsys.readouterr().err
    assert not (folder / 'b').exists()


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
