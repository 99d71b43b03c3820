# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Experiments from training to report, as small as they can be."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from mixtac_learning.experiments import models, vibration
from mixtac_learning.experiments.harness import PAPER_SIZES, command
from mixtac_learning.experiments.vibration import PRESSED, SIZES_MM, TAPPING

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
QUICK = PAPER_SIZES['quick']
TINY = replace(
    QUICK,
    trials=1,
    seconds=3.0,
    tests={'dynamic': (1, 3.0), 'static': (1, 3.0), 'long_term': (1, 3.0), 'impact': (1, 3.5)},
    paper_network=QUICK.paper_network | {'channels': 8, 'event_widths': (8, 8), 'lstm_size': 8},
    paper_training=QUICK.paper_training | {'frame_epochs': 1, 'cycles': 10},
    our_training={'frame_epochs': 1, 'recurrent_epochs': 1, 'joint_epochs': 1},
    tones_hz=(70.0,),
    fast_tones_hz=(),
)


def carried_out(folder):
    run, json_file = command('fusion', ''), folder / 'rows.json'
    outcomes = run(['vibration'], quick=True, json=json_file, out=folder, seeds=1, jobs=1)
    return {each.name: each for each in outcomes}


@pytest.fixture(scope='module')
def finished(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PAPER_SIZES, 'quick', TINY)
        patch.setitem(SIZES_MM, PRESSED, (0.1,))
        patch.setitem(SIZES_MM, TAPPING, (1.0,))
        patch.setattr(vibration, 'SHAKEN_S', (0.65, 1.15))
        folder = tmp_path_factory.mktemp('run')
        yield folder, carried_out(folder)


def test_report_says_what_was_measured_on_what(finished):
    folder, outcomes = finished
    page = (folder / 'report.md').read_text(encoding='utf-8')
    rows = json.loads((folder / 'rows.json').read_text(encoding='utf-8'))['rows']
    assert {row['experiment'] for row in rows} == {'fusion', 'vibration'}
    assert all(row['simulated'] for row in rows)
    assert all(row['ours']['count'] == 1 for row in rows)
    maes = [row for row in rows if row['name'].endswith(': MAE') and row['paper']]
    assert sorted(row['paper'] for row in maes) == [0.04, 0.04, 0.1]
    assert all(path.stat().st_size > 5000 for o in outcomes.values() for path in o.figures.values())
    assert 'paper_like' in page


def test_a_second_run_trains_nothing_again(finished, monkeypatch):
    folder, first = finished

    def refuse(*arguments):
        raise AssertionError(arguments)

    monkeypatch.setattr(models, 'train_model', refuse)
    monkeypatch.setattr(vibration, 'shake', refuse)
    again = carried_out(folder)
    assert again['fusion'].rows == first['fusion'].rows
