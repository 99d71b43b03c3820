# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Changes of the force: what a linear map finds in features, and a network in its events."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mixtac_lab.experiments.sizes import TABLE_SIZES
from mixtac_lab.experiments.studies.event_path import (
    LARGEST_N,
    WINDOWS,
    changes,
    dynamic_trials,
    held_errors,
    linear_r2,
    network_rows,
)
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.networks import build
from mixtac_learning.paper.samples import PaperSample


def toy(force, seed=0):
    """Return a trial of one event per window, whose place tells the change of the force."""
    change = np.diff(force, prepend=force[0])
    rng = np.random.default_rng(seed)
    points = np.stack([change * 50.0, *rng.random((3, len(force)))], 1)
    none = np.zeros((0, 1, 1), np.float16)
    return PaperSample(
        window_end_us=2000 * np.arange(1, len(force) + 1),
        points=points.astype(np.float16),
        starts=np.arange(len(force) + 1),
        frames=none,
        counts=np.zeros((0, 2, 1, 1), np.uint8),
        slots=np.full(len(force), -1),
        force=force.astype(np.float32),
        frame_force=np.zeros(0, np.float32),
        origin={},
    )


def forces(trials=3, windows=600):
    rng = np.random.default_rng(1)
    return [np.cumsum(rng.normal(0.0, 0.005, windows)).astype(np.float32) for _ in range(trials)]


def test_sums_of_features_meet_changes_of_force():
    force = np.array([0.0, 0.1, 0.3, 0.3, 2.0, 2.0], np.float32)
    sums, change = changes(np.diff(force, prepend=0.0)[:, None].astype(float), force, 2)
    assert np.all(np.abs(change) < LARGEST_N)
    assert sums[:, 0] == pytest.approx(change, abs=1e-6)


def test_a_linear_map_finds_what_features_tell_and_nothing_else():
    known = forces()
    telling = [np.diff(f, prepend=f[0])[:, None].astype(float) for f in known]
    rng = np.random.default_rng(2)
    noise = [rng.normal(size=(len(f), 3)) for f in known]
    for windows in (1, 10):
        assert linear_r2(telling, known, windows) > 0.95
        assert linear_r2(noise, known, windows) < 0.2


def test_a_network_is_judged_by_its_changes():
    samples = [toy(force) for force in forces()]
    network = build(PaperConfig(model='events', events_per_packet=1)).eval()
    with torch.no_grad():
        last = network.recurrence.increment.get_submodule('2')
        last.get_parameter('weight').zero_()
        last.get_parameter('bias').fill_(0.0)
    rows = network_rows(network, samples)
    assert [row['ms'] for row in rows] == [2.0 * n for n in WINDOWS[1:]]
    for row in rows:
        assert row['slope'] == pytest.approx(0.0, abs=1e-6)
        assert row['mae'] == pytest.approx(row['mae_of_none'], abs=1e-5)


def test_a_frame_that_is_held_is_as_wrong_as_the_force_moves():
    # One newton per hundred windows, a frame every 20 windows whose exposure is 5 windows old.
    force = np.arange(100) / 100.0
    slots = np.where(np.arange(100) % 20 == 0, np.arange(100) // 20, -1)
    sample = replace(toy(force), slots=slots, frame_force=(force[::20] - 0.05).astype(np.float32))
    held = held_errors([sample])
    assert held['arrival'] == pytest.approx(0.095, abs=1e-4)
    assert held['exposure'] == pytest.approx(0.145, abs=1e-4)


def test_trials_are_those_of_the_table(tmp_path):
    sources = dynamic_trials(TABLE_SIZES['quick'], tmp_path)
    assert sources
    assert {source.origin['profile'] for source in sources} == {'dynamic'}
    assert {source.origin['session'] for source in sources} == {sources[0].origin['session']}
