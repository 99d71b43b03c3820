# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A trial in stretches is the trial as a whole."""

from __future__ import annotations

import numpy as np

from mixtac_recordings.dataset import TrialSpec
from mixtac_sim.world.effects import preset
from mixtac_sim.world.trial import TrialStream, simulate_trial


def test_stretches_are_the_trial_as_a_whole():
    spec = TrialSpec('a', 'press', 3.0, 5, 6, 'paper_like', 'train')
    stretches = list(TrialStream(spec).stretches())
    whole = simulate_trial(5, 6, 'press', 3.0, sync=True, preset=preset('paper_like'))
    assert stretches[0].start_us == 0
    assert stretches[-1].end_us == 3_000_000
    for name in ('t', 'x', 'y', 'polarity'):
        parts = [getattr(each.sensor.events, name) for each in stretches]
        assert np.array_equal(np.concatenate(parts), getattr(whole.events, name))
    frames = [frame.intensity for each in stretches for frame in each.sensor.frames]
    assert np.array_equal(np.array(frames), whole.frames)
    assert np.array_equal(np.concatenate([e.sensor.truth for e in stretches]), whole.truth)
    wrench = np.concatenate([each.reference.wrench for each in stretches])
    assert np.array_equal(wrench, whole.reference_wrench)
    assert whole.events.x.max() <= 345
    assert whole.events.y.max() <= 259


def test_inertial_samples_come_every_millisecond():
    spec = TrialSpec('a', 'idle', 2.6, 5, 6, 'easy', 'train')
    times = [r.t_us for each in TrialStream(spec).stretches() for r in each.readings]
    assert times == list(range(0, 2_600_000, 1000))
