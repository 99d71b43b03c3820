# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Losses take away what they say, and the live estimator comes back after them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mixtac_learning.judge import robustness as judged
from mixtac_learning.judge.estimators import stream
from mixtac_learning.judge.robustness import robustness
from mixtac_learning.trials.changes import Losses
from mixtac_learning.trials.trial import DatasetError

TIMES = np.arange(0, 4_000_000, 2000)


def test_random_losses_take_their_part_and_repeat():
    losses = Losses(frame_part=0.1, packet_part=0.3)
    assert losses.lost_frames(TIMES).mean() == pytest.approx(0.1, abs=0.03)
    assert losses.lost_packets(TIMES).mean() == pytest.approx(0.3, abs=0.03)
    assert np.array_equal(losses.lost_packets(TIMES), losses.lost_packets(TIMES))
    assert not Losses().lost_packets(TIMES).any()


def test_a_gap_takes_everything_within_it():
    losses = Losses(gaps_us=(1_000_000, 3_000_000))
    lost = TIMES[losses.lost_packets(TIMES)]
    wanted = [*range(1_002_000, 1_200_001, 2000), *range(3_002_000, 3_200_001, 2000)]
    assert lost.tolist() == wanted
    assert losses.lost_frames(np.array([1_000_000, 1_100_000, 1_201_000])).tolist() == [
        False,
        True,
        False,
    ]


@pytest.fixture
def source(trial):
    return SimpleNamespace(load=lambda: trial)


def test_windows_without_a_packet_have_no_force(model, trial):
    whole = stream(model, trial)
    losses = Losses(packet_part=0.05, seed=3)
    holed = stream(model, trial, losses=losses)
    assert set(holed.t_us) < set(whole.t_us)
    # The toy has no noise: what a lost packet leaves open ends with the next event only.
    assert 0.85 * len(whole.t_us) < len(holed.t_us) < 0.97 * len(whole.t_us)


def test_after_a_gap_the_force_comes_back_with_the_first_frame(model, source, monkeypatch):
    monkeypatch.setattr(judged, 'FIRST_GAP_US', 200_000)
    monkeypatch.setattr(judged, 'GAP_EVERY_US', 10_000_000)
    rows = robustness(model, [source])
    assert list(rows) == ['undisturbed', 'frames_missing_10', 'packets_missing_5', 'gap_200ms']
    gap = rows['gap_200ms']
    assert gap['gaps'] == 1
    assert gap['most_frames'] <= 1
    assert 0.0 < gap['silent_ms'] <= 100.0
    assert rows['undisturbed']['mae'] > 0.0
    assert rows['packets_missing_5']['given'] == pytest.approx(0.95, abs=0.03)


def test_nothing_to_judge_is_an_error(model):
    def load():
        raise DatasetError('damaged')

    with pytest.raises(DatasetError):
        robustness(model, [SimpleNamespace(load=load)])
