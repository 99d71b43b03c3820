# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live estimator on a stream without faults, its reference, and tare."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_core.events.arrays import Events
from mixtac_fger.contact_tracking import ContactSettings
from mixtac_fger.features import ImageError
from mixtac_fger.fger_net import SPREAD_WINDOWS, FgerEstimator
from mixtac_fger.reference import REST_FRAMES, TareError
from mixtac_fger.streaming import (
    BACKWARD_US,
    JUMP_US,
    LONG_HOLE_US,
    ForceEstimator,
    StreamTime,
)
from mixtac_fger.validity import Reason


def still_frames(estimator: ForceEstimator, trial, count: int = 5) -> None:
    for index in range(count):
        estimator.push_frame(trial.frames[0], index * 40_000 + 5000)


def noise_events(start_us: int, end_us: int, count: int, seed: int = 0) -> Events:
    random = np.random.default_rng(seed)
    return Events(
        np.sort(random.integers(start_us, end_us, count)),
        random.integers(0, 346, count).astype(np.uint16),
        random.integers(0, 260, count).astype(np.uint16),
        random.random(count) > 0.5,
    )


def test_windows_come_every_two_milliseconds_whatever_the_packets(model, trial):
    whole, split = (ForceEstimator(FgerEstimator(model)) for _ in range(2))
    for estimator in (whole, split):
        still_frames(estimator, trial)
    events = noise_events(200_000, 260_000, 3000)
    expected = whole.push_events(events, 260_000)
    parts = []
    for start in range(200_000, 260_000, 700):
        end = min(start + 700, 260_000)
        parts += split.push_events(events.between(start, end), end)
    assert [end for end, *_ in expected] == list(range(202_000, 260_001, 2000))
    assert parts == expected


def test_without_a_frame_there_is_no_output_and_a_reason(model, trial):
    estimator = ForceEstimator(FgerEstimator(model))
    assert estimator.push_events(noise_events(0, 10_000, 50), 10_000) == []
    assert 'reference: 0 of 5' in estimator.status().reason
    still_frames(estimator, trial, 4)
    assert estimator.push_events(Events.empty(), 20_000) == []
    assert 'reference: 4 of 5' in estimator.status().reason
    still_frames(estimator, trial, 1)
    assert len(estimator.push_events(Events.empty(), 30_000)) == 5
    assert estimator.status().reason == ''


def corrected(model, trial, windows: int) -> np.ndarray:
    """Return force and deviation of windows after a frame in contact has corrected them."""
    estimator = ForceEstimator(FgerEstimator(model))
    still_frames(estimator, trial)
    estimator.push_events(Events.empty(), 190_000)
    pressed = trial.frames[np.argmax(np.ptp(trial.frames - trial.frames[0], axis=(1, 2)))]
    estimator.push_frame(pressed, 189_000)
    found = estimator.push_events(Events.empty(), 190_000 + 2000 * windows)
    return np.array([(each.force, each.deviation) for each in found])


def test_a_correction_is_spread_over_the_next_windows(model, trial, monkeypatch):
    spread = corrected(model, trial, 2 * SPREAD_WINDOWS)
    monkeypatch.setattr('mixtac_fger.fger_net.SPREAD_WINDOWS', 1)
    at_once = corrected(model, trial, 2 * SPREAD_WINDOWS)
    pending = at_once[:, 0] - spread[:, 0]
    left = np.maximum(1.0 - np.arange(1, 2 * SPREAD_WINDOWS + 1) / SPREAD_WINDOWS, 0.0)
    assert abs(pending[0]) > 1e-4
    assert pending == pytest.approx(pending[0] / left[0] * left, abs=1e-6)
    assert (spread[:, 1] > np.abs(pending)).all()


def test_a_contact_is_followed_while_somebody_wants_it(model, trial):
    estimator = ForceEstimator(FgerEstimator(model), contact=ContactSettings())
    pressed = trial.frames[np.argmax(np.ptp(trial.frames - trial.frames[0], axis=(1, 2)))]
    found = {}
    end_us = 200_000
    still_frames(estimator, trial)
    estimator.push_events(Events.empty(), end_us)
    for wanted in (False, True, False):
        estimator.use_contact(ContactSettings() if wanted else None)
        estimator.push_frame(pressed, end_us - 1000)
        end_us += 20_000
        estimates = estimator.push_events(Events.empty(), end_us)
        found[wanted, end_us] = {each.contact is None for each in estimates}
        assert not wanted or estimator.contact.touch is not None
    assert list(found.values()) == [{True}, {False}, {True}]


