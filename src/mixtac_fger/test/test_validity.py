# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""When a force counts as valid: pictures, frames against events, silence, and their order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from toy_sensor import EXPOSURE_US, INTERVAL_US, SOUND

from mixtac_events.arrays import Events
from mixtac_fger.comparisons import STRONG_CHANGE, add_signs, agreement, marks
from mixtac_fger.config import FgerConfig
from mixtac_fger.estimator import EncodedFrame
from mixtac_fger.features import FramePreparation
from mixtac_fger.pictures import picture_findings
from mixtac_fger.reasons import Reason
from mixtac_fger.recent_events import packed
from mixtac_fger.validity import FRAMES_KNOWN, HOLD_FRAMES, Validity

WINDOW_US = 2000
WIDTH = 346


def noisy(image: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, 3.0, image.shape)
    return np.clip(image + noise, 0, 1023).astype(np.uint16)


@pytest.fixture(scope='module')
def preparation() -> FramePreparation:
    return FramePreparation(FgerConfig())


@pytest.fixture(scope='module')
def encoded(preparation, trial):
    """Return a function from an image to its frame, compared with the first one."""
    reference = preparation.contrast(trial.frames[0]).coarse

    def encode(image: np.ndarray, mid_us: int = 0) -> EncodedFrame:
        contrast = preparation.contrast(image)
        preparation.network_input(contrast, reference)
        picture = preparation.picture(contrast, reference)
        return EncodedFrame(mid_us, 0.0, 1, None, contrast.coarse, picture)

    return encode


def show(validity: Validity, frame: EncodedFrame, force=0.0, estimate=0.0) -> None:
    validity.frame(frame.mid_us, frame.contrast, frame.picture, force, estimate)


def test_no_contact_is_a_finding(encoded, trial):
    for index, image in enumerate(trial.frames):
        assert picture_findings(encoded(noisy(image, index)).picture) == set()


@pytest.mark.parametrize(
    ('change', 'expected'),
    [
        (lambda image: np.roll(image, 2, 1), Reason.CAMERA_MOVED),
        (lambda image: np.roll(image, -3, 0), Reason.CAMERA_MOVED),
        (lambda image: image * np.linspace(0.3, 1.0, WIDTH), Reason.LIGHT_CHANGED),
        (lambda image: image * (np.arange(WIDTH) > 173), Reason.LIGHT_CHANGED),
        (lambda image: image[:, ::-1], Reason.PICTURE_UNLIKE_REFERENCE),
        (lambda image: image[::-1], Reason.PICTURE_UNLIKE_REFERENCE),
        (lambda image: 1023 - np.minimum(image, 1023), Reason.PICTURE_UNLIKE_REFERENCE),
        (lambda image: gaussian_filter(image.astype(float), 8), Reason.PICTURE_UNLIKE_REFERENCE),
        (lambda image: np.full_like(image, 1023), Reason.PICTURE_UNLIKE_REFERENCE),
    ],
)
def test_what_no_contact_does_to_a_picture_is_found(encoded, trial, change, expected):
    image = np.ascontiguousarray(change(trial.frames[4])).astype(np.uint16)
    assert expected in picture_findings(encoded(image).picture)


