# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the live estimator gives out when packets or frames are missing, or clocks jump."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_fger.config import ModelError
from mixtac_fger.estimator import EncodedFrame, Estimator
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.streaming import SATURATION_PER_US, UNFETCHED_FRAMES, ForceEstimator

if TYPE_CHECKING:
    from mixtac_fger.weights import Model

START_US = 200_000
FRAME_US = 40_000


class Scripted(Estimator):
    """An architecture whose force is the number of its windows.

    Attributes:
        scripted: Forces to return first.
    """

    width, height, window_us = 346, 260, 2000

    def __init__(self, *scripted: float) -> None:
        self.scripted = list(scripted)
        self.windows = 0

    def encode(self, image, mid_us: int) -> EncodedFrame:
        if not image.size:
            raise RuntimeError('a defect in the architecture')
        return EncodedFrame(mid_us, 0.5, 0, None)

    def correct(self, frame: EncodedFrame, lag: int) -> None:
        pass

    def start_at(self, frame: EncodedFrame) -> None:
        pass

    def step(self, events: Events, end_us: int) -> tuple[float, None]:
        self.windows += 1
        return (self.scripted.pop(0) if self.scripted else float(self.windows)), None

    def clear(self) -> None:
        self.windows = 0


def ready(model: Model, trial, **options) -> ForceEstimator:
    """Return an estimator that has its reference and a stream that has reached START_US."""
    estimator = ForceEstimator(FgerEstimator(model), **options)
    for index in range(5):
        estimator.push_frame(trial.frames[0], index * 35_000)
    estimator.push_events(Events.empty(), START_US)
    return estimator


def events(start_us: int, end_us: int, count: int = 20) -> Events:
    random = np.random.default_rng(start_us % 2**31)
    t = np.sort(random.integers(start_us, end_us, count))
    t[0] = start_us
    x, y = random.integers(0, 346, count), random.integers(0, 260, count)
    return Events(t, x.astype(np.uint16), y.astype(np.uint16), random.random(count) > 0.5)


def run(estimator: ForceEstimator, start_us: int, end_us: int, *, lost_before: bool = False):
    """Push packets of a millisecond and return what comes out."""
    found = []
    for begin in range(start_us, end_us, 1000):
        found += estimator.push_events(
            events(begin, begin + 1000),
            begin + 1000,
            lost_before=lost_before and begin == start_us,
        )
    return found


def ends(found) -> list[int]:
    return [estimate.end_us for estimate in found]


def test_windows_that_no_packet_covers_give_no_force(model, trial):
    estimator = ready(model, trial)
    before = run(estimator, START_US, START_US + 5000)
    after = run(estimator, START_US + 11_000, START_US + 20_000, lost_before=True)
    assert ends(before) == [202_000, 204_000]
    # 204 to 206 ms lacks its second half, 210 to 212 its first; what lies between is missing.
    assert ends(after) == [206_000, 212_000, 214_000, 216_000, 218_000, 220_000]
    assert [estimate.complete for estimate in after] == [False, False, True, True, True, True]
    assert estimator.status().withheld == 2
    # A silent stretch is no hole.
    silent = estimator.push_events(Events.empty(), START_US + 50_000)
    assert ends(silent) == list(range(222_000, 250_001, 2000))
    assert all(estimate.complete for estimate in silent)


def test_after_a_long_hole_the_next_frame_that_saw_its_end_brings_the_force_back(model, trial):
    estimator = ready(model, trial)
    assert run(estimator, START_US, START_US + 20_000)
    back = START_US + 220_000
    assert run(estimator, back, back + 10_000, lost_before=True) == []
    assert estimator.status().reason == 'waiting for a frame'
    estimator.push_frame(trial.frames[0], back - 5000)
    assert run(estimator, back + 10_000, back + 20_000) == []
    estimator.push_frame(trial.frames[0], back + 5000)
    assert ends(run(estimator, back + 20_000, back + 24_000)) == [back + 22_000, back + 24_000]


