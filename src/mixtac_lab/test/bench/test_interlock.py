# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random enablings, slips and faults; `mixtac bench interlock --runs 100000` plays more of them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from mixtac_lab.bench import interlock
from mixtac_lab.bench.interlock import run_enablings
from mixtac_slip_control.arm.following import FollowingWatch

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

COUNT = 60


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
