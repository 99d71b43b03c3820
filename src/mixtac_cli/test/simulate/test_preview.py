# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The picture of a trial and the moments that it shows."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixtac_cli.simulate.preview import APART_S, draw_preview, event_picture, find_moments
from mixtac_events.arrays import Events
from mixtac_recordings.dataset import TrialSpec


def test_a_picture_is_drawn(tmp_path):
    path = tmp_path / 'new' / 'trial.png'
    draw_preview(TrialSpec('a', 'press', 3.4, 1, 2, 'easy', 'train'), path)
    picture = cv2.imread(str(path))
    assert picture.shape[0] > 800
    assert picture.shape[1] > 1000
    # Neither empty nor one colour.
    assert picture.std() > 20


def test_moments_of_a_known_press():
    t_us = np.arange(0, 10_000_000, 1000)
    t = t_us * 1e-6
    force = np.interp(t, [0, 4.0, 4.1, 6.0, 7.0, 10.0], [0, 0, 0.8, 0.8, 0.0, 0.0])
    force += 0.1 * np.exp(-(((t - 5.0) / 0.02) ** 2))
    found = {moment.name: moment.t_us * 1e-6 for moment in find_moments(t_us, force)}
    assert found['no contact'] < 4.0
    assert found['force rises'] == pytest.approx(4.05, abs=0.05)
    assert found['largest force'] == pytest.approx(5.0, abs=0.01)
    assert list(found.values()) == sorted(found.values())


@given(st.lists(st.floats(0.0, 5.0), min_size=4, max_size=30))
def test_moments_are_apart_and_inside(knots):
    t_us = np.arange(0, 4_000_000, 1000)
    force = np.interp(t_us, np.linspace(0, 4e6, len(knots)), knots)
    found = find_moments(t_us, force)
    assert found
    times = [moment.t_us for moment in found]
    assert times == sorted(times)
    assert all(late - early > 1e6 * APART_S for early, late in itertools.pairwise(times))
    assert times[0] >= 0
    assert times[-1] <= t_us[-1]


def test_an_event_picture_shows_what_is_in_its_window():
    t = np.array([0, 100_000, 100_001, 300_000], np.int64)
    x, y = np.array([5, 10, 20, 30], np.uint16), np.array([5, 11, 22, 33], np.uint16)
    trial = SimpleNamespace(events=Events(t, x, y, np.array([True, True, False, True])))
    picture, count = event_picture(trial, 100_000)
    assert count == 2
    on, off = picture[11, 10], picture[22, 20]
    assert on[0] > on[2]
    assert off[2] > off[0]
    assert (picture[5, 5] == 1.0).all()
    assert (picture[33, 30] == 1.0).all()
