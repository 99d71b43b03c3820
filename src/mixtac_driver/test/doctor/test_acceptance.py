# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The checks of a new camera: a sound virtual one passes all, each defect fails its own only.

With MIXTAC_ACCEPTANCE_FULL set, every defect goes through all ten checks; without, through its own
and those of the still stretch.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from acceptance_scene import RestingScene

from mixtac_driver.camera import CameraBatch
from mixtac_driver.clock import Origin
from mixtac_driver.doctor.acceptance import Person, accept
from mixtac_driver.doctor.stretch import (
    CHECKS,
    PASSIVE,
    Outcome,
    Stretch,
    flashes,
    passive_checks,
)
from mixtac_driver.parameters import DriverParameters
from mixtac_events.arrays import Events
from mixtac_events.readings import NO_EDGES, NO_SAMPLES, DecodedBatch
from mixtac_sim.usb.faults import Fault, FaultKind

STILL_S = 1.6
PARAMETERS = DriverParameters(device='virtual', usb_early_packet_delay=125)
EVERYTHING = tuple(range(1, len(CHECKS) + 1))
DEFECTS = {
    1: Fault(FaultKind.CLOCK_SKEW, amount=3000.0),
    2: Fault(FaultKind.LOST_WRAP, size=45, count=1),
    3: Fault(FaultKind.LOST_EDGES, size=5),
    4: Fault(FaultKind.STUCK_BIASES),
    5: Fault(FaultKind.MUTE_RETURN),
    6: Fault(FaultKind.NOISE, amount=9.0),
    7: Fault(FaultKind.LATE_STAMPS, delay=0.008),
    8: Fault(FaultKind.BLUR, amount=4.0),
    9: Fault(FaultKind.RIPPLE, amount=100.0),
    10: Fault(FaultKind.HEAT, amount=45.0),
}


@pytest.fixture
def scene(monkeypatch):
    return RestingScene(monkeypatch)


def outcomes(scene, defect, wanted):
    """Return the outcome of each check of a virtual camera with a defect."""
    if defect is not None:
        scene.device.inject(defect)
    who, checks = scene.person(), {}
    for check in accept(PARAMETERS, STILL_S, who, backend=scene.backend, wanted=wanted):
        print(check)
        checks[check.number] = check.outcome
    return checks


def test_a_sound_camera_passes_every_check(scene):
    assert outcomes(scene, None, EVERYTHING) == dict.fromkeys(EVERYTHING, Outcome.PASS)


@pytest.mark.parametrize('number', DEFECTS)
def test_each_defect_fails_its_own_check_and_no_other(scene, number):
    full = os.environ.get('MIXTAC_ACCEPTANCE_FULL')
    wanted = EVERYTHING if full else tuple(sorted({number, *PASSIVE}))
    expected = dict.fromkeys(wanted, Outcome.PASS) | {number: Outcome.FAIL}
    assert outcomes(scene, DEFECTS[number], wanted) == expected


def test_what_nobody_does_is_skipped(scene):
    checks = accept(PARAMETERS, 0.6, Person(), backend=scene.backend, wanted=(3, 5, 7))
    assert {c.number: c.outcome for c in checks} == dict.fromkeys((3, 5, 7), Outcome.SKIP)


def test_a_missing_camera_fails_every_check(scene):
    scene.device.unplug()
    checks = list(accept(PARAMETERS, 0.6, Person(), backend=scene.backend))
    assert [c.number for c in checks] == list(EVERYTHING)
    assert {c.outcome for c in checks} == {Outcome.FAIL}


def test_an_empty_stretch_passes_nothing():
    found = {check.number: check.outcome for check in passive_checks(Stretch(), 20.0)}
    assert Outcome.PASS not in found.values()
    assert flashes(Stretch()) == []


def test_the_series_puts_events_in_their_milliseconds():
    stretch = Stretch()
    stretch.bins = [(5, np.array([1, 2, 0, 4])), (8, np.array([7]))]
    np.testing.assert_array_equal(stretch.series(), [[1, 2], [0, 4], [0, 0], [7, 0]])


def batch_of(time_us, origin_us, resets=1):
    """Return one event of the last pixel, and the time [us] that the stream reached with it."""
    e = Events(
        np.array([time_us - 1]), np.array([639], 'u2'), np.array([479], 'u2'), np.array([True])
    )
    decoded = DecodedBatch(e, (), NO_SAMPLES, NO_EDGES, time_us, resets)
    return CameraBatch(decoded, Origin(1000 * origin_us, 0), 1000 * (time_us + origin_us))


@pytest.mark.parametrize('resets', [1, 2])
def test_a_stretch_of_any_size_goes_on_where_the_clock_begins_anew(resets):
    stretch = Stretch((640, 480))
    stretch.add(batch_of(9_000_000, 10**9))
    stretch.add(batch_of(1_000, 10**9 + 9_500_000, resets))
    assert stretch.seconds == pytest.approx(0.501)
    assert stretch.counts[1, 479, 639] == stretch.counts.sum() == 2
    assert np.flatnonzero(stretch.series()[:, 1]).tolist() == [0, 501]
