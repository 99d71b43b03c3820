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

from mixtac_driver.doctor.acceptance import (
    CHECKS,
    PASSIVE,
    Outcome,
    Person,
    Stretch,
    accept,
    flashes,
    passive_checks,
)
from mixtac_driver.parameters import DriverParameters
from mixtac_sim.usb.faults import Fault, FaultKind
from mixtac_sim.usb.pyusb_backend import in_process_backend

pytestmark = pytest.mark.live
STILL_S = 2.0
EVERYTHING = tuple(range(1, len(CHECKS) + 1))
DEFECTS = {
    1: Fault(FaultKind.CLOCK_SKEW, amount=3000.0),
    2: Fault(FaultKind.LOST_WRAP, size=60, count=1),
    3: Fault(FaultKind.LOST_EDGES, size=5),
    4: Fault(FaultKind.STUCK_BIASES),
    5: Fault(FaultKind.MUTE_RETURN),
    6: Fault(FaultKind.NOISE, amount=9.0),
    7: Fault(FaultKind.LATE_STAMPS, delay=0.008),
    8: Fault(FaultKind.BLUR, amount=4.0),
    9: Fault(FaultKind.RIPPLE, amount=100.0),
    10: Fault(FaultKind.HEAT, amount=45.0),
}


def outcomes(defect, wanted):
    """Return the outcome of each check of a virtual camera with a defect."""
    scene = RestingScene()
    try:
        if defect is not None:
            scene.device.inject(defect)
        checks = list(
            accept(
                DriverParameters(device='virtual'),
                STILL_S,
                scene.person(),
                backend=in_process_backend(scene.device),
                wanted=wanted,
            )
        )
    finally:
        scene.close()
    for check in checks:
        print(check)
    return {check.number: check.outcome for check in checks}


def test_a_sound_camera_passes_every_check():
    assert outcomes(None, EVERYTHING) == dict.fromkeys(EVERYTHING, Outcome.PASS)


@pytest.mark.parametrize('number', DEFECTS)
def test_each_defect_fails_its_own_check_and_no_other(number):
    full = os.environ.get('MIXTAC_ACCEPTANCE_FULL')
    wanted = EVERYTHING if full else tuple(sorted({number, *PASSIVE}))
    expected = dict.fromkeys(wanted, Outcome.PASS) | {number: Outcome.FAIL}
    assert outcomes(DEFECTS[number], wanted) == expected


def test_what_nobody_does_is_skipped():
    scene = RestingScene()
    backend = in_process_backend(scene.device)
    checks = accept(DriverParameters(), 0.6, Person(), backend=backend, wanted=(3, 5, 7))
    assert {c.number: c.outcome for c in checks} == dict.fromkeys((3, 5, 7), Outcome.SKIP)
    scene.close()


def test_a_missing_camera_fails_every_check():
    scene = RestingScene()
    scene.device.unplug()
    checks = list(
        accept(DriverParameters(), 0.6, Person(), backend=in_process_backend(scene.device))
    )
    assert [c.number for c in checks] == list(EVERYTHING)
    assert {c.outcome for c in checks} == {Outcome.FAIL}
    scene.close()


def test_an_empty_stretch_passes_nothing():
    found = {check.number: check.outcome for check in passive_checks(Stretch(), 20.0)}
    assert Outcome.PASS not in found.values()
    assert flashes(Stretch()) == []


def test_the_series_puts_events_in_their_milliseconds():
    stretch = Stretch()
    stretch.bins = [(5, np.array([1, 2, 0, 4])), (8, np.array([7]))]
    np.testing.assert_array_equal(stretch.series(), [[1, 2], [0, 4], [0, 0], [7, 0]])
