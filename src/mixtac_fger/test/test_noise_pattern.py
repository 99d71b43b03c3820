# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The pattern of a sensor's noise: known again, missed where events are not of its pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from mixtac_events.arrays import Events
from mixtac_fger.noise_pattern import (
    RADIUS,
    TILES,
    NoisePattern,
    add_seen,
    less_local_mean,
    pattern_sums,
    tiles_of,
)
from mixtac_fger.recent_events import Packed, packed

WIDTH, HEIGHT, SIZE = 346, 260, 4
SHAPE = HEIGHT // SIZE, WIDTH // SIZE
WINDOW_US = 2000
LEARNT = 200
"""Stretches at rest before each test."""


class Sensor:
    """Pixels that each have their own rate of ON and of OFF events."""

    def __init__(self, seed: int, spread: float = 1.5, per_window: float = 40.0) -> None:
        self.random = np.random.default_rng(seed)
        rates = self.random.lognormal(0.0, spread, 2 * HEIGHT * WIDTH)
        self.chances = np.cumsum(rates) / rates.sum()
        self.per_window = per_window

    def window(self) -> Events:
        """Return the noise of a window."""
        count = self.random.poisson(self.per_window)
        places = np.searchsorted(self.chances, self.random.random(count))
        sign, pixel = np.divmod(places, HEIGHT * WIDTH)
        y, x = np.divmod(pixel, WIDTH)
        t = np.sort(self.random.integers(0, WINDOW_US, count))
        return Events(t, x.astype(np.uint16), y.astype(np.uint16), sign == 1)

    def events(self) -> Events:
        """Return the noise of a stretch."""
        return Events.concatenate([self.window() for _ in range(10)])

    def stretch(self) -> Packed:
        """Return the same as it is judged."""
        return packed(self.events())


def learnt(sensor: Sensor) -> NoisePattern:
    """Return a pattern that knows a sensor."""
    pattern = NoisePattern(WIDTH, WINDOW_US)
    learn(pattern, sensor)
    return pattern


def learn(pattern: NoisePattern, sensor: Sensor, stretches: int = LEARNT) -> None:
    """Let a pattern learn a sensor at rest."""
    for _ in range(stretches):
        pattern.learn(sensor.stretch(), SHAPE)


