# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults change a trial from their begin on, and nothing before it."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_lab.experiments.studies.stream_faults import SEEN, UNSEEN, stream_of
from mixtac_learning.trials.trial import TrialArrays

BEGIN_US = 600_000
FRAMES = 24


def trial(seed: int) -> TrialArrays:
    random = np.random.default_rng(seed)
    start = np.arange(FRAMES, dtype=np.int64) * 40_000
    count = 2000
    events = Events(
        np.sort(random.integers(0, 950_000, count)),
        random.integers(0, 346, count).astype(np.uint16),
        random.integers(0, 260, count).astype(np.uint16),
        random.random(count) < 0.5,
    )
    frames = random.integers(100, 600, (FRAMES, 260, 346)).astype(np.uint16)
    return TrialArrays(events, frames, start, start + 6000, start + 15_000, None, None)


@pytest.fixture(scope='module')
def trials() -> tuple[TrialArrays, TrialArrays]:
    return trial(1), trial(2)


def test_there_are_enough_of_both_kinds():
    assert len({**SEEN, **UNSEEN}) == len(SEEN) + len(UNSEEN) >= 30
    assert len(UNSEEN) >= 10


@pytest.mark.parametrize('name', [*SEEN, *UNSEEN])
def test_a_fault_changes_what_comes_after_its_begin_alone(trials, name):
    one, other = trials
    before = stream_of(one, BEGIN_US, other)
    after = stream_of(one, BEGIN_US, other)
    {**SEEN, **UNSEEN}[name](after)
    early = before.mid_us < BEGIN_US
    changed = [
        new is None or not np.array_equal(old, new)
        for old, new in zip(before.frames, after.frames, strict=True)
    ]
    assert not np.array(changed)[early].any()
    kept = [stream.events[stream.events.t < BEGIN_US] for stream in (before, after)]
    assert all(
        np.array_equal(getattr(kept[0], field), getattr(kept[1], field))
        for field in ('t', 'x', 'y', 'polarity')
    )
    assert (np.diff(after.events.t) >= 0).all()
    same = len(after.events) == len(before.events) and all(
        np.array_equal(getattr(after.events, field), getattr(before.events, field))
        for field in ('t', 'x', 'y', 'polarity')
    )
    assert any(changed) or not same
    assert all(image is None or image.max() <= 1023 for image in after.frames)
