# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Trials on disk come back as they were; changed trials change what they say and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_core.node.files import FileError
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.samples import event_counts, packet_points
from mixtac_learning.trials.store import CachedSource
from mixtac_learning.trials.trial import (
    DEAD,
    LATE_US,
    MISMATCHES,
    ChangedSource,
    DatasetError,
    ForceLabel,
    TrialArrays,
)


@pytest.fixture
def arrays(trial) -> TrialArrays:
    return replace(trial, reference=None, origin={'name': 'toy', 'profile': 'press'})


class Source:
    """Counts how often it is loaded."""

    name, origin = 'toy', {'name': 'toy'}

    def __init__(self, trial: TrialArrays) -> None:
        self.trial, self.loads = trial, 0

    def content_key(self) -> str:
        return 'key'

    def load(self) -> TrialArrays:
        self.loads += 1
        return self.trial


def test_a_kept_trial_is_loaded_once_and_unchanged(arrays, tmp_path):
    source = Source(arrays)
    cached = CachedSource(source, tmp_path)
    cached.load()
    kept = cached.load()
    assert source.loads == 1
    assert np.array_equal(kept.frames, arrays.frames)
    for name in ('t', 'x', 'y', 'polarity'):
        assert np.array_equal(getattr(kept.events, name), getattr(arrays.events, name))
    assert np.array_equal(kept.truth.force, arrays.truth.force)
    assert kept.reference is None
    assert kept.origin == arrays.origin
    (folder,) = tmp_path.iterdir()
    (folder / 'trial.json').write_text('{')
    with pytest.raises(DatasetError):
        cached.load()


def test_a_trial_may_be_kept_twice_at_a_time(arrays, tmp_path):
    first = Source(arrays)

    class Second(Source):
        """Another process keeps the trial while this one loads it."""

        def load(self) -> TrialArrays:
            CachedSource(first, tmp_path).load()
            return super().load()

    kept = CachedSource(Second(arrays), tmp_path).load()
    assert np.array_equal(kept.frames, arrays.frames)
    assert len(list(tmp_path.iterdir())) == first.loads == 1


def test_a_trial_that_cannot_be_kept_is_named(arrays, tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(FileError):
        CachedSource(Source(arrays), tmp_path / 'file').load()


def test_labels_that_are_not_known_are_asked_for_in_vain(arrays):
    assert arrays.label() is arrays.truth
    measured = ForceLabel(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    assert replace(arrays, truth=None, reference=measured).label() is measured
    with pytest.raises(DatasetError):
        arrays.label('reference')
    with pytest.raises(DatasetError):
        arrays.label('guess')


@pytest.mark.parametrize('name', MISMATCHES)
def test_changes_leave_the_force_alone(arrays, name):
    changed = ChangedSource(Source(arrays), name, MISMATCHES[name]).load()
    assert changed.truth is arrays.truth
    assert changed.frames.shape == arrays.frames.shape
    assert changed.frames.dtype == arrays.frames.dtype
    frames_differ = not np.array_equal(changed.frames, arrays.frames)
    assert frames_differ == (name != 'exposure_3ms')
    assert (len(changed.events) < len(arrays.events)) == (name == 'dead_pixels')


def test_changes_are_as_large_as_they_say(arrays):
    late = MISMATCHES['exposure_3ms'](arrays)
    assert (late.exposure_end_us - arrays.exposure_end_us == LATE_US).all()
    holed = MISMATCHES['dead_pixels'](arrays)
    dead = (holed.frames == 0).all(0)
    assert dead.mean() == pytest.approx(DEAD, rel=0.1)
    assert not dead[holed.events.y, holed.events.x].any()
    # A blur takes away contrast and keeps the mean.
    blurred = MISMATCHES['blur'](arrays).frames[3].astype(float)
    sharp = arrays.frames[3].astype(float)
    assert blurred.mean() == pytest.approx(sharp.mean(), rel=0.01)
    assert np.abs(np.diff(blurred)).mean() < 0.8 * np.abs(np.diff(sharp)).mean()
    shaded = MISMATCHES['shading'](arrays).frames[3] / np.maximum(sharp, 1)
    assert (shaded[0, 0], shaded[-1, -1]) == pytest.approx((1.0, 0.6), abs=0.02)


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
