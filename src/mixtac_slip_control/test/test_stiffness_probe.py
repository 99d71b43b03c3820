# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The probe of the stiffness: how far, how long, and back."""

from __future__ import annotations

import itertools

import pytest

from mixtac_slip_control.bounds import ProbeSettings, StiffnessProbe
from mixtac_slip_control.errors import SlipControlError

SETTINGS = ProbeSettings(advance=1e-5, force=0.1, step=1e-6, precision=0.1, windows=30)


def started() -> StiffnessProbe:
    probe = StiffnessProbe(SETTINGS)
    probe.start()
    return probe


def test_it_goes_out_waits_and_comes_back_in_its_steps() -> None:
    probe, places = started(), [0.0]
    while probe.active:
        probe.update(1e3, 1e3, 1.0)
        places.append(probe.place)
    assert max(places) == pytest.approx(1e-5)
    assert max(abs(b - a) for a, b in itertools.pairwise(places)) <= 1.0001e-6
    assert len(places) == pytest.approx(1 + 30 + 10, abs=1)
    assert places[-1] == 0.0


def test_it_returns_as_soon_as_the_stiffness_is_known() -> None:
    probe = started()
    for _ in range(4):
        probe.update(1e3, 200.0, 1.0)
    probe.update(1e3, 99.0, 1.0)
    # What is less sure while it returns does not turn it round.
    places = [probe.place]
    while probe.active:
        probe.update(1e3, 200.0, 1.0)
        places.append(probe.place)
    assert places == sorted(places, reverse=True)


def test_it_waits_where_the_force_has_grown_enough() -> None:
    probe = started()
    for _ in range(20):
        probe.update(2e4, 1e4, 1.0)
    assert 5e-6 <= probe.place <= 6.1e-6


def test_it_stays_within_what_the_force_allows() -> None:
    probe = started()
    for _ in range(10):
        probe.update(1e3, 1e3, 3.5e-6)
    assert probe.place == pytest.approx(3.5e-6)


def test_ending_says_where_it_was() -> None:
    probe = started()
    probe.update(1e3, 1e3, 1.0)
    assert probe.end() == pytest.approx(1e-6)
    assert (probe.place, probe.active) == (0.0, False)


def test_an_advance_of_zero_does_not_probe() -> None:
    probe = StiffnessProbe(ProbeSettings(advance=0.0))
    probe.start()
    assert not probe.active


@pytest.mark.parametrize('bad', [{'advance': -1.0}, {'step': 0.0}, {'precision': float('nan')}])
def test_bad_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SlipControlError, match=r'give|above'):
        ProbeSettings(**bad)