def moving(events: Events, random: np.random.Generator, share: float, count: int = 4000) -> Packed:
    """Add many events to a part of the picture, of the same polarity in each column of bins."""
    x = random.integers(0, int(share * WIDTH), count).astype(np.uint16)
    y = random.integers(0, HEIGHT, count).astype(np.uint16)
    added = Events(np.zeros(count, np.int64), x, y, x // SIZE % 2 == 0)
    return packed(Events.concatenate([events, added]))


@pytest.mark.parametrize('seed', range(4))
def test_the_noise_of_the_sensor_is_known_again(seed: int) -> None:
    sensor = Sensor(seed)
    pattern = learnt(sensor)
    for _ in range(300):
        pattern.judge(sensor.stretch())
        assert not pattern.missing


WRONG = {
    'mirrored': lambda e: replace(e, x=(WIDTH - 1 - e.x).astype(np.uint16)),
    'upside down': lambda e: replace(e, y=(HEIGHT - 1 - e.y).astype(np.uint16)),
    'shifted': lambda e: replace(e, x=((e.x + 40) % WIDTH).astype(np.uint16)),
    'inverted': lambda e: replace(e, polarity=~e.polarity),
}


@pytest.mark.parametrize('motion', [0.0, 0.4])
@pytest.mark.parametrize('wrong', WRONG.values(), ids=WRONG)
def test_it_is_missing_in_wrong_events_and_back_with_the_right_ones(wrong, motion: float) -> None:
    sensor = Sensor(11)
    pattern = learnt(sensor)

    def judged(change) -> bool:
        events = change(sensor.events())
        pattern.judge(moving(events, sensor.random, motion) if motion else packed(events))
        return pattern.missing

    for _ in range(20):
        assert not judged(lambda events: events)
    assert sum(judged(wrong) for _ in range(30)) >= 22
    assert pattern.missing
    found = [judged(lambda events: events) for _ in range(30)]
    assert not found[-1]
    assert found == sorted(found, reverse=True)


@pytest.mark.parametrize(('share', 'storm'), [(1.0, True), (0.6, False)])
def test_many_events_everywhere_are_a_storm_and_in_a_part_a_motion(share: float, storm) -> None:
    sensor = Sensor(12)
    pattern = learnt(sensor)
    for _ in range(10):
        pattern.judge(moving(sensor.events(), sensor.random, share))
    assert pattern.storm is storm
    pattern.judge(sensor.stretch())
    assert not pattern.storm


def test_slow_motion_is_not_learnt_as_rest() -> None:
    sensor = Sensor(16, spread=0.5)
    pattern = NoisePattern(WIDTH, WINDOW_US)
    learn(pattern, sensor, 12)
    for _ in range(60):
        pattern.learn(moving(sensor.events(), sensor.random, 0.4, 400), SHAPE)
    for _ in range(200):
        pattern.judge(sensor.stretch())
        assert not pattern.missing


def test_nothing_is_said_where_most_of_the_skin_moves() -> None:
    sensor = Sensor(17)
    pattern = learnt(sensor)
    for _ in range(100):
        noise, first = sensor.events(), int(0.85 * WIDTH)
        left = noise[noise.x >= first]
        other = replace(left, x=(WIDTH - 1 + first - left.x).astype(np.uint16))
        pattern.judge(moving(other, sensor.random, 0.85))
        assert not pattern.missing


@pytest.mark.parametrize(('left', 'silent'), [(0.0, False), (0.1, False), (0.5, True), (1.0, True)])
def test_parts_of_the_sensor_fall_silent(left: float, silent) -> None:
    sensor = Sensor(14)
    pattern = learnt(sensor)
    for _ in range(15):
        events = sensor.events()
        pattern.judge(packed(events[events.x >= left * WIDTH]))
    assert pattern.silent is silent
    for _ in range(15):
        pattern.judge(sensor.stretch())
    assert not pattern.silent


@pytest.mark.parametrize('axis', ['x', 'y'])
@pytest.mark.parametrize(('every', 'silent'), [(2, True), (4, True), (20, False)])
def test_rows_and_columns_fall_silent_within_200_ms(axis: str, every: int, silent) -> None:
    sensor = Sensor(15, per_window=80.0)
    pattern = learnt(sensor)
    for _ in range(10):
        events = sensor.events()
        pattern.judge(packed(events[getattr(events, axis) % every != 0]))
    assert pattern.silent is silent
    for _ in range(15):
        pattern.judge(sensor.stretch())
    assert not pattern.silent


def test_noise_that_grows_everywhere_becomes_what_is_usual() -> None:
    sensor = Sensor(15)
    pattern = learnt(sensor)
    sensor.per_window *= 2.5
    for _ in range(2000):
        stretch = sensor.stretch()
        pattern.judge(stretch)
        assert not pattern.storm
        pattern.learn(stretch, SHAPE)
    sensor.per_window *= 2.0
    for _ in range(10):
        pattern.judge(sensor.stretch())
        assert not pattern.storm


def test_one_stretch_alone_is_never_enough() -> None:
    sensor, other = Sensor(1), Sensor(2, per_window=400.0)
    pattern = learnt(sensor)
    pattern.judge(other.stretch())
    assert not pattern.missing


def test_the_noise_of_another_sensor_is_not_learnt() -> None:
    sensor, other = Sensor(3), Sensor(4)
    pattern = learnt(sensor)
    for _ in range(10):
        pattern.judge(other.stretch())
    learn(pattern, other)
    pattern.judge(other.stretch())
    assert pattern.missing


@pytest.mark.parametrize('again', ['confirm', 'forget'])
def test_another_pattern_is_learnt_where_it_has_proved_right(again: str) -> None:
    sensor, other = Sensor(5), Sensor(6)
    pattern = learnt(sensor)
    for _ in range(10):
        pattern.judge(other.stretch())
    getattr(pattern, again)()
    assert not pattern.missing
    learn(pattern, other)
    for _ in range(50):
        pattern.judge(other.stretch())
        assert not pattern.missing
    for _ in range(10):
        pattern.judge(sensor.stretch())
    assert pattern.missing


def test_confirmed_while_it_is_there_it_stays() -> None:
    sensor, other = Sensor(5), Sensor(6)
    pattern = learnt(sensor)
    pattern.confirm()
    for _ in range(10):
        pattern.judge(other.stretch())
    assert pattern.missing


def test_silence_says_nothing() -> None:
    pattern = learnt(Sensor(7))
    for _ in range(50):
        pattern.judge(packed(Events.empty()))
    assert not pattern.missing


def test_fewer_events_of_the_same_pattern_are_no_others() -> None:
    sensor = Sensor(8)
    pattern = learnt(sensor)
    sensor.per_window /= 3.0
    for _ in range(300):
        pattern.judge(sensor.stretch())
        assert not pattern.missing


def test_nothing_is_said_before_it_is_known() -> None:
    pattern = NoisePattern(WIDTH, WINDOW_US)
    pattern.judge(Sensor(9).stretch())
    learn(pattern, Sensor(9), 3)
    for _ in range(20):
        pattern.judge(Sensor(10).stretch())
    assert not pattern.missing


def test_pixels_alike_have_no_pattern() -> None:
    sensor = Sensor(12, spread=0.0)
    pattern = learnt(sensor)
    for _ in range(500):
        pattern.judge(sensor.stretch())
        assert not pattern.missing


def test_a_local_mean_is_that_of_a_box() -> None:
    pattern = np.random.default_rng(0).random((2, *SHAPE)).astype(np.float32)
    width = 2 * RADIUS + 1
    box = uniform_filter(pattern.astype(np.float64), (1, width, width), mode='nearest')
    assert less_local_mean(pattern) == pytest.approx(pattern - box, abs=1e-5)


def test_the_sums_are_those_of_the_bins_with_an_event() -> None:
    events = Sensor(13).events()
    local = np.random.default_rng(1).normal(size=(2, *SHAPE)).astype(np.float32)
    found, sums = np.ones(local.shape, bool), np.empty((2, TILES))
    counts, tiles = np.empty(TILES + SIZE * sum(SHAPE)), tiles_of(*SHAPE)
    pattern_sums(packed(events), SIZE, tiles, local, found, sums, counts)
    there = np.zeros(local.shape, bool)
    inside = (events.x // SIZE < SHAPE[1]) & (events.y // SIZE < SHAPE[0])
    row, column = events.y[inside] // SIZE, events.x[inside] // SIZE
    there[events.polarity[inside].astype(int), row, column] = True
    assert np.array_equal(found, there)
    assert sums.sum(1) == pytest.approx(
        [local[there].sum(), np.square(local[there]).sum()], rel=1e-5
    )
    parts = (
        np.bincount(row * 6 // SHAPE[0] * 8 + column * 8 // SHAPE[1], minlength=TILES),
        np.bincount(events.y[inside], minlength=SIZE * SHAPE[0]),
        np.bincount(events.x[inside], minlength=SIZE * SHAPE[1]),
    )
    assert np.array_equal(counts, np.concatenate(parts))


def test_a_pattern_follows_the_share_of_stretches() -> None:
    there = np.array([[[False, True]], [[True, False]]])
    pattern = np.full((2, 1, 2), 0.5, np.float32)
    add_seen(there, 0.25, pattern)
    assert pattern == pytest.approx(np.array([[[0.375, 0.625]], [[0.625, 0.375]]]))