@pytest.mark.parametrize('level', [0, 65535])
def test_black_and_saturated_frames_give_finite_forces(model, trial, level):
    estimator = ForceEstimator(FgerEstimator(model))
    still_frames(estimator, trial)
    estimator.push_frame(np.full((260, 346), level, np.uint16), 250_000)
    forces = estimator.push_events(noise_events(250_000, 300_000, 100_000), 300_000)
    assert len(forces) == 25
    assert np.isfinite([force for _, force, *_ in forces]).all()
    with pytest.raises(ImageError):
        estimator.push_frame(np.full((240, 346), level, np.uint16), 0)


def test_events_outside_the_sensor_are_ignored(model, trial):
    found, far = [], np.full(10, 60_000, np.uint16)
    for count in (10, 1):
        estimator = ForceEstimator(FgerEstimator(model))
        still_frames(estimator, trial)
        events = Events(np.arange(count), far[:count], far[:count], np.ones(count, bool))
        found.append(estimator.push_events(events, 4000))
    assert found[0] == found[1]


def test_tare_refuses_in_contact_and_zeroes_otherwise(model, trial):
    estimator = ForceEstimator(FgerEstimator(model), assume_free=True)
    with pytest.raises(TareError):
        estimator.tare()
    still_frames(estimator, trial)
    forces = estimator.push_events(noise_events(200_000, 240_000, 20_000), 240_000)
    estimator.contact_threshold_n = 0.02
    assert max(abs(force) for _, force, *_ in forces) > estimator.contact_threshold_n
    with pytest.raises(TareError) as caught:
        estimator.tare()
    assert caught.value.remedy
    estimator.contact_threshold_n = 1e6
    estimator.tare()
    seen = FgerEstimator(model)
    fresh = ForceEstimator(seen, assume_free=True)
    still_frames(fresh, trial)
    fresh.push_events(noise_events(200_000, 240_000, 100), 240_000)
    seen.clear()
    expected = fresh.push_events(Events.empty(), 242_000)
    assert estimator.push_events(Events.empty(), 242_000) == expected


def noisy_frames(estimator: ForceEstimator, image, start_us: int, count: int = 6) -> None:
    random = np.random.default_rng(start_us)
    for index in range(count):
        shown = np.clip(image + random.normal(0.0, 3.0, image.shape), 0, 1023).astype(np.uint16)
        middle = start_us + index * 40_000
        estimator.push_frame(shown, middle)
        events = noise_events(middle, middle + 40_000, 600, middle)
        estimator.push_events(events, middle + 40_000)


def states(trial) -> tuple[np.ndarray, np.ndarray]:
    """Return pictures of the toy sensor, free and pressed."""
    return trial.frames[0], trial.frames[
        int(np.argmax(np.interp(trial.exposure_start_us + 3000, trial.t_us, trial.force)))
    ]


def reasons(estimator: ForceEstimator, end_us: int) -> set[Reason]:
    return {each.reason for each in estimator.push_events(Events.empty(), end_us)}


@pytest.mark.parametrize(
    ('steps', 'accepted'),
    [
        ((1, 0), True),
        ((0, 1, 0), True),
        ((0, 1), False),
        ((1, 1), False),
    ],
    ids=['released', 'touched', 'pressed', 'always pressed'],
)
def test_tare_of_an_unknown_zero_asks_for_a_release(model, trial, steps, accepted):
    estimator = ForceEstimator(FgerEstimator(model), contact_threshold_n=1e6)
    for place, pressed in enumerate(steps):
        noisy_frames(estimator, states(trial)[pressed], place * 400_000, 10)
    if not accepted:
        with pytest.raises(TareError):
            estimator.tare()
        assert reasons(estimator, 1_460_000) == {Reason.ZERO_UNKNOWN}
        return
    estimator.tare()
    noisy_frames(estimator, states(trial)[0], 1_200_000)
    assert Reason.ZERO_UNKNOWN not in reasons(estimator, 1_460_000)


def test_the_zero_is_watched_and_tared_after_a_release(model, trial):
    free, pressed = states(trial)
    darker = (0.97 * free - 2.0).clip(0)
    watched, tared = (
        ForceEstimator(
            FgerEstimator(model), contact_threshold_n=1e6, assume_free=True, tare_on_release=on
        )
        for on in (False, True)
    )
    numbers = []
    for estimator in (watched, tared):
        noisy_frames(estimator, free, 0, 20)
        numbers.append(estimator.reference.number)
        noisy_frames(estimator, pressed, 800_000, 10)
        with pytest.raises(TareError):
            estimator.tare()
        noisy_frames(estimator, darker, 1_200_000, REST_FRAMES + 10)
    assert [each.reference.number for each in (watched, tared)] == [numbers[0], numbers[1] + 1]
    assert watched.status().zero_drift != 0.0
    noisy_frames(tared, darker, 4_000_000, 2 * REST_FRAMES)
    assert tared.reference.number == numbers[1] + 1


