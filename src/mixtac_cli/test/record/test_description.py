# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""dataset.yaml beside recorded bags."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
import yaml

from mixtac_cli.record.summary import RecordingSummary, TopicFigures, add_recording
from mixtac_recordings.recording import RecordingError

if TYPE_CHECKING:
    from pathlib import Path

SUMMARY = RecordingSummary(
    2.0, 1, simulated=True, serial='V1', topics={'events': TopicFigures(2000, 999.9, 10, 3, 0)}
)


def test_each_recording_is_one_entry_and_the_same_name_replaces(tmp_path: Path):
    for name, split in (('a', 'train'), ('b', 'test'), ('a', 'test')):
        path = add_recording(tmp_path / name, SUMMARY, profile='static', split=split)
    document = yaml.safe_load(path.read_text())
    assert [(each['name'], each['split']) for each in document['trials']] == [
        ('b', 'test'),
        ('a', 'test'),
    ]
    first = document['trials'][0]
    assert (first['simulated'], first['not_written'], first['not_arrived']) == (True, 1, 3)
    assert first['topics']['events']['messages'] == 2000


@pytest.mark.parametrize('text', ['schema: mixtac-dataset', '[1', 'schema: mixtac-recordings'])
def test_another_file_of_that_name_is_left_alone(tmp_path: Path, text: str):
    path = tmp_path / 'dataset.yaml'
    path.write_text(text)
    with pytest.raises(RecordingError, match=r'dataset\.yaml'):
        add_recording(tmp_path / 'a', SUMMARY, profile='', split='')
    assert path.read_text() == text
