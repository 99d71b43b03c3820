# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm's geometry against numbers worked out by hand, and its limits."""

import numpy as np
import pytest

from mixtac_sim import SimulationError
from mixtac_sim.arm import READY, LaggingArm, flange_place, violations


def test_flange_of_the_ready_pose() -> None:
    # In the arm's plane (out, up): the upper arm leans back by 45 deg, its elbow offset is square
    # to it; the forearm lies level, and the flange hangs straight down from the wrist.
    s = np.sqrt(0.5)
    elbow = np.array([0.0, 0.333]) + 0.316 * np.array([-s, s]) + 0.0825 * np.array([s, s])
    flange = elbow + np.array([0.384 + 0.088, 0.0825]) - np.array([0.0, 0.107])
    assert flange_place(READY) == pytest.approx([flange[0], 0.0, flange[1]], abs=1e-12)


def test_straight_up_the_lengths_add() -> None:
    q = np.zeros(7)
    place = flange_place(q)
    assert place == pytest.approx([0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107], abs=1e-12)


def test_the_first_joint_turns_the_flange_about_the_column() -> None:
    turned = READY + np.array([0.7, 0, 0, 0, 0, 0, 0])
    x, y, z = flange_place(READY)
    assert flange_place(turned) == pytest.approx([x * np.cos(0.7), x * np.sin(0.7), z])
    assert y == pytest.approx(0.0, abs=1e-12)


def test_a_motion_within_limits_has_no_violations_and_a_jump_has() -> None:
    t = np.arange(200) * 1e-3
    slow = READY + 1e-3 * np.sin(2 * np.pi * 2 * t)[:, None]
    assert violations(slow, 1e-3) == 0
    slow[100:] += 1e-4
    assert violations(slow, 1e-3) > 0


def test_fingertip_follows_with_the_lag() -> None:
    normal = np.array([0.0, 1.0, 0.0])
    tip = LaggingArm(READY, normal, 5e-3)
    target = READY + np.array([1e-3, 0, 0, 0, 0, 0, 0])
    way = np.concatenate([tip.follow(target, 4) for _ in range(5)])
    full = 1e3 * (flange_place(target) - flange_place(READY)) @ normal
    assert way[-1] == pytest.approx(full * (1 - np.exp(-1.0)), rel=1e-3)
    assert np.all(np.diff(way) > 0)


def test_no_negative_lag() -> None:
    with pytest.raises(SimulationError):
        LaggingArm(READY, np.array([0.0, 1.0, 0.0]), -1e-3)
