# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the benchmark of the alignment counts, on a made-up recording."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_alignment.clock_fit import Anchor, ClockFit, fit_clock
from mixtac_alignment.histories import CellEvents, FrameFeatures
from mixtac_lab.bench.align import DAMAGES, DamageScores, Scores, TrialRecording, damage, summarise

RATE, OFFSET_S = 1.0 + 30e-6, 2.5


@pytest.fixture
def recording() -> TrialRecording:
    """Return 10 s of noise and two taps."""
    rng = np.random.default_rng(0)
    taps = [rng.normal(at, 0.005, 5000) for at in (1.0, 9.0)]
    events = np.sort(np.concatenate([rng.uniform(0.0, 10.0, 200_000), *taps]) * 1e6)
    start = np.arange(0, 9_900_000, 40_000)
    t = np.arange(0.01, 9.99, 1.0 / 800.0)
    force = sum(np.exp(-0.5 * ((t - at) / 0.006) ** 2) for at in (1.0, 9.0))
    return TrialRecording(
        events=CellEvents(
            events.astype(np.int64),
            rng.integers(0, 48, len(events)).astype(np.uint16),
            rng.random(len(events)) > 0.5,
        ),
        frames=FrameFeatures(start, start + 7000, np.zeros((len(start), 8), np.float32)),
        force_t_s=RATE * t + OFFSET_S,
        force=np.asarray(force),
        taps_s=(1.0, 9.0),
        rate=RATE,
        offset_s=OFFSET_S,
    )


def fit_with(error_s: float) -> ClockFit:
    """Return a map with a constant error and a stated standard deviation of 1 ms."""
    anchors = [Anchor(round(t * 1e6), RATE * t + OFFSET_S + error_s, 1e-6) for t in (1.0, 9.0)]
    return fit_clock(anchors, common_std_s=1e-3)


def test_errors_and_coverage_are_those_of_the_maps(recording: TrialRecording) -> None:
    scores = Scores()
    for error_s in (0.0, 1e-3, 3e-3, -1e-3):
        scores.add(fit_with(error_s), recording)
    summary = scores.summary()
    assert summary['p50'] == pytest.approx(1.0, abs=0.01)
    assert summary['coverage_95'] == pytest.approx(0.75)
    assert summary['trials'] == 4


@pytest.mark.parametrize('kind', DAMAGES)
def test_every_damage_changes_the_recording_and_leaves_its_truth(
    recording: TrialRecording, kind: str
) -> None:
    broken = damage(recording, kind, np.random.default_rng(5))
    same = np.array_equal(broken.events.t_us, recording.events.t_us)
    assert not (same and np.array_equal(broken.force, recording.force))
    assert (broken.rate, broken.offset_s) == (RATE, OFFSET_S)
    assert np.all(np.diff(broken.force_t_s) > 0.0)


def test_the_result_has_what_is_asked_of_it(recording: TrialRecording) -> None:
    faults = DamageScores()
    for number in range(len(DAMAGES)):
        faults.add(recording, number)
    scores = {name: Scores() for name in ('two_impulse', 'refined')}
    scores['refined'].add(fit_with(0.5e-3), recording)
    result = summarise(scores, {}, faults)
    assert result['refined_ms']['p95'] == pytest.approx(0.5, abs=0.01)
    assert result['coverage_95'] == pytest.approx(1.0)
    damaged = result['damaged']
    total = sum(sum(damaged[key].values()) for key in ('refused', 'right', 'wrong'))
    assert total == len(DAMAGES)
    assert result['silently_wrong'] == sum(damaged['wrong'].values())