def test_another_camera_needs_a_zero_of_its_own(model, trial, tmp_path, monkeypatch):
    monkeypatch.setenv('MIXTAC_HOME', str(tmp_path))
    estimator = ForceEstimator(FgerEstimator(model), assume_free=True)
    noisy_frames(estimator, trial.frames[0], 0, 8)
    estimator.reference.save(tmp_path / 'kept.npz')
    assert Reason.OTHER_CAMERA not in reasons(estimator, 330_000)
    estimator.change_camera()
    noisy_frames(estimator, trial.frames[0], 400_000, 10)
    assert reasons(estimator, 810_000) == {Reason.OTHER_CAMERA}
    estimator.load_reference('none.npz')
    assert reasons(estimator, 812_000) == {Reason.OTHER_CAMERA}
    estimator.load_reference('kept.npz')
    noisy_frames(estimator, trial.frames[0], 840_000)
    assert Reason.OTHER_CAMERA not in reasons(estimator, 1_100_000)


@pytest.mark.parametrize(
    ('level', 'moves', 'still'), [(12, 0, True), (3, 0, True), (60, 0, True), (12, 4, False)]
)
def test_noise_alone_does_not_disturb_the_reference(model, trial, level, moves, still):
    estimator = ForceEstimator(FgerEstimator(model))
    random = np.random.default_rng(1)
    for index in range(6):
        image = np.roll(trial.frames[0], index * moves, axis=1)
        shown = np.clip(image + random.normal(0.0, 3.0 * level, image.shape), 1, 1023)
        estimator.push_frame(shown.astype(np.uint16), index * 40_000)
    assert (estimator.reference.array is not None) == still


def test_frames_in_the_background_give_the_same_forces(model, trial):
    direct = ForceEstimator(FgerEstimator(model))
    background = ForceEstimator(FgerEstimator(model), background_frames=True)
    try:
        for index in range(5):
            for estimator in (direct, background):
                estimator.push_frame(trial.frames[0], index * 40_000)
            background.drain()
        events = noise_events(200_000, 220_000, 500)
        assert background.push_events(events, 220_000) == direct.push_events(events, 220_000)
        assert background.status().frames == 1
    finally:
        background.close()


def test_frames_between_two_windows_give_the_same_forces_and_contacts(model, trial):
    at_windows, between = (
        ForceEstimator(FgerEstimator(model), contact=ContactSettings()) for _ in range(2)
    )
    events = noise_events(200_000, 260_000, 3000)
    for estimator in (at_windows, between):
        still_frames(estimator, trial)
    for start in range(200_000, 260_000, 2000):
        if start == 230_000:
            for estimator in (at_windows, between):
                estimator.push_frame(trial.frames[-1], 215_000)
        assert between.push_events(events.between(start, start + 1000), start + 1000) == []
        assert between.status().frames == 1 + (start >= 230_000)
        found = between.push_events(events.between(start + 1000, start + 2000), start + 2000)
        assert len(found) == 1
        assert found == at_windows.push_events(events.between(start, start + 2000), start + 2000)
    assert at_windows.status().frames == 2


def test_a_contact_that_cannot_be_found_costs_no_frame(model, trial, monkeypatch):
    def singular(*_args: object) -> None:
        raise np.linalg.LinAlgError

    monkeypatch.setattr('mixtac_fger.contact.TouchMeter.measure', singular)
    estimator = ForceEstimator(FgerEstimator(model), contact=ContactSettings())
    still_frames(estimator, trial)
    estimator.push_events(Events.empty(), 200_000)
    assert estimator.push_events(Events.empty(), 204_000)
    assert estimator.contact.touch is None


@pytest.mark.parametrize(
    ('step_us', 'lost', 'starts'),
    [
        (0, True, False),
        (LONG_HOLE_US, True, False),
        (LONG_HOLE_US + 1, True, True),
        (JUMP_US, False, False),
        (JUMP_US + 1, False, True),
        (-BACKWARD_US - 2000, False, True),
    ],
)
def test_a_packet_continues_a_stream_or_starts_one(step_us, lost, starts):
    time = StreamTime()
    assert time.push(5_000_000, 5_001_000, lost_before=False)
    first = 5_001_000 + step_us
    assert time.push(first, first + 1000, lost_before=lost) is starts
    assert time.newest_us == max(first + 1000, 5_001_000 if step_us >= 0 else 0)
    assert time.restarts == (step_us < -BACKWARD_US)


@given(st.integers(0, 20), st.integers(1, 20))
def test_a_window_is_covered_as_far_as_no_hole_is_in_it(before, hole):
    time = StreamTime()
    time.push(0, 10_000 + 1000 * before, lost_before=False)
    begin = 10_000 + 1000 * before
    end = begin + 1000 * hole
    time.push(end, end + 100_000, lost_before=True)
    for window_end in range(12_000, end + 50_000, 2000):
        missing = sum(begin <= t < end for t in range(window_end - 2000, window_end))
        assert time.covered(window_end, 2000) == (missing < 2000, missing == 0)
