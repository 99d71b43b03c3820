# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random enablings, slips and faults; `mixtac bench interlock --runs 100000` plays more of them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
import typer

from mixtac_lab.bench import interlock
from mixtac_lab.bench.interlock import InterlockTally, run_enablings
from mixtac_slip_control.arm.following import FollowingWatch

if TYPE_CHECKING:
    from pathlib import Path

COUNT = 40


def test_within_the_contract_no_limit_is_broken_and_a_fault_stops_for_good() -> None:
    tally = run_enablings(COUNT, seed=3)
    assert tally.runs == COUNT
    assert tally.violations == tally.false_stops == tally.rejected == tally.sent_after == 0, tally
    assert sum(tally.silent.values()) == 0, tally
    assert sum(tally.faults.values()) > 10
    # Enabling is asked for while the arm still moves, too.
    assert tally.refused > 10
    assert tally.trajectories > COUNT


def test_without_the_watch_of_the_arm_faults_are_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FollowingWatch, 'on_measured', lambda *_: None)
    monkeypatch.setattr(FollowingWatch, 'on_commanded', lambda *_: None)
    monkeypatch.setattr(interlock, 'FAULTS', ('displaced',))
    assert sum(run_enablings(12, seed=3).silent.values()) > 0


def test_command_writes_the_tally(tmp_path: Path) -> None:
    path = tmp_path / 'interlock.json'
    interlock.interlock(runs=2, seed=2, json=path)
    assert json.loads(path.read_text())['runs'] == 2


@pytest.mark.parametrize('bad', [{'violations': 1}, {'silent': {'late': 1}}, {'false_stops': 1}])
def test_command_fails_where_a_limit_was_broken_or_a_fault_was_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: dict[str, object]
) -> None:
    path = tmp_path / 'interlock.json'
    monkeypatch.setattr(interlock, 'run_enablings', lambda *_: InterlockTally(runs=1, **bad))
    with pytest.raises(typer.Exit) as ended:
        interlock.interlock(runs=1, seed=1, json=path)
    assert ended.value.exit_code == 1
    assert json.loads(path.read_text())['runs'] == 1
