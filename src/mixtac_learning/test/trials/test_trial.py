# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Forces of trials by kind; event packets and event pictures of the paper's networks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.samples import event_counts, packet_points
from mixtac_learning.trials.trial import DatasetError, ForceLabel, TrialArrays


@pytest.fixture
def arrays(trial) -> TrialArrays:
    return replace(trial, reference=None, origin={'name': 'toy', 'profile': 'press'})


def test_labels_that_are_not_known_are_asked_for_in_vain(arrays):
    assert arrays.label() is arrays.truth
    measured = ForceLabel(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    assert replace(arrays, truth=None, reference=measured).label() is measured
    with pytest.raises(DatasetError):
        replace(arrays, truth=None).label()


def test_packets_are_thinned_evenly_and_normalised():
    t = np.concatenate([np.arange(0, 2000, 100), [2500, 6100]])
    zeros = np.zeros(22, np.uint16)
    events = Events(t, zeros + 345, zeros, np.arange(22) % 2 == 0)
    config = PaperConfig(events_per_packet=5)
    points, starts = packet_points(config, events, np.array([2000, 4000, 6000, 8000]))
    assert starts.tolist() == [0, 5, 6, 6, 7]
    assert points[:, 2] == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 0.25, 0.05], abs=1e-3)
    assert set(points[:, 0].tolist()) == {1.0}
    assert set(points[:, 1].tolist()) == {-1.0}
    assert points[:, 3].tolist() == [1, 1, 1, 1, 1, 1, -1]


def test_event_pictures_hold_every_event_inside():
    random = np.random.default_rng(4)
    t = np.sort(random.integers(0, 90_000, 3000))
    x = random.integers(0, 346, 3000).astype(np.uint16)
    y = random.integers(0, 260, 3000).astype(np.uint16)
    polarity = random.random(3000) > 0.3
    config = PaperConfig(scale=4)
    counts = event_counts(config, Events(t, x, y, polarity), np.array([0, 40_000, 80_000]))
    wanted = np.zeros((2, 2, 65, 86), int)
    for when, column, row, on in zip(t, x, y, polarity, strict=True):
        if when < 80_000 and column // 4 < 86:
            wanted[when // 40_000, 0 if on else 1, row // 4, column // 4] += 1
    assert np.array_equal(counts, wanted)
