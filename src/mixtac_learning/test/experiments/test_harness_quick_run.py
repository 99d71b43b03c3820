# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""All experiments with --quick, from training to report, on toy trials."""

from __future__ import annotations

import json

import pytest
from memory_groups import simulation_of

from mixtac_learning.experiments import EXPERIMENTS, model, models, slip, vibration
from mixtac_learning.experiments.harness import all_experiments
from mixtac_sim.world import plans

pytestmark = pytest.mark.timeout(600)
SLIPPED = dict.fromkeys(('slip_mm', 'detection_ms', 'arrest_ms', 'held', 'open_held'), 1.0) | {
    'course_mm': [0.0] * len(slip.COURSE_MS)
}
SHAKEN = {name: {'dominant_hz': 70.0, 'spectrum': [0.5] * 251} for name in vibration.SIGNALS}
"""Results of a trial and of a tone; test_slip.py and test_vibration.py simulate some."""


def carried_out(folder):
    return all_experiments(quick=True, json=folder / 'rows.json', out=folder, seeds=1, jobs=1)


@pytest.fixture(scope='module')
def finished(tmp_path_factory, trial):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vibration, 'shake', lambda *case: case)
        patch.setattr(vibration, 'spectra', lambda *_: SHAKEN)
        patch.setattr(slip, '_trial', lambda _plan: SLIPPED)
        patch.setattr(model, 'REPETITIONS', 1)
        toy = simulation_of(trial)
        patch.setattr(plans, 'simulate', lambda _spec: toy)
        folder = tmp_path_factory.mktemp('run')
        yield folder, carried_out(folder)


def test_report_says_what_was_measured_on_what(finished):
    folder, outcomes = finished
    names = [name for name in EXPERIMENTS if name not in {'all', 'models'}]
    content = json.loads((folder / 'rows.json').read_text(encoding='utf-8'))
    assert [each['name'] for each in content['experiments']] == list(outcomes) == names
    assert all('paper_like' in each['data'] for each in content['experiments'])
    rows = {name: [r for r in content['rows'] if r['experiment'] == name] for name in names}
    assert all(rows.values())
    assert {name for name in names if not rows[name][0]['simulated']} == {'model'}
    maes = [row for row in rows['fusion'] if row['name'].endswith(': MAE') and row['paper']]
    assert sorted(row['paper'] for row in maes) == [0.04, 0.04, 0.1]
    assert all(row['ours']['count'] == 1 for row in maes)
    pictures = [path for each in outcomes.values() for path in each.figures.values()]
    assert len(pictures) == 6
    assert all(path.stat().st_size > 5000 for path in pictures)
    page = (folder / 'report.md').read_text(encoding='utf-8')
    assert all(f'### {name}\n' in page for name in names)


def test_a_second_run_trains_nothing_again(finished, monkeypatch):
    folder, first = finished

    def refuse(*arguments):
        raise AssertionError(arguments)

    monkeypatch.setattr(models, 'train_model', refuse)
    monkeypatch.setattr(vibration, 'shake', refuse)
    again = carried_out(folder)
    for name in ('fusion', 'vibration'):
        assert again[name].rows == first[name].rows
