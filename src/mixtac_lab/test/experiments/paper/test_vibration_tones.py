# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tones up to 450 Hz in the events of a `paper_like` sensor."""

import functools

import numpy as np
import pytest

from mixtac_events.arrays import Events
from mixtac_lab.experiments.paper import vibration
from mixtac_lab.experiments.paper.vibration import (
    DEPTH_MM,
    PRESSED,
    Shaken,
    binned,
    find_line,
    shake,
    tone_lines,
)
from mixtac_sim import SimulationError


@pytest.fixture(scope='module')
def lines():
    """Return a function that looks for a tone in half a second, which is enough for all of them."""

    @functools.cache
    def found(frequency, amplitude):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(vibration, 'SHAKEN_S', (0.65, 1.15))
            return tone_lines(frequency, amplitude, 3, 21, 'paper_like')

    return found


@pytest.mark.parametrize('frequency', [70, 230])
@pytest.mark.parametrize('amplitude', [0.05, 0.1])
def test_tones_of_the_paper_stand_in_the_flow(lines, frequency, amplitude):
    found = lines(frequency, amplitude)
    assert found['flow']['peak_hz'] in {frequency, 2 * frequency}
    assert found['flow']['drive'] > 30.0
    assert found['rate'] > found['rest_rate']


def test_a_tone_at_the_upper_end_stands_in_the_counts_at_twice_its_frequency(lines):
    found = lines(230, 0.1)
    assert found['count']['peak_hz'] == pytest.approx(460.0, abs=1.0)
    assert found['count']['twice'] > 30.0


def test_a_tone_above_the_papers_range_stands_in_the_flow(lines):
    assert lines(430, 0.1)['flow']['peak_hz'] == pytest.approx(430.0, abs=1.0)


def test_lost_contact_is_refused():
    with pytest.raises(SimulationError) as refused:
        shake(PRESSED, 100, DEPTH_MM, 1)
    assert refused.value.remedy


def test_signals_of_known_events():
    """Two events per period, ON to the right of an edge and OFF back: flow swings at the drive."""
    frame = np.tile(np.exp(np.arange(346) / 60.0), (260, 1)).astype(np.uint16) + 1
    t = np.arange(0, 1_000_000, 5_000)  # ON, OFF, ON, ... at 100 Hz
    ones = np.ones(len(t), np.uint16)
    events = Events(t, 300 * ones, 100 * ones, np.arange(len(t)) % 2 == 0)
    counts, balance, flow = binned(Shaken(events, frame, (0.0, 1.0)), 1000).values()
    assert counts.sum() == len(t)
    line = find_line(counts, 100, 1000)
    assert line['drive'] < 1e-6 * find_line(balance, 100, 1000)['drive']
    assert line['peak_hz'] == 200.0
    np.testing.assert_allclose(np.abs(flow[::5]), np.abs(flow[0]), rtol=1e-2)
    assert np.sign(flow[0]) == -np.sign(flow[5])


def test_tones_beyond_half_the_rate_are_looked_for_where_they_appear():
    wave = np.cos(2.0 * np.pi * 2.0 * 370.0 * np.arange(1000) / 1000.0)
    found = find_line(wave + 1e-3 * np.random.default_rng(1).normal(size=1000), 370, 1000)
    assert found['peak_hz'] == pytest.approx(260.0)
    assert found['clear']
    assert found['twice'] > 100.0 * found['drive']
