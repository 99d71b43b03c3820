# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The stream of the planner through an emulated arm controller, written independently of it.

`mixtac bench limits --trials 100000` plays as many sequences as the acceptance test needs.
"""

import json

import pytest
import typer

from mixtac_lab.bench import limits as limit_trials
from mixtac_lab.bench.limits import TrialTally, run_trials
from mixtac_slip_control.arm.planner import StreamSettings

COUNT = 400


def test_no_random_sequence_breaks_a_limit_of_the_fr3():
    tally = run_trials(COUNT, seed=1)
    assert tally.trials == COUNT
    assert tally.trajectories > 2 * COUNT
    assert tally.refused == tally.rejected == 0
    assert tally.violations == 0, tally
    # The stream uses what the arm has: a slow one would pass too.
    assert tally.acceleration > 0.9
    assert tally.jerk > 0.85


def test_trajectories_later_than_the_lead_break_limits(monkeypatch):
    monkeypatch.setattr(limit_trials, 'CYCLES_FOR_CONTROLLER', -5)
    assert run_trials(60, seed=1, releases=('jazzy',)).violations > 0


def test_without_an_overlap_humble_breaks_limits():
    settings = StreamSettings(overlap_s=0.0)
    assert run_trials(60, seed=1, releases=('humble',), settings=settings).violations > 0


def test_command_writes_the_tally(tmp_path):
    path = tmp_path / 'limits.json'
    limit_trials.limits(trials=3, seed=2, json=path)
    found = json.loads(path.read_text())
    assert (found['trials'], found['seed'], found['violations']) == (3, 2, 0)


def test_command_fails_where_a_limit_was_violated(monkeypatch):
    tally = TrialTally(trials=3, violations=1)
    monkeypatch.setattr(limit_trials, 'run_trials', lambda *_args, **_kwargs: tally)
    with pytest.raises(typer.Exit) as ended:
        limit_trials.limits(trials=3, seed=2)
    assert ended.value.exit_code == 1
