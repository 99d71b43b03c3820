# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac export` and `import` as they are typed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac.main import main
from mixtac_core.recordings.dataset import FILE_NAME, read_recordings

COUNT = 300


@pytest.fixture
def events(tmp_path: Path) -> Path:
    """A table of events."""
    t = 1000 * np.arange(COUNT)
    polarity = np.arange(COUNT) % 2
    np.savez(tmp_path / 'events.npz', t=t, x=t % 346, y=t % 260, p=polarity)
    return tmp_path / 'events.npz'


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


def test_a_stream_is_chosen_by_its_name(events: Path, capsys: pytest.CaptureFixture[str]):
    folder = events.parent
    assert main(['import', str(events), '--out', str(folder / 'bag')]) == 0
    words = ['export', str(folder / 'bag'), '--to', 'csv', '--out']
    assert main([*words, str(folder / 'a'), '--events', '/mixtac/events', '--imu', 'none']) == 0
    assert main([*words, str(folder / 'b'), '--events', '/other']) == 1
    assert '--events' in capsys.readouterr().err
    assert not (folder / 'b').exists()
