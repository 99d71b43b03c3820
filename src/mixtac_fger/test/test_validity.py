# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""When a force counts as valid: pictures against the reference, frames against events."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from toy_sensor import INTERVAL_US, ToyTrial, toy_trial

from mixtac_core.events.arrays import Events
from mixtac_fger.config import FgerConfig
from mixtac_fger.features import FramePreparation
from mixtac_fger.validity import (
    HOLD_FRAMES,
    JUDGED_FRAMES,
    TILE_COLUMNS,
    TILE_ROWS,
    PictureFigures,
    Reason,
    Validity,
    add_events,
    displaced,
    picture_figures,
    tile_moments,
)

WINDOW_US = 2000
WIDTH, HEIGHT = 346, 260
TILES = TILE_ROWS * TILE_COLUMNS


def noisy(image: np.ndarray, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, 3.0, image.shape)
    return np.clip(image + noise, 0, 1023).astype(np.uint16)


@pytest.fixture(scope='module')
def preparation() -> FramePreparation:
    return FramePreparation(FgerConfig())


@pytest.fixture(scope='module')
def compared(preparation, trial) -> Callable[[np.ndarray], PictureFigures]:
    """Return a function that compares an image with the first one."""
    reference = preparation.contrast(trial.frames[0]).coarse

    def compare(image: np.ndarray) -> PictureFigures:
        contrast = preparation.contrast(image)
        return preparation.compare(contrast, reference)[1]

    return compare


def test_moments_of_tiles_are_those_of_numpy():
    a, b = np.random.default_rng(1).normal(size=(2, 60, 80)).astype(np.float32)
    found = np.empty((5, TILES))
    tile_moments(a, b, found)
    parts = [
        each.reshape(TILE_ROWS, 10, TILE_COLUMNS, 10).transpose(0, 2, 1, 3).reshape(TILES, -1)
        for each in (a, b)
    ]
    np.testing.assert_allclose(found[:2], [each.mean(1) for each in parts], atol=1e-6)
    expected = [np.cov(x, y, ddof=0) for x, y in zip(*parts, strict=True)]
    wanted = [(matrix[0, 0], matrix[1, 1], matrix[0, 1]) for matrix in expected]
    np.testing.assert_allclose(found[2:].T, wanted, atol=1e-5)


@given(
    places=st.lists(st.tuples(st.integers(0, 70), st.integers(0, 50), st.booleans()), max_size=60)
)
@settings(max_examples=30)
def test_net_events_are_a_histogram(places):
    x, y, on = (np.array([place[k] for place in places], int) for k in range(3))
    net = np.ones((10, 15), np.int8)
    add_events(x.astype(np.uint16), y.astype(np.uint16), on.astype(bool), 4, net)
    edges, inside = [np.arange(n + 1) * 4 for n in net.shape], (x < 60) & (y < 40)
    expected, *_ = np.histogram2d(y[inside], x[inside], bins=edges, weights=2.0 * on[inside] - 1.0)
    np.testing.assert_array_equal(net, 1.0 + expected)


def test_a_displaced_reference_is_explained_and_moves_outward():
    y, x = np.mgrid[:60, :80].astype(np.float32)
    random = np.random.default_rng(2)
    reference = gaussian_filter(random.normal(size=(60, 80)), 1.5).astype(np.float32)
    away = np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / 100.0)
    flow = np.stack([0.1 * (x - 40) * away, 0.1 * (y - 30) * away]).astype(np.float32)
    image = np.empty_like(reference)
    displaced(reference, flow, image)
    found = picture_figures(reference, image, flow)
    assert found.unexplained() < 1e-3
    assert found.outward > 0.0
    assert picture_figures(reference, image, -flow).outward < 0.0
    assert picture_figures(reference, reference, np.zeros_like(flow)).outward == 0.0


@pytest.mark.parametrize('gain', [0.1, 0.4, 1.0, np.linspace(0.4, 1.0, WIDTH)])
def test_no_contact_and_no_lamp_is_a_fault(compared, preparation, trial, gain):
    for index, image in enumerate(trial.frames):
        assert compared(noisy(gain * image, index)).unexplained() < 1.0
    # Nor do the moments change much with the light.
    reference = preparation.contrast(trial.frames[0]).coarse
    even, shaded = (
        preparation.compare(preparation.contrast(image.astype(np.uint16)), reference)[0]
        for image in (trial.frames[15], trial.frames[15] * np.linspace(0.7, 1.0, WIDTH))
    )
    assert abs(shaded[0] - even[0]) < 0.1 * abs(even[0])


@pytest.mark.parametrize(
    'change',
    [
        lambda image: np.roll(image, 2, 1),
        lambda image: image * (np.arange(WIDTH) > 173),
        lambda image: image[:, ::-1],
        lambda image: 1023 - np.minimum(image, 1023),
        lambda image: gaussian_filter(image.astype(float), 8),
        lambda image: np.full_like(image, 1023),
    ],
    ids=['right', 'half', 'mirror', 'negative', 'focus', 'white'],
)
def test_what_no_contact_does_to_a_picture_is_found(compared, trial, change):
    image = np.ascontiguousarray(change(trial.frames[4])).astype(np.uint16)
    assert compared(image).unexplained() > 1.0


