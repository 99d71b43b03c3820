# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac simulate`: its bags, its picture, and the moments that the picture shows."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from mixtac_cli.simulate import APART_S, draw_preview, event_picture, find_moments, simulate
from mixtac_events.arrays import Events
from mixtac_recordings.dataset import DatasetDescription, TrialSpec
from mixtac_sim import SimulationError

app = typer.Typer()
app.command()(simulate)


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_bags_are_written_and_counted(tmp_path):
    out = tmp_path / 'set'
    words = ('--profile', 'idle', '--trials', 2, '--seconds', 3, '--preset', 'easy', '--out', out)
    result = run(*words, '--jobs', 1, '--compress')
    assert result.exit_code == 0, result.output
    said = ' '.join(result.output.split())
    assert '2 bags written' in said
    assert '1 train, 1 test' in said
    again = run(*words, '--jobs', 1)
    assert '0 bags written' in again.output
    description = DatasetDescription.read(out)
    assert (description.name, description.preset, description.complete) == ('idle', 'easy', True)


@pytest.mark.parametrize(
    'words',
    [
        (),
        ('--profile', 'idle'),
        ('--profile', 'idle', '--dataset', 'static', '--out', 'x'),
        ('--out', 'x'),
        ('--profile', 'idle', '--trials', 0, '--out', 'x'),
    ],
)
def test_wrong_usage_is_refused(words):
    assert run(*words).exit_code == 2


@pytest.mark.parametrize(
    ('words', 'kind'),
    [
        (('--profile', 'dance', '--out', 'x'), SimulationError),
        (('--dataset', 'dance', '--out', 'x'), SimulationError),
        (('--profile', 'idle', '--preset', 'dance', '--out', 'x'), SimulationError),
    ],
)
def test_what_does_not_exist_is_an_expected_failure(words, kind, tmp_path):
    out = () if 'x' in words else ('--out', tmp_path / 'y', '--seconds', 3)
    assert isinstance(run(*words, *out).exception, kind)


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
    events = Events(t, x, y, np.array([True, True, False, True]))
    trial = SimpleNamespace(events=events, frames=np.zeros((1, 260, 346), np.uint16))
    picture, count = event_picture(trial, 100_000)
    assert count == 2
    on, off = picture[11, 10], picture[22, 20]
    assert on[0] > on[2]
    assert off[2] > off[0]
    assert (picture[5, 5] == 1.0).all()
    assert (picture[33, 30] == 1.0).all()
