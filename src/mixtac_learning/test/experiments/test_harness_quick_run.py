# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Experiments from training to report, as small as they can be."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console

from mixtac_core.recordings.recording import RecordingError
from mixtac_learning.experiments import harness, store, vibration
from mixtac_learning.experiments.harness import QUICK, run_experiments, select
from mixtac_learning.experiments.vibration import PRESSED, SIZES_MM, TAPPING

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
TINY = replace(
    QUICK,
    trials=1,
    seconds=3.0,
    tests={'dynamic': (1, 3.0), 'static': (1, 3.0), 'long_term': (1, 3.0), 'impact': (1, 3.5)},
    paper_network=QUICK.paper_network | {'channels': 8, 'event_widths': (8, 8), 'lstm_size': 8},
    paper_training=QUICK.paper_training | {'frame_epochs': 1, 'cycles': 10},
    our_training={
        'frame_epochs': 1,
        'recurrent_epochs': 1,
        'joint_epochs': 1,
        'deviation_epochs': 1,
    },
    tones_hz=(70.0,),
    fast_tones_hz=(),
)


def carried_out(folder, *names, **options):
    console = Console(file=io.StringIO(), width=120)
    settings = {'quick': True, 'json': folder / 'rows.json', 'out': folder, 'seeds': 1, 'jobs': 1}
    outcomes = run_experiments(console, select(names), **settings | options)
    return {each.name: each for each in outcomes}, console.file.getvalue()


@pytest.fixture(scope='module')
def finished(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(harness, 'QUICK', TINY)
        patch.setitem(SIZES_MM, PRESSED, (0.1,))
        patch.setitem(SIZES_MM, TAPPING, (1.0,))
        patch.setattr(vibration, 'SHAKEN_S', (0.65, 1.15))
        folder = tmp_path_factory.mktemp('run')
        outcomes, text = carried_out(folder, 'fusion', 'vibration')
        yield folder, outcomes, text


def test_report_says_what_was_measured_on_what(finished):
    folder, outcomes, text = finished
    page = (folder / 'report.md').read_text(encoding='utf-8')
    rows = json.loads((folder / 'rows.json').read_text(encoding='utf-8'))['rows']
    assert {row['experiment'] for row in rows} == {'fusion', 'vibration'}
    assert all(row['simulated'] for row in rows)
    assert all(row['ours']['count'] == 1 for row in rows)
    maes = [row for row in rows if row['name'].endswith(': MAE') and row['paper']]
    assert sorted(row['paper'] for row in maes) == [0.04, 0.04, 0.1]
    assert all(path.stat().st_size > 5000 for o in outcomes.values() for path in o.figures.values())
    assert 'paper_like' in page
    assert 'feature-level fusion' in text


def test_flow_finds_the_tone_and_the_pressed_count_its_double(finished):
    rows = {row.name: row.ours.mean for row in finished[1]['vibration'].rows}
    assert rows['pressed, 100 um, flow, 1 ms bins, 70 to 70 Hz: share of tones'] == 1.0
    assert rows['pressed, 100 um, number of events, 2 ms bins, 70 to 70 Hz: share of tones'] == 0.0


def test_a_second_run_computes_nothing(finished, monkeypatch):
    folder, first, _ = finished

    def refuse(_folder, _index, piece):
        raise AssertionError(piece)

    monkeypatch.setattr(store, '_compute', refuse)
    again, _ = carried_out(folder, 'fusion', 'vibration')
    assert again['fusion'].rows == first['fusion'].rows


def test_what_the_bags_do_not_hold_is_named_and_the_rest_goes_on(tmp_path):
    names = 'vibration', 'impact', 'slip'
    outcomes, text = carried_out(tmp_path, *names, bags=tmp_path)
    assert str(tmp_path / 'impact') in outcomes['impact'].skipped
    # A closed loop and tones are only simulated.
    assert all(outcomes[name].skipped and not outcomes[name].rows for name in names)
    assert all(outcome.title in text for outcome in outcomes.values())
    with pytest.raises(RecordingError) as refused:
        carried_out(tmp_path, 'impact', bags=tmp_path)
    assert refused.value.remedy
