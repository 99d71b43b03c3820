# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark measures what it says, and its streams are sound."""

from __future__ import annotations

import json

import pytest

from mixtac_driver.benchmark.decode_benchmark import event_stream, frame_stream, main
from mixtac_driver.decoder import StreamDecoder
from mixtac_driver.identity import Geometry


@pytest.mark.parametrize('random', [False, True])
@pytest.mark.parametrize('events_per_row', [1, 2, 8])
def test_event_streams_are_sound(events_per_row, random):
    words = event_stream(events_per_row, 40_000, random=random)
    decoder = StreamDecoder(Geometry())
    events = sum(len(batch.events) for batch in decoder.push(words))
    counters = decoder.counters
    assert events == counters.events
    assert events == pytest.approx(40_000, rel=0.05)
    assert counters.events / counters.rows == pytest.approx(events_per_row, rel=0.05)
    assert counters.words == counters.events + counters.rows + counters.timestamps + counters.wraps
    assert 2 * counters.words / events == pytest.approx(2 + 2.2 / events_per_row, rel=0.05)


def test_frame_streams_are_sound():
    decoder = StreamDecoder(Geometry())
    assert sum(len(batch.frames) for batch in decoder.push(frame_stream(2))) == 2
    assert decoder.counters.frames_dropped == 0


def test_figures_are_printed_and_written(tmp_path, capsys):
    path = tmp_path / 'figures.json'
    assert main(['--events', '2000', '--json', str(path)]) == 0
    figures = json.loads(path.read_text())
    assert len(figures) == 10
    assert all(value > 0 for value in figures.values())
    printed = capsys.readouterr().out
    assert all(name in printed for name in figures)
