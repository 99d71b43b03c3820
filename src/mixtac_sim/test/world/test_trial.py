# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A trial in stretches is the trial as a whole."""

from __future__ import annotations

import numpy as np

from mixtac_core.recordings.dataset import TrialSpec
from mixtac_sim.world.effects import preset
from mixtac_sim.world.plans import session_plan
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


def test_trials_of_a_session_share_the_day_and_nothing_else():
    level = preset('paper_like')
    trials = [simulate_trial(5, k, 'idle', 0.5, preset=level, session=9) for k in (1, 2)]
    alone = simulate_trial(5, 1, 'idle', 0.5, preset=level)
    # Exposure, mount and lamp are those of the day; pixels and clocks are noisy on their own.
    means = [float(each.frames.mean()) for each in (*trials, alone)]
    assert abs(means[0] - means[1]) < 0.1 * abs(means[0] - means[2])
    exposures = [each.exposure_end_us - each.exposure_start_us for each in (*trials, alone)]
    assert exposures[0][0] == exposures[1][0] != exposures[2][0]
    assert not np.array_equal(trials[0].frames, trials[1].frames)
    assert trials[0].clock != trials[1].clock


def test_a_session_is_split_by_trial_and_at_random():
    counts = {'dynamic': (10, 8.0), 'impact': (5, 4.5), 'static': (1, 25.0)}
    trained, tested = session_plan(counts, 3)
    assert [spec.profile for spec in tested] == ['dynamic', 'dynamic', 'impact', 'static']
    assert len(trained) == 8 + 4
    every = [*trained, *tested]
    assert len({spec.trial_seed for spec in every}) == len(every)
    assert len({(spec.device_seed, spec.session) for spec in every}) == 1
    assert {spec.seconds for spec in every if spec.profile == 'impact'} == {4.5}
    assert session_plan(counts, 3) == (trained, tested)
    others = {spec.trial_seed for seed in range(20) for spec in session_plan(counts, seed)[1]}
    assert len({seed % 1000 for seed in others}) > len(tested)
