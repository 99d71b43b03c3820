# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Motion of the skin from events that an independent pixel model makes of a moving pattern."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_slip_control.errors import SlipControlError
from mixtac_slip_control.features import SlipFeatures, SlipWindow
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import MIN_CONTRAST

HEIGHT, WIDTH = 260, 346
CONTRAST = 0.05
ROWS, COLUMNS = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
RNG = np.random.default_rng(5)
BEADS = np.stack([RNG.uniform(10, WIDTH - 10, 250), RNG.uniform(10, HEIGHT - 10, 250)], axis=1)


def light(move_x: np.ndarray, move_y: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Return bright beads after a motion given per pixel, on a scale of a 10-bit frame."""
    total = np.full(move_x.shape, 150.0)
    rows, columns = np.indices(move_x.shape)
    x, y = columns - move_x, rows - move_y
    width, reach = 3.5 * scale, int(25 * scale)
    for column, row in BEADS * scale:
        top, left = max(0, int(row) - reach), max(0, int(column) - reach)
        part = np.s_[top : int(row) + reach, left : int(column) + reach]
        away = (x[part] - column) ** 2 + (y[part] - row) ** 2
        total[part] += 500.0 * np.exp(-away / (2.0 * width**2))
    return total


STILL = np.zeros((HEIGHT, WIDTH))
REST = light(STILL, STILL)
AWAY_X, AWAY_Y = COLUMNS - WIDTH / 2.0, ROWS - HEIGHT / 2.0
PATCH = np.exp(-(AWAY_X**2 + AWAY_Y**2) / 90.0**2)


def events_of(move_x: np.ndarray, move_y: np.ndarray) -> Events:
    """Return the events of ideal pixels: one per threshold that the log intensity passes.

    Where each pixel stands between its thresholds at the start is random, as in a camera.
    """
    change = (np.log(light(move_x, move_y)) - np.log(REST)) / CONTRAST
    number = np.floor(change + RNG.random(change.shape)).astype(int)
    y, x = np.nonzero(number)
    times = np.abs(number[y, x])
    x, y, sign = np.repeat(x, times), np.repeat(y, times), np.repeat(number[y, x] > 0, times)
    t = np.sort(RNG.integers(0, 1000, len(x)))
    order = RNG.permutation(len(x))
    return Events(t, x[order].astype(np.uint16), y[order].astype(np.uint16), sign[order])


def seen(move_x: np.ndarray, move_y: np.ndarray) -> SlipWindow:
    features = SlipFeatures(SlipControlParameters())
    features.frame(np.round(REST).astype(np.uint16), 0)
    (window,) = features.push(events_of(move_x, move_y), 1000)
    return window


@pytest.mark.parametrize('angle', [0.3, 1.7, 3.9])
def test_translation_is_measured_in_thresholds(angle: float) -> None:
    x, y = 0.4 * np.cos(angle), 0.4 * np.sin(angle)
    window = seen(x * PATCH, y * PATCH)
    size = np.hypot(window.flow_x, window.flow_y)
    assert np.arctan2(window.flow_y, window.flow_x) == pytest.approx(
        (angle + np.pi) % (2 * np.pi) - np.pi, abs=0.15
    )
    assert size == pytest.approx(0.4 / CONTRAST, rel=0.15)
    assert abs(window.pressing) < 0.2 * size


def test_events_of_a_motion_agree_and_those_of_a_flash_do_not() -> None:
    moved = seen(0.4 * PATCH, STILL)
    assert moved.flow_x**2 + moved.flow_y**2 > 25.0 * moved.noise > 0.0
    # Where bright pixels fire first: the beads, all around their middles.
    y, x = np.nonzero(np.quantile(REST, 0.8) < REST)
    bright = Events(
        np.zeros(len(x), np.int64),
        x.astype(np.uint16),
        y.astype(np.uint16),
        np.ones(len(x), np.bool_),
    )
    features = SlipFeatures(SlipControlParameters())
    features.frame(np.round(REST).astype(np.uint16), 0)
    (flash,) = features.push(bright, 1000)
    assert flash.flow_x**2 + flash.flow_y**2 < 9.0 * flash.noise


def test_pressing_cancels_in_the_translation() -> None:
    window = seen(0.4 * AWAY_X / 90.0 * PATCH, 0.4 * AWAY_Y / 90.0 * PATCH)
    assert window.pressing == pytest.approx(0.4 / CONTRAST, rel=0.2)
    assert np.hypot(window.flow_x, window.flow_y) < 0.15 * window.pressing
    back = seen(-0.4 * AWAY_X / 90.0 * PATCH, -0.4 * AWAY_Y / 90.0 * PATCH)
    assert back.pressing == pytest.approx(-0.4 / CONTRAST, rel=0.2)


def test_counts_come_without_frames_and_lost_packets_are_marked() -> None:
    features = SlipFeatures(SlipControlParameters())
    t = np.array([100, 1200, 1300, 2900])
    place = np.array([1, 345, 0, 5], np.uint16)
    events = Events(t, place, place // 2, np.array([True, False, False, True]))
    features.lost_before(1100)
    windows = features.push(events, 3000)
    assert [w.count for w in windows] == [1, 2, 1]
    assert [w.end_us for w in windows] == [1000, 2000, 3000]
    assert [w.complete for w in windows] == [False, False, True]
    assert not any(w.guided or w.flow_x or w.flow_y for w in windows)


def test_a_contact_off_the_middle_is_measured_where_it_is() -> None:
    away_x, away_y = COLUMNS - 120.0, ROWS - 90.0
    patch = np.exp(-(away_x**2 + away_y**2) / 90.0**2)
    push = 0.4 / 90.0 * patch
    events = events_of(push * away_x, push * away_y)
    sizes = []
    for place in (None, (120.0, 90.0), (-50.0, 90.0)):
        features = SlipFeatures(SlipControlParameters())
        features.resize(WIDTH, HEIGHT)
        if place is not None:
            features.contact_at(*place)
        features.frame(np.round(REST).astype(np.uint16), 0)
        (window,) = features.push(events, 1000)
        sizes.append(np.hypot(window.flow_x, window.flow_y) / window.pressing)
    # A press beside the middle looks like slip; a place outside of the image is ignored.
    assert sizes[1] < 0.15 < sizes[0]
    assert sizes[2] == pytest.approx(sizes[0])


def test_parameters_fix_the_place_of_the_contact() -> None:
    fixed = SlipFeatures(SlipControlParameters(contact='173 130'))
    fixed.resize(WIDTH, HEIGHT)
    fixed.contact_at(60.0, 60.0)
    fixed.frame(np.round(REST).astype(np.uint16), 0)
    (window,) = fixed.push(events_of(0.4 * PATCH, STILL), 1000)
    assert window.flow_x == pytest.approx(0.4 / CONTRAST, rel=0.15)


def test_an_old_frame_is_not_used() -> None:
    features = SlipFeatures(SlipControlParameters())
    features.frame(np.round(REST).astype(np.uint16), 0)
    assert features.push(events_of(STILL, STILL + 0.3), 1000)[0].guided
    assert not features.push(Events.empty(), 900_000)[-1].guided


def test_a_frame_of_another_size_than_the_events_is_refused() -> None:
    features = SlipFeatures(SlipControlParameters())
    features.resize(640, 480)
    with pytest.raises(SlipControlError) as caught:
        features.frame(np.zeros((240, 320), np.uint16), 0)
    assert '(240, 320)' in str(caught.value)
    features.frame(np.full((480, 640), 7, np.uint8), 0)
    place = np.array([639], np.uint16)
    event = Events(np.array([100]), place, place // 2, np.array([True]))
    assert features.push(event, 1000)[0].guided
    # Another camera: its first frame has yet to come.
    features.resize(240, 180)
    assert not features.push(Events.empty(), 2000)[0].guided


@pytest.mark.parametrize('shape', [(4, 300), (300, 4), (300, 300, 3)])
def test_images_without_room_for_a_gradient_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(SlipControlError):
        SlipFeatures(SlipControlParameters()).frame(np.zeros(shape, np.uint8), 0)


@pytest.mark.parametrize('brighter', [True, False])
def test_a_step_of_light_is_distinguished_from_motion(brighter: bool) -> None:
    """A lamp at the side, switched on or off: 15 % on one side of the picture, 3 % on the other."""
    lamp = np.log(1.0 + np.linspace(0.15, 0.03, WIDTH)) * np.ones((HEIGHT, 1))
    number = np.floor(lamp / CONTRAST + RNG.random(lamp.shape)).astype(int)
    y, x = np.nonzero(number)
    t = np.sort(RNG.integers(0, 1000, len(x)))
    sign = np.full(len(x), brighter)
    sign[RNG.random(len(x)) < 0.05] ^= True  # noise
    order = RNG.permutation(len(x))
    features = SlipFeatures(SlipControlParameters())
    features.frame(np.round(REST).astype(np.uint16), 0)
    events = Events(t, x[order].astype(np.uint16), y[order].astype(np.uint16), sign)
    (window,) = features.push(events, 1000)
    assert window.light
    for angle in (0.0, 2.0, 4.0):
        assert not seen(0.4 * np.cos(angle) * PATCH, 0.4 * np.sin(angle) * PATCH).light
    assert not seen(0.4 * AWAY_X / 90.0 * PATCH, 0.4 * AWAY_Y / 90.0 * PATCH).light


def test_a_pattern_with_edges_has_contrast_and_a_smooth_one_little() -> None:
    features = SlipFeatures(SlipControlParameters())
    assert np.isnan(features.contrast)
    features.frame(np.round(REST).astype(np.uint16), 0)
    sharp = features.contrast
    wave = 20_000.0 * (1.0 + 0.35 * np.sin(COLUMNS / 20.0) * np.sin(ROWS / 20.0))
    features.frame(np.round(wave).astype(np.uint16), 40_000)
    assert features.contrast < MIN_CONTRAST < 0.5 * sharp