@given(
    places=st.lists(st.tuples(st.integers(0, 70), st.integers(0, 50), st.booleans()), max_size=60),
    size=st.integers(1, 8),
)
@settings(max_examples=30)
def test_signs_are_a_histogram(places, size):
    x, y, on = (np.array([place[k] for place in places], int) for k in range(3))
    out, total = np.ones((2, 40 // size, 60 // size), np.float32)
    events = Events(np.zeros_like(x), x.astype(np.uint16), y.astype(np.uint16), on.astype(bool))
    brighter, net = add_signs(packed(events), size, out, total)
    edges = [np.arange(n + 1) * size for n in out.shape]
    inside = (x < out.shape[1] * size) & (y < out.shape[0] * size)
    expected, *_ = np.histogram2d(y[inside], x[inside], bins=edges, weights=2.0 * on[inside] - 1.0)
    np.testing.assert_allclose(out, expected / size**2, atol=1e-5)
    np.testing.assert_allclose(total, 1.0 + expected / size**2, atol=1e-5)
    assert brighter == on.sum()
    assert net == pytest.approx(np.abs(expected).sum(), abs=1e-3)


def test_agreement_is_a_correlation():
    random = np.random.default_rng(2)
    before, after, signs = random.normal(0.0, 0.3, (3, 20, 30)).astype(np.float32)
    signs += 2.0 * (after - before)
    change, told, correlation, strong, slope = agreement(before, after, signs)
    # Events count up to two per pixel.
    limited = np.clip(signs, -2.0, 2.0)
    assert change == pytest.approx((after - before).std(), rel=1e-4)
    assert told == pytest.approx(limited.std(), rel=1e-4)
    expected = np.corrcoef((after - before).ravel(), limited.ravel())[0, 1]
    assert correlation == pytest.approx(expected, abs=1e-4)
    chosen = np.abs(after - before) > STRONG_CHANGE
    assert strong == chosen.sum()
    line = np.linalg.lstsq((after - before)[chosen][:, None], limited[chosen], rcond=None)[0]
    assert slope == pytest.approx(line[0], rel=1e-4)
    assert agreement(before, before, signs)[2:] == (0.0, 0, 0.0)


def noise(start_us: int, end_us: int, count: int | None = None, usual: float = 60.0) -> Events:
    random = np.random.default_rng(start_us)
    count = random.poisson(usual) if count is None else count
    return Events(
        np.sort(random.integers(start_us, end_us, count)),
        random.integers(0, 346, count).astype(np.uint16),
        random.integers(0, 260, count).astype(np.uint16),
        random.random(count) > 0.4,
    )


def together(*parts: Events) -> Events:
    events = Events.concatenate(parts)
    return events[np.argsort(events.t, kind='stable')]


def follow(
    trial, encoded, events: Events, frames, *, until_us: int = 1_150_000, alone: bool = False
) -> list[Reason]:
    """Return what is said of each window of a trial, with noise at its pixels or alone."""
    validity = Validity(WINDOW_US, WIDTH)
    reasons, frame = [], 0
    middle = trial.exposure_start_us + EXPOSURE_US // 2
    for end in range(WINDOW_US, until_us, WINDOW_US):
        while frame < len(frames) and trial.arrival_us[frame] <= end:
            show(validity, encoded(frames[frame], int(middle[frame])))
            frame += 1
        part = events.between(end - WINDOW_US, end)
        if not alone:
            part = together(part, noise(end - 2000, end))
        validity.window(end, part, complete=True)
        reasons.append(validity.reason)
    return reasons


@pytest.fixture(scope='module')
def frames(trial) -> list[np.ndarray]:
    return [noisy(image, index) for index, image in enumerate(trial.frames)]


def test_a_trial_without_a_fault_is_trusted(trial, encoded, frames):
    assert set(follow(trial, encoded, trial.events, frames)) == {Reason.TRUSTED}


def test_what_a_strong_pull_moves_is_neither_light_nor_the_camera(encoded, trial):
    picture = encoded(trial.frames[0]).picture
    still, moved = (picture._replace(shading=0.19, shift=0.09, displacement=d) for d in (0.0, 1.2))
    assert picture_findings(still) == {Reason.LIGHT_CHANGED, Reason.CAMERA_MOVED}
    assert picture_findings(moved) == set()
    assert Reason.LIGHT_CHANGED in picture_findings(moved._replace(shading=0.3))


def told_by_events(before: np.ndarray, after: np.ndarray, start_us: int, seed: int) -> Events:
    """Return the events of a change of log contrast with a threshold of 0.4, in 40 ms."""
    random = np.random.default_rng(seed)
    number = np.round(16 * (after - before) / 0.4).astype(int)
    row, column = (
        np.repeat(each.ravel(), abs(number).ravel()) for each in np.indices(number.shape)
    )
    count = len(row)
    order = np.argsort(t := random.integers(start_us, start_us + INTERVAL_US, count))
    return Events(
        t[order],
        (4 * column + random.integers(0, 4, count)).astype(np.uint16)[order],
        (4 * row + random.integers(0, 4, count)).astype(np.uint16)[order],
        (np.repeat(number.ravel(), abs(number).ravel()) > 0)[order],
    )


@pytest.mark.parametrize(
    ('change', 'expected'),
    [
        (lambda events: events, Reason.TRUSTED),
        (lambda events: events[:0], Reason.EVENTS_DISAGREE),
        (
            lambda events: replace(events, x=(WIDTH - 1 - events.x).astype(np.uint16)),
            Reason.EVENTS_DISAGREE,
        ),
        (lambda events: replace(events, polarity=~events.polarity), Reason.EVENTS_DISAGREE),
        (
            lambda events: replace(events, y=np.random.default_rng(1).permutation(events.y)),
            Reason.EVENTS_DISAGREE,
        ),
    ],
    ids=['as they are', 'none', 'mirrored', 'inverted', 'shuffled'],
)
def test_events_have_to_tell_of_the_motion(change, expected):
    pattern = np.random.default_rng(3).normal(0.0, 0.5, (65, 86))
    phases = [0, 0, 0.3, 0.6, 0.9, 0.6, 0.3, 0.0, 0.3]
    reasons = moving(Validity(WINDOW_US, WIDTH), pattern, phases, change)
    assert set(reasons) == {Reason.TRUSTED, expected}


def moving(validity: Validity, pattern, phases, change=lambda events: events, begin_us=1_000_000):
    """Let a picture change by parts of a pattern; return what is said after each frame."""
    random = np.random.default_rng(begin_us)
    reasons, before = [], pattern * phases[0]
    for index, phase in enumerate(phases):
        start = begin_us + index * INTERVAL_US
        after = pattern * phase
        told = change(told_by_events(before, after, start, index))
        for end in range(start + WINDOW_US, start + INTERVAL_US + 1, WINDOW_US):
            parts = [told.between(end - WINDOW_US, end), noise(end - 2000, end)]
            validity.window(end, together(*parts), complete=True)
        picture = (after + random.normal(0.0, 0.01, after.shape)).astype(np.float32)
        validity.frame(start + INTERVAL_US, picture, None, 0.0, 0.0)
        reasons.append(validity.reason)
        before = after
    return reasons


@pytest.mark.parametrize('inverted', [False, True])
def test_a_slow_motion_of_a_few_bins_tells_in_the_end(inverted):
    pattern = np.zeros((65, 86))
    pattern[30, 40:46] = 1.0
    phases = [*np.zeros(3), *np.linspace(0.0, 0.9, 36)]

    def change(events: Events) -> Events:
        return replace(events, polarity=events.polarity != inverted)

    reasons = moving(Validity(WINDOW_US, WIDTH), pattern, phases, change)
    assert reasons[-1] is (Reason.EVENTS_DISAGREE if inverted else Reason.TRUSTED)
    assert reasons[10] is Reason.TRUSTED


def test_what_disagreed_is_not_trusted_until_it_agrees():
    random, validity = np.random.default_rng(1), Validity(WINDOW_US, WIDTH)
    pattern = random.normal(0.0, 0.5, (65, 86))

    def shuffled(events: Events) -> Events:
        return replace(events, y=random.permutation(events.y))

    wrong = [0, 0, 0.3, 0.6, 0.9, 0.6, 0.3, 0.6]
    still = [0.6] * 3 * HOLD_FRAMES
    moving(validity, pattern, wrong, shuffled, begin_us=0)
    rested = moving(validity, pattern, still, begin_us=len(wrong) * INTERVAL_US)
    assert set(rested) == {Reason.EVENTS_DISAGREE}
    begin_us = (len(wrong) + len(still)) * INTERVAL_US
    moved = moving(validity, pattern, [0.6, 0.9, *[0.9] * 2 * HOLD_FRAMES], begin_us=begin_us)
    assert moved[-1] is Reason.TRUSTED


PRESSED = SOUND._replace(shading=0.1, still_shading=0.02, displacement=1.0, outward=0.5)


def test_tiles_that_do_not_move_keep_their_light_however_far_others_move():
    assert not picture_findings(PRESSED)
    assert picture_findings(PRESSED._replace(still_shading=0.05)) == {Reason.LIGHT_CHANGED}


def test_a_contact_does_not_make_good_what_was_wrong_before_it():
    validity, said = Validity(WINDOW_US, WIDTH), []
    for picture in (PRESSED, SOUND._replace(shading=0.05), PRESSED, SOUND, PRESSED):
        for _ in range(2 * HOLD_FRAMES):
            validity.frame(0, None, picture, 0.0, None)
        said.append(validity.reason)
    wrong = [Reason.LIGHT_CHANGED] * 2
    assert said == [Reason.TRUSTED, *wrong, Reason.TRUSTED, Reason.TRUSTED]


def test_the_same_frame_again_is_frozen_until_frames_differ(trial, encoded, frames):
    held = [*frames[:8], frames[7], frames[7], *frames[10:]]
    reasons = follow(trial, encoded, trial.events, held)
    wrong = [index for index, reason in enumerate(reasons) if reason is Reason.FRAME_FROZEN]
    first, last = trial.arrival_us[8] // WINDOW_US, trial.arrival_us[9 + HOLD_FRAMES] // WINDOW_US
    assert wrong[0] == pytest.approx(first, abs=1)
    assert wrong[-1] == pytest.approx(last, abs=2)


def rest(
    validity: Validity, frames: int, start_us: int, *, events: bool = True, usual: float = 60.0
) -> list[Reason]:
    """Let noise pass for some frames; return what is said after each."""
    random, reasons = np.random.default_rng(start_us), []
    for begin in range(start_us, start_us + frames * INTERVAL_US, INTERVAL_US):
        for end in range(begin + WINDOW_US, begin + INTERVAL_US + 1, WINDOW_US):
            told = noise(end - WINDOW_US, end, usual=usual) if events else Events.empty()
            validity.window(end, told, complete=True)
        picture = random.normal(0.0, 0.01, (65, 86)).astype(np.float32)
        validity.frame(begin + INTERVAL_US, picture, None, 0.0, 0.0)
        reasons.append(validity.reason)
    return reasons


@pytest.mark.parametrize('usual', [60.0, 400.0, 1200.0], ids=['little', 'dense', 'denser'])
def test_a_sensor_whose_events_stopped_is_not_trusted_until_they_return(usual):
    validity = Validity(WINDOW_US, WIDTH)
    assert set(rest(validity, 50, 0, usual=usual)) == {Reason.TRUSTED}
    silent = rest(validity, 1500, 50 * INTERVAL_US, events=False)
    assert set(silent[1:]) == {Reason.EVENTS_MISSING}
    back = rest(validity, 50, 1550 * INTERVAL_US, usual=usual)
    assert set(back[2 * HOLD_FRAMES :]) == {Reason.TRUSTED}


@pytest.mark.parametrize('sign', [0, 1])
@pytest.mark.parametrize('kept', [0.45, 0.85])
def test_events_of_a_polarity_that_become_fewer_are_missing(sign, kept):
    validity = Validity(WINDOW_US, WIDTH)
    assert set(rest(validity, 50, 0, usual=120.0)) == {Reason.TRUSTED}
    random = np.random.default_rng(1)
    for end in range(50 * INTERVAL_US + WINDOW_US, 60 * INTERVAL_US, WINDOW_US):
        events = noise(end - WINDOW_US, end, usual=120.0)
        left = (events.polarity != sign) | (random.random(len(events)) < kept)
        validity.window(end, events[left], complete=True)
    assert validity.reason is (Reason.EVENTS_MISSING if kept < 0.5 else Reason.TRUSTED)


def test_polarities_at_random_differ_from_those_at_rest():
    validity = Validity(WINDOW_US, WIDTH)
    assert set(rest(validity, 50, 0)) == {Reason.TRUSTED}
    random, wrong = np.random.default_rng(1), []
    for begin in range(50 * INTERVAL_US, 100 * INTERVAL_US, INTERVAL_US):
        for end in range(begin + WINDOW_US, begin + INTERVAL_US + 1, WINDOW_US):
            events = noise(end - WINDOW_US, end)
            if begin < 80 * INTERVAL_US:
                events = replace(events, polarity=random.random(len(events)) < 0.48)
            validity.window(end, events, complete=True)
        picture = random.normal(0.0, 0.01, (65, 86)).astype(np.float32)
        validity.frame(begin + INTERVAL_US, picture, None, 0.0, 0.0)
        wrong.append(validity.reason is Reason.EVENTS_DISAGREE)
    # It does not become what is usual while it is wrong, and is trusted again when it is right.
    assert all(wrong[6:30])
    assert not any(wrong[30 + 2 * HOLD_FRAMES :])


def test_the_noise_is_known_after_some_seconds_of_rest():
    validity = Validity(WINDOW_US, WIDTH)
    rest(validity, 25, 0)
    assert not validity.noise_known
    rest(validity, 35, 25 * INTERVAL_US)
    assert validity.noise_known
    validity.clear()
    assert validity.noise_known
    validity.forget()
    assert not validity.noise_known


def test_a_hole_in_the_stream_heals_nothing():
    random, validity = np.random.default_rng(0), Validity(WINDOW_US, WIDTH)
    picture = random.normal(0.0, 0.1, (65, 86)).astype(np.float32)
    for k in range(20):
        validity.frame(INTERVAL_US * (k + 1), picture, None, 0.0, None)
        validity.skip()
        assert validity.reason is (Reason.FRAME_FROZEN if k else Reason.TRUSTED)
    validity.clear()
    assert validity.reason is Reason.TRUSTED


@pytest.mark.parametrize('length', [1, 7])
def test_frames_that_come_again_and_again_stay_frozen(length):
    random, validity = np.random.default_rng(0), Validity(WINDOW_US, WIDTH)
    pictures = random.normal(0.0, 0.1, (length, 65, 86)).astype(np.float32)
    reasons = []
    for k in range(4 * FRAMES_KNOWN):
        validity.frame(INTERVAL_US * (k + 1), pictures[k % length], None, 0.0, None)
        reasons.append(validity.reason)
    assert set(reasons[:length]) == {Reason.TRUSTED}
    assert set(reasons[length:]) == {Reason.FRAME_FROZEN}


def test_frames_in_a_loop_are_known_again(trial, encoded, frames):
    looped = [
        frames[index] if index < 10 else frames[4 + index % 6] for index in range(len(frames))
    ]
    reasons = follow(trial, encoded, Events.empty(), looped)
    first = int(trial.arrival_us[10]) // WINDOW_US
    assert reasons[first + 1] is Reason.FRAME_FROZEN
    assert set(reasons[: first - 1]) == {Reason.TRUSTED}


def marks_of(events: Events, most: int = 10_000) -> list[int]:
    room = np.empty(most, np.uint64)
    found, *_ = marks(packed(events), room)
    return room[:found].tolist()


@given(first=st.integers(0, 2000), shift=st.integers(-500_000, 10**12))
@settings(max_examples=30)
def test_events_are_known_again_wherever_and_whenever_they_are_cut(first, shift):
    events = noise(0, 200_000, 4000)
    whole, part = marks_of(events), marks_of(events[first : first + 1500].shifted(shift))
    assert 60 < len(whole) < 250
    assert set(part) <= set(whole)
    assert len(part) > 10


@pytest.mark.parametrize(
    'change',
    [
        lambda events: replace(events, x=(events.x + 1).astype(np.uint16)),
        lambda events: replace(events, polarity=~events.polarity),
        lambda events: replace(events, t=np.sort(events.t + noise(1, 40_001, 4000).t % 200)),
        lambda _: noise(7, 200_007, 4000),
    ],
    ids=['pixels', 'polarity', 'intervals', 'other noise'],
)
def test_other_events_are_not_known(change):
    events = noise(0, 200_000, 4000)
    assert len(set(marks_of(events)) & set(marks_of(change(events)))) <= 1


def test_events_are_counted_beside_their_marks():
    events = noise(0, 200_000, 4000)
    _, brighter, twice, times, pause = marks(packed(events), np.empty(4, np.uint64))
    assert (brighter, twice) == (np.count_nonzero(events.polarity), 0)
    assert times == len(np.unique(events.t))
    assert pause == np.diff(events.t).max()
    assert marks(packed(events[np.repeat(np.arange(4000), 3)]), np.empty(0, np.uint64))[2] == 8000
    assert marks(packed(events[:0]), np.empty(4, np.uint64)) == (0, 0, 0, 0, 0)


def test_a_pause_is_measured_where_the_kept_bits_of_the_time_begin_anew():
    events = noise(2**31 - 10_000, 2**31 + 10_000, 1000)
    *_, pause = marks(packed(events), np.empty(4, np.uint64))
    assert pause == np.diff(events.t).max()


def test_there_are_no_more_marks_than_room_for_them():
    events = noise(0, 200_000, 4000)
    assert marks_of(events, 5) == marks_of(events)[:5]
    assert marks_of(events[:3]) == []


@pytest.mark.parametrize('lost', [0.0, 0.2, 0.8])
def test_events_that_pause_in_every_window_are_missing(lost):
    validity = Validity(WINDOW_US, WIDTH)
    rest(validity, 25, 0)
    for end in range(26 * INTERVAL_US + WINDOW_US, 28 * INTERVAL_US, WINDOW_US):
        events = noise(end - WINDOW_US, end, usual=60.0 / (1.0 - lost))
        kept = events.t < end - lost * WINDOW_US
        validity.window(end, events[kept], complete=True)
    # A fifth of a window is no longer than 12 of its events take.
    assert validity.reason is (Reason.EVENTS_MISSING if lost > 0.2 else Reason.TRUSTED)


def test_windows_that_are_known_to_be_lost_are_no_pause():
    validity = Validity(WINDOW_US, WIDTH)
    rest(validity, 25, 0)
    for end in range(25 * INTERVAL_US + WINDOW_US, 28 * INTERVAL_US, WINDOW_US):
        if end // WINDOW_US % 7 == 0:
            validity.window(end, Events.empty(), complete=False)
        else:
            validity.window(end, noise(end - WINDOW_US, end), complete=True)
        assert validity.reason is Reason.TRUSTED


@pytest.mark.parametrize('share', [0.0, 0.2])
def test_events_some_of_which_come_again_later_are_known(share):
    validity = Validity(WINDOW_US, WIDTH)
    random = np.random.default_rng(4)
    for end in range(12 * WINDOW_US, 1_000_000, WINDOW_US):
        events = noise(end - WINDOW_US, end)
        if random.random() < share:
            old = noise(end - 11 * WINDOW_US, end - 10 * WINDOW_US).shifted(10 * WINDOW_US)
            events = together(events, old)
        validity.window(end, events, complete=True)
    assert validity.reason is (Reason.EVENTS_DISAGREE if share else Reason.TRUSTED)


@pytest.mark.parametrize('number', [1, 2])
def test_events_that_come_twice_are_found(number):
    validity = Validity(WINDOW_US, WIDTH)
    for end in range(WINDOW_US, 100_000, WINDOW_US):
        events = noise(end - WINDOW_US, end)
        validity.window(end, events[np.repeat(np.arange(len(events)), number)], complete=True)
    assert validity.reason is (Reason.EVENTS_DISAGREE if number > 1 else Reason.TRUSTED)


@pytest.mark.parametrize('step_us', [1, 1000, 5000, 20_000])
def test_events_with_the_times_of_packets_are_found(step_us):
    validity = Validity(WINDOW_US, WIDTH)
    for end in range(WINDOW_US, 100_000, WINDOW_US):
        events = noise(end - WINDOW_US, end)
        validity.window(end, replace(events, t=events.t // step_us * step_us), complete=True)
    assert validity.reason is (Reason.EVENTS_DISAGREE if step_us > 1000 else Reason.TRUSTED)


@pytest.mark.parametrize('usual', [60, 40])
@pytest.mark.parametrize('limited', [True, False])
def test_a_number_of_events_that_never_changes_is_a_limit_of_their_rate(usual, limited):
    validity = Validity(WINDOW_US, WIDTH)
    assert set(rest(validity, 25, 0, usual=usual)) == {Reason.TRUSTED}
    for end in range(25 * INTERVAL_US + WINDOW_US, 26 * INTERVAL_US, WINDOW_US):
        events = noise(end - WINDOW_US, end, 80 if limited else None, usual=3.0 * usual)
        validity.window(end, events, complete=True)
    assert validity.reason is (Reason.EVENTS_DISAGREE if limited else Reason.TRUSTED)


def test_a_limit_that_was_found_counts_in_single_windows_until_one_has_more():
    validity = Validity(WINDOW_US, WIDTH)
    begin, said = 0, []
    for number in (100, 100, 140, 100):
        assert rest(validity, 25, begin)[-1] is Reason.TRUSTED
        begin += 25 * INTERVAL_US
        for _ in range(1 if said else 10):
            end = begin + WINDOW_US
            validity.window(end, noise(begin, end, number), complete=True)
            begin = end
        said.append(validity.reason)
        begin += INTERVAL_US - begin % INTERVAL_US
    assert said == [Reason.EVENTS_DISAGREE] * 2 + [Reason.TRUSTED] * 2


def test_a_source_of_even_noise_has_no_limit():
    validity = Validity(WINDOW_US, WIDTH)
    for end in range(WINDOW_US, 2_000_000, WINDOW_US):
        validity.window(end, noise(end - WINDOW_US, end, 60), complete=True)
        assert validity.reason is Reason.TRUSTED


def test_events_in_a_loop_are_found(trial, encoded, frames):
    still = [noisy(trial.frames[0], index) for index in range(len(frames))]
    length, begin = 200_000, 600_000
    original = noise(0, 2_000_000, 60_000)
    source = original.between(begin - length, begin)
    copies = [source.shifted(length * (1 + index)) for index in range(5)]
    for events, expected in (
        (original, {Reason.TRUSTED}),
        (
            Events.concatenate([original.between(0, begin), *copies]),
            {Reason.TRUSTED, Reason.EVENTS_DISAGREE},
        ),
    ):
        reasons = follow(trial, encoded, events, still, alone=True)
        assert set(reasons) == expected
        assert set(reasons[: begin // WINDOW_US]) == {Reason.TRUSTED}
    assert reasons[(begin + 120_000) // WINDOW_US] is Reason.EVENTS_DISAGREE


def test_events_everywhere_while_nothing_moves(trial, encoded, frames):
    still = [noisy(trial.frames[0], index) for index in range(len(frames))]
    random = np.random.default_rng(5)
    count = 40_000
    pixels = random.integers(0, 346 * 260, 200)[random.integers(0, 200, count)]
    storm = Events(
        np.sort(random.integers(600_000, 1_100_000, count)),
        (pixels % 346).astype(np.uint16),
        (pixels // 346).astype(np.uint16),
        np.ones(count, bool),
    )
    reasons = follow(trial, encoded, storm, still)
    assert set(reasons[:300]) == {Reason.TRUSTED}
    assert Reason.EVENTS_WITHOUT_MOTION in reasons[300:420]


@pytest.mark.parametrize('number', [4, 7])
def test_a_blow_and_its_rebounds_are_no_storm_but_bursts_without_end_are(trial, encoded, number):
    still = [noisy(trial.frames[0], index) for index in range(len(trial.frames))]
    random = np.random.default_rng(6)
    size = 8000
    bursts = []
    for index in range(number):
        start = 600_000 + INTERVAL_US * index
        pixels = random.integers(0, 346 * 26, size)
        bursts.append(
            Events(
                np.sort(random.integers(start, start + WINDOW_US, size)),
                (pixels % 346).astype(np.uint16),
                (pixels // 346).astype(np.uint16),
                np.ones(size, bool),
            )
        )
    reasons = set(follow(trial, encoded, Events.concatenate(bursts), still))
    assert reasons == {Reason.TRUSTED} | ({Reason.EVENTS_WITHOUT_MOTION} if number > 4 else set())


@pytest.mark.parametrize('kept', [True, False])
def test_a_polarity_that_falls_silent_is_missed_within_40_ms(trial, encoded, kept):
    validity = Validity(WINDOW_US, WIDTH)
    for end in range(WINDOW_US, 600_000, WINDOW_US):
        if end % INTERVAL_US == 0:
            image = noisy(trial.frames[0], end)
            show(validity, encoded(image, end - 10_000))
        events = noise(end - 2000, end)
        late = end > 500_000
        validity.window(end, events[events.polarity == kept] if late else events, complete=True)
        if end == 500_000:
            assert validity.reason is Reason.TRUSTED
        if end == 540_000:
            assert validity.reason is Reason.EVENTS_MISSING


def test_a_lasting_difference_between_frame_and_estimate_is_found(trial, encoded):
    for difference, expected in ((0.1, Reason.TRUSTED), (2.0, Reason.EVENTS_DISAGREE)):
        validity = Validity(WINDOW_US, WIDTH)
        for index in range(6):
            frame = encoded(noisy(trial.frames[0], index), index * INTERVAL_US)
            show(validity, frame, 0.5 + difference, 0.5)
        assert validity.reason is expected


def test_frames_of_a_vibration_are_not_compared_with_events():
    random = np.random.default_rng(3)
    pattern = random.normal(0.0, 0.5, (65, 86))
    # The sensor rests, vibrates, rests, and moves: the events of both motions are those of another.
    states = [0] * 6 + [1] * 8 + [0] * 6 + [2] * 6
    for tells in (True, False):
        validity = Validity(WINDOW_US, WIDTH)
        reasons, before = {0: set(), 1: set(), 2: set()}, np.zeros_like(pattern)
        for index, state in enumerate(states):
            start = 1_000_000 + index * INTERVAL_US
            after = pattern * (0.3 * (index % 2) if state else 0.0)
            told = told_by_events(before[:, ::-1], after[:, ::-1], start, index)
            for end in range(start + WINDOW_US, start + INTERVAL_US + 1, WINDOW_US):
                parts = [told.between(end - WINDOW_US, end), noise(end - 2000, end)]
                validity.window(end, together(*parts), complete=True)
            picture = (after + random.normal(0.0, 0.01, after.shape)).astype(np.float32)
            mid_us, vibrating = start + INTERVAL_US, tells and state == 1
            validity.frame(mid_us, picture, None, 0.0, 0.0, vibrating=vibrating)
            reasons[state].add(validity.reason)
            before = after
        assert (reasons[1] == {Reason.TRUSTED}) is tells
        assert Reason.EVENTS_DISAGREE in reasons[2]


def test_the_rest_between_two_vibrations_is_learnt_from_neither():
    validity = Validity(WINDOW_US, WIDTH)
    random = np.random.default_rng(3)
    for end in range(WINDOW_US, 2_000_000, WINDOW_US):
        shaken = 500_000 < end < 1_500_000
        if end % INTERVAL_US == 0:
            still = random.normal(0.0, 0.01, (65, 86)).astype(np.float32)
            validity.frame(end, still, None, 0.0, 0.0, vibrating=shaken)
        validity.window(end, noise(end - 2000, end, usual=1000 if shaken else 60), complete=True)
        assert validity.reason is Reason.TRUSTED


def test_a_picture_that_becomes_white_in_part_has_lost_its_light(encoded, trial):
    validity = Validity(WINDOW_US, WIDTH)
    white = (trial.frames[0].astype(np.uint16) << 6).copy()
    for index, rows in enumerate((4, 4, 60, 60, 4)):
        image = np.where(np.arange(260)[:, None] < rows, np.uint16(1023 << 6), white)
        picture = encoded(trial.frames[0]).picture._replace(clipped=encoded(image).picture.clipped)
        assert picture.clipped == pytest.approx(rows / 260, abs=0.02)
        validity.frame(index * INTERVAL_US, None, picture, 0.0, None)
        # What was white from the start is the sensor's own.
        assert validity.reason is (Reason.TRUSTED if index < 2 else Reason.LIGHT_CHANGED)
    validity.forget()
    validity.frame(9 * INTERVAL_US, None, picture, 0.0, None)
    assert validity.reason is Reason.TRUSTED


@pytest.mark.parametrize('again', [False, True])
def test_a_frame_in_a_blow_says_nothing_alone(encoded, trial, again):
    validity = Validity(WINDOW_US, WIDTH)
    blurred = encoded(noisy(gaussian_filter(trial.frames[0].astype(float), 12.0), 0))
    assert picture_findings(blurred.picture)
    sharp = encoded(trial.frames[0])
    blow = 200_000
    for end in range(WINDOW_US, 300_000, WINDOW_US):
        count = 4000 if abs(end - blow) < 5000 else 60
        validity.window(end, noise(end - WINDOW_US, end, usual=count), complete=True)
        if end % INTERVAL_US == 0:
            wrong = end == blow or (again and end == blow + INTERVAL_US)
            picture = (blurred if wrong else sharp).picture
            validity.frame(end, None, picture, 2.0 if wrong else 0.0, 0.0)
    found = Reason.PICTURE_UNLIKE_REFERENCE if again else Reason.TRUSTED
    assert validity.reason is found


def test_what_moves_to_and_fro_between_two_frames_is_not_compared_with_them():
    random = np.random.default_rng(3)
    pattern = random.normal(0.0, 0.5, (65, 86))
    for mixed, expected in ((False, Reason.EVENTS_DISAGREE), (True, Reason.TRUSTED)):
        validity = Validity(WINDOW_US, WIDTH)
        before = np.zeros_like(pattern)
        for index in range(16):
            start = 1_000_000 + index * INTERVAL_US
            after = pattern * 0.08 * (index % 2)
            told = told_by_events(before[:, ::-1], after[:, ::-1], start, index)
            if mixed:
                back = replace(told, polarity=~told.polarity)
                told = Events.concatenate([told, back, told])
                told = told[np.argsort(told.t, kind='stable')]
            for end in range(start + WINDOW_US, start + INTERVAL_US + 1, WINDOW_US):
                parts = [noise(end - 2000, end)] + [told.between(end - 2000, end)] * (index > 6)
                validity.window(end, together(*parts), complete=True)
            shown = after if index > 6 else 0.0 * after
            picture = (shown + random.normal(0.0, 0.01, shown.shape)).astype(np.float32)
            validity.frame(start + INTERVAL_US, picture, None, 0.0, 0.0)
            before = after
            if index == 6:
                assert validity.reason is Reason.TRUSTED
        assert validity.reason is expected


def own_noise(seed: int) -> Callable[[int], Events]:
    """Return the noise of a sensor by the end of a window; each has pixels of its own."""
    pixels = np.random.default_rng(seed)
    rates = pixels.lognormal(0.0, 2.0, 260 * WIDTH)
    chances = np.cumsum(rates) / rates.sum()

    def window(end_us: int) -> Events:
        random = np.random.default_rng(end_us + seed)
        place = np.searchsorted(chances, random.random(60))
        y, x = np.divmod(place, WIDTH)
        t = np.sort(random.integers(end_us - WINDOW_US, end_us, 60))
        # Pixels differ in their leak, too, which makes ON events.
        sign = (place * 2654435761 >> 8) % 4 > 0
        return Events(t, x.astype(np.uint16), y.astype(np.uint16), sign)

    return window


def test_events_of_another_sensor_are_found_at_rest():
    random, own, other = np.random.default_rng(0), own_noise(1), own_noise(2)
    validity = Validity(WINDOW_US, WIDTH)
    reasons = {}
    for end in range(WINDOW_US, 9_000_000, WINDOW_US):
        wrong = 6_000_000 < end <= 7_000_000
        validity.window(end, (other if wrong else own)(end), complete=True)
        if end % INTERVAL_US == 0:
            still = random.normal(0.0, 0.01, (65, 86)).astype(np.float32)
            validity.frame(end, still, None, 0.0, 0.0)
        reasons[end] = validity.reason
    wrong = [end for end, reason in reasons.items() if reason is not Reason.TRUSTED]
    assert {reasons[end] for end in wrong} == {Reason.EVENTS_DISAGREE}
    assert 6_000_000 < wrong[0] <= 6_200_000
    assert 7_000_000 < wrong[-1] <= 7_500_000
    assert wrong == list(range(wrong[0], wrong[-1] + 1, WINDOW_US))


@pytest.mark.parametrize('events', [1, 2, 4])
def test_few_events_of_a_quiet_sensor_are_no_motion(events):
    random, validity = np.random.default_rng(events), Validity(WINDOW_US, WIDTH)
    for end in range(WINDOW_US, 8_000_000, WINDOW_US):
        told = noise(end - WINDOW_US, end, int(random.random() < events * WINDOW_US / INTERVAL_US))
        validity.window(end, told, complete=True)
        if end % INTERVAL_US == 0:
            still = random.normal(0.0, 0.01, (65, 86)).astype(np.float32)
            validity.frame(end, still, None, 0.0, 0.0)
        assert validity.reason is Reason.TRUSTED


def test_packets_that_are_lost_again_and_again_hide_no_fault():
    random, own, other = np.random.default_rng(0), own_noise(1), own_noise(2)
    validity = Validity(WINDOW_US, WIDTH)
    for end in range(WINDOW_US, 8_000_000, WINDOW_US):
        late = end > 5_000_000
        lost = late and end % (9 * WINDOW_US) == 0
        validity.window(end, (other if late else own)(end), complete=not lost)
        if end % INTERVAL_US == 0:
            still = random.normal(0.0, 0.01, (65, 86)).astype(np.float32)
            validity.frame(end, still, None, 0.0, 0.0)
        if end <= 5_000_000:
            assert validity.reason is Reason.TRUSTED
        elif end > 5_300_000:
            assert validity.reason is Reason.EVENTS_DISAGREE


def test_a_frame_before_the_one_before_is_no_error():
    validity, picture = Validity(WINDOW_US, WIDTH), np.zeros((65, 86), np.float32)
    for end in range(WINDOW_US, 400_000, WINDOW_US):
        validity.window(end, noise(end - WINDOW_US, end), complete=True)
    for index, mid_us in enumerate((200_000, 160_000, 198_000, 240_000)):
        validity.frame(mid_us, picture + np.float32(index), None, 0.0, 0.0)


def test_every_reason_has_a_text():
    assert len({reason.text for reason in Reason}) == len(Reason)