def test_the_force_after_a_long_hole_begins_at_the_frame_whatever_was_before(model, trial):
    back, after = START_US + 220_000, []
    for count in (20, 9000):
        estimator = ready(model, trial)
        estimator.push_events(events(START_US, START_US + 20_000, count), START_US + 20_000)
        run(estimator, back, back + 10_000, lost_before=True)
        estimator.push_frame(trial.frames[3], back + 5000)
        after.append(run(estimator, back + 10_000, back + 60_000))
    assert len(after[0]) == 25
    assert after[0] == after[1]
    largest_step = np.abs(np.diff([estimate.force for estimate in after[0]])).max()
    assert after[0][0].force == pytest.approx(estimator.frame_force, abs=2 * largest_step)


def test_a_clock_that_goes_back_starts_anew_with_the_next_frame(model, trial):
    estimator = ready(model, trial)
    assert run(estimator, START_US, START_US + 10_000)
    assert run(estimator, 5000, 10_000) == []
    status = estimator.status()
    assert (status.resets, status.reason) == (1, 'waiting for a frame')
    # A frame of the clock as it was.
    estimator.push_frame(trial.frames[0], START_US + 5000)
    assert run(estimator, 10_000, 14_000) == []
    assert estimator.status().frames_off_clock == 1
    estimator.push_frame(trial.frames[0], 9000)
    assert ends(run(estimator, 14_000, 18_000)) == [16_000, 18_000]


def test_without_frames_the_force_goes_on_for_a_stated_time(model, trial):
    estimator = ready(model, trial, longest_without_frame_us=300_000)
    found = run(estimator, START_US, 600_000)
    # The latest frame was exposed at 140 ms.
    assert ends(found) == list(range(202_000, 440_001, 2000))
    assert found[-1].frame_age_us == 300_000
    assert estimator.status().reason == 'no frame for 0.5 s, so no force is given'
    assert estimator.status().withheld == 80
    estimator.push_frame(trial.frames[0], 590_000)
    assert ends(run(estimator, 600_000, 604_000)) == [602_000, 604_000]
    assert estimator.status().reason == ''


def test_a_frame_that_comes_before_its_events_waits_for_them(model, trial):
    early, later = ready(model, trial), ready(model, trial)
    middle = START_US + 20_000
    early.push_frame(trial.frames[8], middle)
    first = [run(estimator, START_US, middle) for estimator in (early, later)]
    later.push_frame(trial.frames[8], middle)
    second = [run(estimator, middle, middle + 10_000) for estimator in (early, later)]
    assert first[0][:-1] == first[1][:-1]
    assert all(estimate.frame_age_us >= 0 for estimate in first[0] + second[0])
    assert early.status().frames == later.status().frames == 2


def test_frames_wait_for_events_that_a_busy_host_delays(model, trial):
    late, prompt = ready(model, trial), ready(model, trial)
    late.events_late_us = 1_000_000
    times = range(START_US + FRAME_US, START_US + 21 * FRAME_US, FRAME_US)
    for index, time_us in enumerate(times):
        late.push_frame(trial.frames[index], time_us)
    expected = run(prompt, START_US, times[0] - 2000)
    for index, time_us in enumerate(times):
        prompt.push_frame(trial.frames[index], time_us)
        expected += run(prompt, time_us - 2000, time_us + FRAME_US - 2000)
    assert run(late, START_US, times[-1] + FRAME_US - 2000) == expected
    assert late.status().frames == prompt.status().frames == 1 + len(times)


def test_a_frame_beyond_a_hole_brings_the_force_back_although_it_came_before(model, trial):
    estimator = ready(model, trial)
    estimator.events_late_us = 1_000_000
    for index in range(10):
        estimator.push_frame(trial.frames[0], START_US + index * FRAME_US)
    run(estimator, START_US, START_US + 50_000)
    found = run(estimator, START_US + 220_000, START_US + 250_000, lost_before=True)
    assert ends(found) == list(range(START_US + 240_000, START_US + 250_001, 2000))


