# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The emulated joint_trajectory_controller against splines of SciPy and its documented rules."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.interpolate import BPoly

from mixtac_sim.arm import JointTrajectoryController, Trajectory

RATE_HZ = 1000.0


def _random(rng: np.random.Generator, order: int, stamp_s: float) -> Trajectory:
    count = 6
    times = np.cumsum(rng.uniform(2e-3, 9e-3, count))
    q, dq, ddq = (rng.normal(0.0, scale, (count, 7)) for scale in (0.1, 1.0, 10.0))
    dq[-1] = 0.0
    return Trajectory(stamp_s, times, q, dq if order > 1 else None, ddq if order == 5 else None)


def _oracle(trajectory: Trajectory, order: int) -> BPoly:
    columns = [trajectory.q, trajectory.dq, trajectory.ddq][: (order + 1) // 2]
    states = np.stack([c for c in columns if c is not None], axis=1)
    return BPoly.from_derivatives(trajectory.stamp_s + trajectory.times_s, list(states))


@pytest.mark.parametrize('order', [1, 3, 5])
def test_segments_are_the_splines_that_the_fields_determine(order: int) -> None:
    rng = np.random.default_rng(order)
    trajectory = _random(rng, order, 2.0)
    controller = JointTrajectoryController(RATE_HZ, release='humble')
    controller.reset(np.zeros(7), 1.999)
    assert controller.accept(trajectory, 1.999) is None
    spline = _oracle(trajectory, order)
    start, end = 2.0 + trajectory.times_s[0], 2.0 + trajectory.times_s[-1]
    for k in range(1, int((end - 1.999) * RATE_HZ)):
        t = 1.999 + k / RATE_HZ
        q, dq, ddq = controller.sample(t)
        if t > start + 1e-6:
            assert q == pytest.approx(spline(t), abs=1e-9)
            assert dq == pytest.approx(spline(t, 1), abs=1e-6)
            assert ddq == pytest.approx(spline(t, 2), abs=1e-3)


FRESH = """
import numpy as np
from mixtac_sim.arm import JointTrajectoryController, Trajectory, interpolate, warm_up
warm_up()
compiled = interpolate.signatures
rest = np.zeros((2, 7))
for fields in ((rest, None, None), (rest, rest, None), (rest, rest, rest)):
    controller = JointTrajectoryController()
    controller.accept(Trajectory(0.0, np.array([0.01, 0.02]), *fields), 0.0)
    for k in range(30):
        controller.sample(1e-3 * k)
assert interpolate.signatures == compiled
"""


def test_no_trajectory_compiles_after_the_warm_up() -> None:
    subprocess.run([sys.executable, '-c', FRESH], check=True, timeout=240.0)


def test_jazzy_is_one_period_ahead_of_humble() -> None:
    trajectory = _random(np.random.default_rng(0), 5, 1.0)
    commands = []
    for release in ('humble', 'jazzy'):
        controller = JointTrajectoryController(RATE_HZ, release=release)  # type: ignore[arg-type]
        controller.reset(np.zeros(7), 0.995)
        controller.accept(trajectory, 0.995)
        commands.append([controller.sample(0.995 + 1e-3 * k)[0] for k in range(40)])
    assert np.array(commands[0][11:]) == pytest.approx(np.array(commands[1][10:-1]))


def test_before_the_first_point_the_motion_starts_from_the_last_command() -> None:
    controller = JointTrajectoryController(RATE_HZ)
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
    controller = JointTrajectoryController(RATE_HZ, release='humble')
    controller.reset(np.zeros(7), 5.0)
    controller.sample(5.0004)
    controller.accept(Trajectory(0.0, np.array([0.010]), np.ones((1, 7))), 5.0004)
    assert controller.sample(5.006)[0] == pytest.approx(np.full(7, 0.5))
    assert controller.sample(5.011)[0] == pytest.approx(np.ones(7))


def test_a_new_message_replaces_the_one_before() -> None:
    controller = JointTrajectoryController(RATE_HZ)
    controller.reset(np.zeros(7), 0.001)
    controller.accept(Trajectory(0.01, np.array([0.02]), np.ones((1, 7))), 0.002)
    controller.sample(0.015)
    controller.accept(Trajectory(0.02, np.array([0.02]), -np.ones((1, 7))), 0.015)
    assert controller.sample(0.05)[0] == pytest.approx(-np.ones(7))


@pytest.mark.parametrize(
    ('trajectory', 'reason'),
    [
        (Trajectory(1.0, np.empty(0), np.empty((0, 7))), 'empty'),
        (Trajectory(1.0, np.array([0.1]), np.zeros((1, 6))), 'shape'),
        (Trajectory(1.0, np.array([0.1, 0.1]), np.zeros((2, 7))), 'increase'),
        (Trajectory(1.0, np.array([0.1]), np.zeros((1, 7))), 'past'),
        (Trajectory(2.0, np.array([0.1]), np.zeros((1, 7)), np.ones((1, 7))), 'not zero'),
    ],
)
def test_rejects_what_the_controller_rejects(trajectory: Trajectory, reason: str) -> None:
    controller = JointTrajectoryController(RATE_HZ)
    refused = controller.accept(trajectory, 1.5)
    assert refused is not None
    assert reason in refused