def figures(unexplained: float) -> PictureFigures:
    tiles = np.full(TILES, 0.2 * unexplained)
    return PictureFigures(tiles, tiles, np.ones(TILES), 0.0, 0.0)


def test_a_picture_counts_again_after_some_frames_without_a_finding():
    validity = Validity(WIDTH)
    for unexplained in (0.5, 2.0):
        validity.frame(0, None, figures(unexplained))
    for _ in range(HOLD_FRAMES):
        assert validity.reason is Reason.PICTURE_UNLIKE_REFERENCE
        validity.frame(0, None, figures(0.5))
    assert validity.reason is Reason.TRUSTED


def test_the_noise_of_the_sensor_is_no_fault_of_its_picture():
    random, validity = np.random.default_rng(3), Validity(WIDTH)
    for index in range(10):
        validity.frame(index * INTERVAL_US, random.normal(0.0, 0.7, (65, 86)).astype(np.float32))
    noise = np.full(TILES, 0.49)
    found = PictureFigures(noise, noise, np.ones(TILES), 0.0, 0.0)
    assert found.unexplained() > 1.0
    last = random.normal(0.0, 0.7, (65, 86)).astype(np.float32)
    validity.frame(10 * INTERVAL_US, last, found)
    assert validity.reason is Reason.TRUSTED


def test_a_frame_that_comes_twice_is_frozen(preparation, trial):
    validity, contrast = Validity(WIDTH), preparation.contrast(trial.frames[0]).coarse
    validity.frame(0, contrast)
    assert validity.reason is Reason.TRUSTED
    validity.frame(INTERVAL_US, contrast.copy())
    assert validity.reason is Reason.FRAME_FROZEN


@pytest.fixture(scope='module')
def shaken() -> ToyTrial:
    return toy_trial(2.4, seed=4)


def follow(preparation, shaken: ToyTrial, events: Events, validity: Validity) -> list[Reason]:
    """Show a trial with other events; returns the reason after each frame."""
    middle, reasons, frame = (shaken.exposure_start_us + shaken.exposure_end_us) // 2, [], 0
    ends = np.arange(WINDOW_US, int(shaken.t_us[-1]), WINDOW_US)
    cuts = np.searchsorted(events.t, [0, *ends])
    for index, end in enumerate(ends.tolist()):
        while frame < len(middle) and shaken.arrival_us[frame] <= end:
            contrast = preparation.contrast(noisy(shaken.frames[frame], frame)).coarse
            validity.frame(int(middle[frame]), contrast)
            reasons.append(validity.reason)
            frame += 1
        validity.window(end, events[cuts[index] : cuts[index + 1]], complete=True)
    return reasons


FAULT_US = 1_000_000


def changed(events: Events, change: Callable[[Events], Events]) -> Events:
    cut = np.searchsorted(events.t, FAULT_US)
    return Events.concatenate([events[:cut], change(events[cut:])])


@pytest.mark.parametrize(
    ('change', 'right'),
    [
        (lambda events: events, True),
        (lambda events: events[:0], False),
        (lambda events: replace(events, polarity=~events.polarity), False),
        (lambda events: replace(events, x=(WIDTH - 1 - events.x).astype(np.uint16)), False),
    ],
    ids=['sound', 'missing', 'inverted', 'mirrored'],
)
def test_events_that_are_not_of_the_motion_are_found_while_it_lasts(
    preparation, shaken, change, right
):
    reasons = follow(preparation, shaken, changed(shaken.events, change), Validity(WIDTH))
    before = FAULT_US // INTERVAL_US
    assert set(reasons[:before]) == {Reason.TRUSTED}
    assert set(reasons[before:]) <= {Reason.TRUSTED, Reason.EVENTS_DISAGREE}
    assert (Reason.EVENTS_DISAGREE in reasons[before:]) is not right


def test_what_is_not_known_of_the_events_is_no_fault(preparation, shaken):
    validity = Validity(WIDTH)
    follow(preparation, shaken, shaken.events, validity)
    for begin in (0, 10_000_000):
        validity.clear()
        for index in range(2 * JUDGED_FRAMES):
            shown = preparation.contrast(noisy(shaken.frames[10 * (index % 2)], index)).coarse
            validity.window(begin + index * INTERVAL_US, Events.empty(), complete=False)
            validity.frame(begin + index * INTERVAL_US, shown)
        assert validity.reason is Reason.TRUSTED


@pytest.mark.parametrize('noise', [0.05, 0.4])
def test_noise_that_grows_is_no_motion(preparation, shaken, noise):
    validity, random = Validity(WIDTH), np.random.default_rng(5)
    follow(preparation, shaken, shaken.events, validity)
    still = preparation.contrast(shaken.frames[-1]).coarse
    for index in range(1, 4 * JUDGED_FRAMES):
        now = int(shaken.t_us[-1]) + index * INTERVAL_US
        validity.window(now, Events.empty(), complete=True)
        validity.frame(now, still + random.normal(0.0, noise, still.shape).astype(np.float32))
        assert validity.reason is Reason.TRUSTED
