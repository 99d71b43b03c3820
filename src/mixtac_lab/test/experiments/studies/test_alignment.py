# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The comparison of clock maps by what is learned: its maps, and that it continues."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip('torch', reason='needs torch')

from mixtac_lab.experiments.studies import alignment as study
from mixtac_lab.experiments.studies.alignment import LABELS, clock_maps
from mixtac_sim.world.trial import simulate_trial

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Replace simulation and training; return kind of clock and seed of each training."""
    made: list[tuple[str, int]] = []

    def train(_base: Path, label: str, seed: int, *_: object) -> dict[str, Any]:
        made.append((label, seed))
        figures = {'mae': 0.1 * len(made), 'rmse': 0.2, 'rmse_by_profile': {}}
        return {'time_error_ms': 2.0, **figures}

    monkeypatch.setattr(study, 'train_and_test', train)
    return made


def run(folder: Path, **options: Any) -> dict[str, Any]:
    settings = {'trials': 4, 'checks': 1, 'seconds': 12.0, 'epochs': 30, 'preset': 'easy'}
    path = folder / 'report.json'
    study.alignment(**settings | options, out=folder / 'run', json=path)
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_trainings_are_not_repeated(tmp_path: Path, trainings: list[tuple[str, int]]) -> None:
    first = run(tmp_path, seeds=1)
    assert trainings == [(name, 0) for name in LABELS]
    again = run(tmp_path, seeds=2)
    assert trainings == [(name, seed) for seed in (0, 1) for name in LABELS]
    assert again['plan']['seeds'] == 2
    for name in LABELS:
        figures = again['figures'][name]
        assert figures['time_error_ms'] == 2.0
        assert figures['trainings']['0'] == first['figures'][name]['trainings']['0']
        assert set(figures['trainings']) == {'0', '1'}


def test_other_options_are_other_trainings(
    tmp_path: Path, trainings: list[tuple[str, int]]
) -> None:
    run(tmp_path, seeds=1)
    run(tmp_path, seeds=1, epochs=31)
    assert len(trainings) == 2 * len(LABELS)


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
