# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The comparison of clock maps by what is learned: its labels, and that it can be resumed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip('torch', reason='needs torch')

from mixtac_events.errors import MixtacError
from mixtac_lab.experiments.studies import alignment as learning_effect
from mixtac_lab.experiments.studies.alignment import LABELS, Map, Plan, clock_maps, measure
from mixtac_sim.world.trial import simulate_trial

if TYPE_CHECKING:
    from pathlib import Path

PLAN = Plan(trials=2, checks=1, seeds=1)


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Replace simulation and training; return the seeds of the trainings that are made."""
    seeds: list[int] = []

    def train(_learned: Any, _judged: Any, _plan: Plan, seed: int) -> dict[str, Any]:
        seeds.append(seed)
        return {'mae': 0.1 * len(seeds), 'rmse': 0.2, 'rmse_by_profile': {}}

    monkeypatch.setattr(learning_effect, '_samples', lambda _plan, _advance: ([], [], []))
    monkeypatch.setattr(
        learning_effect, 'clock_maps', lambda *_: {name: [Map(1.0, 0.0, 2.0)] for name in LABELS}
    )
    monkeypatch.setattr(learning_effect, '_relabelled', lambda *_: None)
    monkeypatch.setattr(learning_effect, 'zip', lambda *_, **__: [], raising=False)
    monkeypatch.setattr(learning_effect, '_train_and_judge', train)
    return seeds


def test_trainings_that_were_made_are_not_repeated(tmp_path: Path, trainings: list[int]) -> None:
    report = tmp_path / 'report.json'
    first = measure(PLAN, report, lambda: None)
    assert trainings == [0] * len(LABELS)
    again = measure(replace(PLAN, seeds=2), report, lambda: None)
    assert trainings == [0] * len(LABELS) + [1] * len(LABELS)
    for name in LABELS:
        assert again[name]['trainings']['0'] == first[name]['trainings']['0']
        assert set(again[name]['trainings']) == {'0', '1'}


def test_figures_of_another_plan_are_refused(tmp_path: Path, trainings: list[int]) -> None:
    report = tmp_path / 'report.json'
    measure(PLAN, report, lambda: None)
    made = len(trainings)
    with pytest.raises(MixtacError, match='another plan'):
        measure(replace(PLAN, epochs=31), report, lambda: None)
    assert len(trainings) == made


def test_maps_are_as_wrong_as_their_kind() -> None:
    trials = [simulate_trial(300_000, 300_202, 'impact', 10.0, sync=True)]
    maps = clock_maps(trials, 0)
    errors = {name: np.mean([one.error_ms for one in maps[name]]) for name in LABELS}
    # The truth goes through times of day in microseconds.
    assert errors['perfect'] < 1e-6
    assert errors['refined'] < 0.5
    assert errors['two_impulse'] < 1.5
    # Packets and the delay of the sensor err in opposite directions.
    assert 0.1 < errors['arrival'] < 15.0
    assert errors['raw'] > 50.0