def test_saturated_windows_are_marked_and_finite(model, trial):
    estimator = ready(model, trial)
    count = SATURATION_PER_US * 2000 + 1
    burst = estimator.push_events(events(START_US, START_US + 2000, count), START_US + 2000)
    calm = run(estimator, START_US + 2000, START_US + 4000)
    assert [estimate.saturated for estimate in burst + calm] == [True, False]
    assert np.isfinite([estimate.force for estimate in burst + calm]).all()
    assert estimator.status().saturated == 1


def test_frames_compared_with_the_reference_before_a_tare_are_left_out(model, trial):
    estimator = ready(model, trial, contact_threshold_n=1e6, assume_free=True)
    run(estimator, START_US, START_US + 4000)
    estimator.push_frame(trial.frames[5], START_US)
    estimator.push_frame(trial.frames[0], START_US + 1000)
    before = estimator.status()
    for _ in range(5):
        estimator.push_frame(trial.frames[0], 0)
    estimator.tare()
    run(estimator, START_US + 4000, START_US + 8000)
    # Seven frames have been compared with the old reference.
    assert estimator.status().frames == before.frames
    assert estimator.status().frames_dropped - before.frames_dropped == 7


def test_a_contact_at_the_start_is_felt_from_the_first_window_on(model, trial):
    # The increments of random weights are small beside the force of this frame.
    tensors = {**model.tensors, 'frame.press': 100.0 * model.tensors['frame.press']}
    opened = FgerEstimator(replace(model, tensors=tensors))
    opened.reference.use(ready(model, trial).reference.array)
    estimator = ForceEstimator(opened)
    pressed = trial.frames[np.argmax(np.ptp(trial.frames - trial.frames[0], axis=(1, 2)))]
    estimator.push_frame(pressed, START_US - 5000)
    estimator.push_events(Events.empty(), START_US)
    (found,) = estimator.push_events(Events.empty(), START_US + 2000)
    assert abs(estimator.frame_force) > 0.1
    assert found.force == pytest.approx(estimator.frame_force, rel=0.2)


def test_frames_that_nobody_fetches_do_not_pile_up():
    estimator = ForceEstimator(Scripted(), background_frames=True)
    try:
        image = np.zeros((260, 346), np.uint16)
        estimator.push_events(Events.empty(), 2000)
        for index in range(30):
            estimator.push_frame(image, index * 1000)
        estimator.drain()
        estimator.push_events(Events.empty(), 40_000)
        status = estimator.status()
        assert status.frames + status.frames_dropped == 30
        assert 1 <= status.frames <= UNFETCHED_FRAMES
    finally:
        estimator.close()


def test_a_defect_in_the_frame_thread_is_raised():
    estimator = ForceEstimator(Scripted(), background_frames=True)
    estimator.push_frame(np.zeros((0, 0), np.uint16), 0)
    with pytest.raises(ModelError):
        estimator.drain()
    estimator.close()


def test_numbers_that_are_not_finite_never_leave():
    estimator = ForceEstimator(Scripted(0.1, float('nan'), 0.2))
    image = np.zeros((260, 346), np.uint16)
    estimator.push_frame(image, 190_000)
    estimator.push_events(Events.empty(), 200_000)
    assert ends(estimator.push_events(Events.empty(), 210_000)) == [202_000]
    assert estimator.status().resets == 1
    estimator.push_frame(image, 209_000)
    forces = [each.force for each in estimator.push_events(Events.empty(), 220_000)]
    assert len(forces) == 5
    assert np.isfinite(forces).all()


def test_a_frame_that_comes_after_a_later_one_is_left_out(model, trial):
    estimator = ready(model, trial)
    run(estimator, START_US, START_US + 80_000)
    estimator.push_frame(trial.frames[1], START_US + 60_000)
    assert run(estimator, START_US + 80_000, START_US + 90_000)
    before = estimator.status()
    for late_us in (0, 2000, 40_000):
        estimator.push_frame(trial.frames[2], START_US + 60_000 - late_us)
        run(estimator, START_US + 90_000, START_US + 100_000)
    after = estimator.status()
    assert (after.frames, after.frames_dropped) == (before.frames, before.frames_dropped + 3)
