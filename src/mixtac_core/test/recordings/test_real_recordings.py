# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings of real cameras that other software wrote; they are not part of the project.

The folder is `shared/data` beside the checkout, or named by MIXTAC_TEST_DATA.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np
import pytest

from mixtac_core.recordings.camera_stream import open_recording
from mixtac_core.recordings.export import export_recording
from mixtac_core.recordings.importing import import_recording
from mixtac_core.recordings.summary import summarise
from mixtac_core.recordings.tables import TableOptions

DATA = Path(os.environ.get('MIXTAC_TEST_DATA', Path(__file__).parents[5] / 'shared' / 'data'))


def data(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f'no recording {name} in {DATA}')
    return DATA / name


def pieces(path: Path):
    with contextlib.closing(open_recording(path)) as recording:
        return recording.info, list(recording.pieces())


def test_an_aedat4_file_whose_table_has_no_counts():
    pytest.importorskip('dv_processing', reason='pip install dv-processing')
    _, found = pieces(data('davis346_sample.aedat4'))
    assert sum(len(piece.events) for piece in found) == 6676
    assert sum(len(piece.frames) for piece in found) == 4
    assert sum(len(piece.imu.t) for piece in found) == 160


TRUTH = 'inputs/truth.npy'


@pytest.mark.parametrize(
    ('name', 'unit'),
    [
        ('v2e.txt', 's'),
        ('bool.csv', ''),
        ('structured.npz', ''),
        ('event_cnn.h5', 's'),
        ('esim.npz', 'ns'),
        ('dvs_msgs.bag', ''),
        ('davis346.aedat', ''),
    ],
)
def test_events_as_tools_of_others_write_them(tmp_path, name, unit):
    if name.endswith('.h5'):
        pytest.importorskip('h5py', reason='pip install h5py')
    path, truth = data(f'inputs/{name}'), np.load(data(TRUTH))
    import_recording(path, tmp_path / 'bag', options=TableOptions(unit))
    _, found = pieces(tmp_path / 'bag')
    for column, key in zip(truth, ('t', 'x', 'y', 'polarity'), strict=True):
        assert np.array_equal(np.concatenate([getattr(p.events, key) for p in found]), column)


def test_a_bag_with_an_empty_storage_identifier(tmp_path):
    # Figures of event_camera_py's own tests.
    summary = summarise(data('davis346_bag'))
    (events,) = summary.events.values()
    assert events.events == 571_266
    _, found = pieces(data('davis346_bag'))
    polarity = np.concatenate([piece.events.polarity for piece in found])
    assert (int(polarity.sum()), int((~polarity).sum())) == (211_043, 360_223)
    counts = export_recording(data('davis346_bag'), 'npz', tmp_path / 'out')
    assert counts.events == 571_266


def test_a_bag_of_another_camera_in_evt3():
    # Sums of event_camera_codecs' own test.
    info, found = pieces(data('evt3_bag'))
    assert not info.damage
    sums = [
        sum(int(getattr(piece.events, name).sum()) for piece in found)
        for name in ('t', 'x', 'y', 'polarity')
    ]
    assert sums == [1_222_326_831_810, 42_078_718, 31_656_267, 41_439]
    (events,) = summarise(data('evt3_bag')).events.values()
    assert (events.events, events.lost.packets_missing, events.backward_steps) == (82_469, 0, 0)


def test_a_rollover_of_the_camera_clock():
    _, found = pieces(data('libcaer_rollover_0.db3'))
    t = np.concatenate([piece.events.t for piece in found])
    assert 330_000 < len(t) < 340_000
    assert (np.diff(t) >= 0).all()
