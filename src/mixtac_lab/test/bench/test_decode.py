# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark measures what it says, and its streams are sound."""

from __future__ import annotations

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from mixtac_driver.davis346.model import Geometry
from mixtac_driver.decode.decoder import StreamDecoder
from mixtac_lab.bench import decode as decode_benchmark
from mixtac_lab.bench.decode import event_stream, frame_stream, repeated


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


def test_repeated_streams_go_on_in_time():
    words = event_stream(2, 5000, random=True)
    decoder = StreamDecoder(Geometry())
    t = np.concatenate([b.events.t.copy() for b in decoder.push(repeated(words, 70_000))])
    assert np.all(np.diff(t) >= 0)
    counters = decoder.counters
    assert (counters.timestamps_backwards, counters.wraps) == (0, round(70_000 / words.nbytes))


def test_figures_are_printed_and_written(tmp_path, monkeypatch):
    monkeypatch.setattr(decode_benchmark, 'start_seconds', lambda: 0.5)
    app = typer.Typer()
    app.command()(decode_benchmark.decode)
    path = tmp_path / 'figures.json'
    options = ['--json', str(path), '--seconds', '0', '--megabytes', '1']
    result = CliRunner().invoke(app, options)
    assert result.exit_code == 0, result.output
    assert 'frames/s' in result.output
    figures = json.loads(path.read_text())
    for rows in (figures, figures['random_rows']):
        for name in ('events_per_s', 'memcpy_ratio', 'output_memcpy_ratio'):
            assert set(rows[name]) == {'1', '2', '8'}
            assert all(value > 0 for value in rows[name].values())
    assert figures['frames_per_s'] > 0
    assert figures['start_s'] == 0.5


def test_start_is_measured_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setattr(decode_benchmark, 'STARTS', 1)
    assert decode_benchmark.start_seconds() > 0
