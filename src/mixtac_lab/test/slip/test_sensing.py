# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The sensor's own force in a grasp: reference of before, gains of another day."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_lab.slip.sensing import PULLS_S, pulled_gain
from mixtac_lab.slip.trials import TrialPlan
from mixtac_sim.world.profiles import make_profile

PLAN = TrialPlan('box', 4, margin=1.3, preset='easy')


def test_frames_of_before_show_no_contact_and_other_noise() -> None:
    grasp = PLAN.grasp(camera=True)
    free = [frame.intensity.astype(np.float64) for frame in grasp.free_frames(3)]
    held = grasp.advance(np.zeros(800)).frames
    assert len(free) == 3
    between = np.abs(free[2] - free[1]).mean()
    assert between > 0.0
    assert np.abs(held[0].intensity - free[0]).mean() > 1.5 * between


def test_the_gain_is_that_of_the_masses_that_pull() -> None:
    profile = make_profile('pulls', 1, PULLS_S)
    count = round(PULLS_S * 500)
    motion, (_, force, _) = profile.motion(0, 16 * count), profile.commands(0, 16 * count)
    known = np.nan_to_num(motion[15::16, 5:]) * (1.0, -1.0)
    fit = pulled_gain(2e-3 * np.arange(count), force[15::16] / 0.7, known / 1.6)
    assert fit.gain == pytest.approx(1.6, rel=1e-3)
