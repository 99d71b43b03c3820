# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm's geometry, its limits, and the emulated joint_trajectory_controller."""

import numpy as np
import pytest
from scipy.interpolate import BPoly

from mixtac_sim.arm import (
    READY,
    JointTrajectoryController,
    LaggingArm,
    Trajectory,
    flange_place,
    violations,
)


def test_flange_of_the_ready_pose() -> None:
    # In the arm's plane (out, up): the upper arm leans back by 45 deg, its elbow offset is square
    # to it; the forearm lies level, and the flange hangs straight down from the wrist.
    s = np.sqrt(0.5)
    elbow = np.array([0.0, 0.333]) + 0.316 * np.array([-s, s]) + 0.0825 * np.array([s, s])
    flange = elbow + np.array([0.384 + 0.088, 0.0825]) - np.array([0.0, 0.107])
    assert flange_place(READY) == pytest.approx([flange[0], 0.0, flange[1]], abs=1e-12)


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


RATE_HZ = 1000.0


def _goal(stamp_s: float, after_s: float, place: float, joints: int = 7) -> Trajectory:
    """Return a trajectory of one point, at rest."""
    rest = np.zeros((1, joints))
    return Trajectory(stamp_s, np.array([after_s]), rest + place, rest, rest)


def test_segments_are_the_splines_that_the_fields_determine() -> None:
    rng = np.random.default_rng(5)
    count = 6
    times = np.cumsum(rng.uniform(2e-3, 9e-3, count))
    q, dq, ddq = (rng.normal(0.0, scale, (count, 7)) for scale in (0.1, 1.0, 10.0))
    dq[-1] = 0.0
    spline = BPoly.from_derivatives(2.0 + times, list(np.stack([q, dq, ddq], axis=1)))
    controller = JointTrajectoryController()
    controller.reset(np.zeros(7), 1.999)
    assert controller.accept(Trajectory(2.0, times, q, dq, ddq), 1.999) is None
    for k in range(1, int((times[-1] + 1e-3) * RATE_HZ)):
        position, speed, acceleration = controller.sample(1.999 + k / RATE_HZ)
        # The command is that of the next cycle.
        t = 1.999 + (k + 1) / RATE_HZ
        if 2.0 + times[0] + 1e-6 < t < 2.0 + times[-1]:
            assert position == pytest.approx(spline(t), abs=1e-9)
            assert speed == pytest.approx(spline(t, 1), abs=1e-6)
            assert acceleration == pytest.approx(spline(t, 2), abs=1e-3)


def test_before_the_first_point_the_motion_starts_from_the_last_command() -> None:
    controller = JointTrajectoryController()
    q0 = np.linspace(-1.0, 1.0, 7)
    controller.reset(q0, 1.0)
    assert controller.sample(1.010)[0] == pytest.approx(q0)
    goal = Trajectory(
        1.02, np.array([0.0, 0.01]), np.tile(q0 + 0.1, (2, 1)), np.zeros((2, 7)), np.zeros((2, 7))
    )
    controller.accept(goal, 1.010)
    path = np.array([controller.sample(1.011 + 1e-3 * k)[0] for k in range(20)])
    assert path[0] == pytest.approx(q0, abs=0.1)
    assert np.all(np.diff(path, axis=0) >= -1e-12)
    assert path[-1] == pytest.approx(q0 + 0.1)


def test_a_stamp_of_zero_starts_at_the_first_cycle_that_sees_it() -> None:
    controller = JointTrajectoryController()
    controller.reset(np.zeros(7), 5.0)
    controller.sample(5.0004)
    controller.accept(_goal(0.0, 0.010, 1.0), 5.0004)
    assert np.all(controller.sample(5.006)[0] < 0.9)
    assert controller.sample(5.011)[0] == pytest.approx(np.ones(7))


def test_a_new_message_replaces_the_one_before() -> None:
    controller = JointTrajectoryController()
    controller.reset(np.zeros(7), 0.001)
    controller.accept(_goal(0.01, 0.02, 1.0), 0.002)
    controller.sample(0.015)
    controller.accept(_goal(0.02, 0.02, -1.0), 0.015)
    assert controller.sample(0.05)[0] == pytest.approx(-np.ones(7))


@pytest.mark.parametrize(
    ('trajectory', 'reason'),
    [
        (Trajectory(1.0, np.empty(0), *np.empty((3, 0, 7))), 'empty'),
        (_goal(1.0, 0.1, 0.0, joints=6), 'shape'),
        (Trajectory(1.0, np.array([0.1, 0.1]), *np.zeros((3, 2, 7))), 'increase'),
        (_goal(1.0, 0.1, 0.0), 'past'),
        (Trajectory(2.0, np.array([0.1]), *np.ones((3, 1, 7))), 'not zero'),
    ],
)
def test_rejects_what_the_controller_rejects(trajectory: Trajectory, reason: str) -> None:
    controller = JointTrajectoryController()
    refused = controller.accept(trajectory, 1.5)
    assert refused is not None
    assert reason in refused
