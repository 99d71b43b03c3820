# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults, pressed starts and trials without a fault are judged by the live estimator."""

from __future__ import annotations

import functools
import json

import pytest

from mixtac_fger.weights import DEFAULT_MODEL, find_model
from mixtac_lab.experiments.studies import faults
from mixtac_lab.experiments.studies.stream_faults import SEEN
from mixtac_learning.trials.simulated import SimulatedSource
from mixtac_sim.world.training_trials import TrialSpec

PRESS = TrialSpec(7, 7, 'press', 4.0)


@pytest.fixture(scope='module', autouse=True)
def simulated_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedSource, 'load', functools.cache(SimulatedSource.load))
        yield


@pytest.fixture
def two_faults(monkeypatch):
    chosen = {name: SEEN[name] for name in ('no frames', 'all black')}
    monkeypatch.setattr(faults, 'SEEN', chosen)
    monkeypatch.setattr(faults, 'UNSEEN', {})


def test_faults_make_the_force_invalid(two_faults, tmp_path):
    other = TrialSpec(8, 8, 'press', 4.0)
    found = faults.judge_faults(tmp_path, find_model(DEFAULT_MODEL), PRESS, other)
    assert set(found) == {'no frames', 'all black'}
    row = faults.fault_row('all black', [found['all black']])
    assert 0.0 < row['seconds_to_invalid'] < 0.3
    assert row['undetected'] == 0
    assert row['reasons']
    assert found['no frames']['reasons'] == ['STALE']


def test_a_fault_that_one_sensor_misses_is_undetected():
    seen = {'seconds': 0.1, 'worst': 0.05, 'uncovered': 0.02, 'reasons': ['STALE']}
    row = faults.fault_row('any', [seen, seen | {'seconds': None, 'worst': 0.4, 'reasons': []}])
    assert row['seconds_to_invalid'] is None
    assert row['undetected'] == 1
    assert row['worst_error_valid_n'] == 0.4
    assert row['trials'] == 2


def test_a_trial_without_a_fault_is_valid(tmp_path):
    found = faults.judge_good(tmp_path, find_model(DEFAULT_MODEL), PRESS)
    assert found['windows'] > 1500
    assert found['invalid'] == 0
    assert not found['reasons']


@pytest.mark.parametrize('seed', [890_000, 890_003])
def test_a_vibration_is_no_fault(tmp_path, seed):
    spec = TrialSpec(seed, seed, 'vibration', 3.0, 'paper_like')
    found = faults.judge_good(tmp_path, find_model(DEFAULT_MODEL), spec)
    assert found['invalid'] <= 0.02 * found['windows']


def test_false_alarms_are_rates_over_all_trials():
    one = {'windows': 900_000, 'invalid': 0, 'rightly': 0, 'reasons': {}}
    two = {
        'windows': 900_000,
        'invalid': 30,
        'rightly': 10,
        'reasons': {'LIGHT_CHANGED': 10, 'CAMERA_MOVED': 20},
    }
    rates = faults.false_alarms([one, two])
    assert rates['hours_without_fault'] == pytest.approx(1.0)
    assert rates['false_invalid_per_hour'] == pytest.approx(20.0)
    assert rates['rightly_invalid_per_hour'] == pytest.approx(10.0)
    assert rates['false_invalid_minutes_in_ten_hours'] == pytest.approx(0.4 / 60)
    assert rates['invalid_trials'] == 1
    assert rates['invalid_reasons'] == {'LIGHT_CHANGED': 10, 'CAMERA_MOVED': 20}


def test_the_command_reports_faults_alarms_and_starts(two_faults, monkeypatch, tmp_path):
    fault = {'seconds': 0.1, 'worst': 0.2, 'uncovered': 0.0, 'reasons': {}}
    given = {
        'faults': dict.fromkeys(('no frames', 'all black'), fault),
        'start': {'starts': 1, 'trusted': 0},
        'good': {'windows': 1000, 'invalid': 1, 'rightly': 0, 'reasons': {'DARK': 1}},
    }

    class Computed:
        def __init__(self, _folder):
            pass

        def run_shown(self, _title, pieces, _console, _jobs):
            return [given[piece.label] for piece in pieces]

    monkeypatch.setattr(faults, 'Store', Computed)
    path = tmp_path / 'faults.json'
    faults.faults(quick=True, hours=0.01, out=tmp_path, jobs=1, json=path)
    report = json.loads(path.read_text())
    assert report['pressed'] == {'starts': 3, 'trusted': 0}
    assert report['invalid_reasons']['DARK'] == report['invalid_trials'] > 0
    assert [row['fault'] for row in report['rows']] == ['no frames', 'all black']


def test_nothing_is_trusted_or_tared_while_pressed(tmp_path):
    held = TrialSpec(7, 7, 'static', 4.0)
    counts = faults.judge_start(tmp_path, find_model(DEFAULT_MODEL), held)
    assert counts == {'starts': 1, 'forces_valid': 0, 'tares': 2, 'tares_accepted': 0}


def test_a_trial_without_a_hold_starts_nothing(tmp_path):
    counts = faults.judge_start(tmp_path, find_model(DEFAULT_MODEL), TrialSpec(7, 7, 'idle', 3.0))
    assert set(counts.values()) == {0}
