# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The force stays below its ceiling for every stiffness, delay and arm, however long it slips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mixtac_events.arrays import Events
from mixtac_slip_control.arm.kinematics import SerialArm
from mixtac_slip_control.arm.limits import JointLimits
from mixtac_slip_control.arm.planner import AdvancePlanner
from mixtac_slip_control.controller import SlipController
from mixtac_slip_control.parameters import SlipControlParameters
from mixtac_slip_control.safety import InterlockState

READY = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
SIDEWAYS = (0.0, 1.0, 0.0)
CEILING_N = 1.5
LEARNED_MS = 130
PLANNER = AdvancePlanner(SerialArm.fr3(), JointLimits.fr3())


class Contact:
    """A contact that the arm presses: F = F_0 + k x, or stiffening as under a sphere."""

    def __init__(self, preload: float, n_per_mm: float, lag_s: float, *, sphere: bool) -> None:
        self.preload, self.stiffness, self.sphere = preload, 1e3 * n_per_mm, sphere
        self.keep = np.exp(-1e-3 / lag_s) if lag_s > 0.0 else 0.0
        self.place = 0.0

    def follow(self, command: float) -> float:
        """Go on by 1 ms and return the force."""
        self.place = command + self.keep * (self.place - command)
        if not self.sphere:
            return self.preload + self.stiffness * self.place
        # Hertz: F ~ depth^1.5, with the given stiffness at the ceiling.
        softer = self.stiffness * (self.preload / CEILING_N) ** (1.0 / 3.0)
        depth = 1.5 * self.preload / softer
        return float(self.preload * max(1.0 + self.place / depth, 0.0) ** 1.5)


def events(ms: int, count: int) -> Events:
    place = np.zeros(count, np.uint16)
    t = 1000 * ms + np.arange(count) * 1000 // max(count, 1)
    return Events(t.astype(np.int64), place, place, np.ones(count, np.bool_))


def peak_force(
    contact: Contact,
    delay_ms: int,
    slip_ms: int,
    seed: int,
    *,
    probe: bool,
    gain: float = 1.0,
    share: float = 0.0,
) -> tuple[float, SlipController]:
    """Return the largest force of a run in which slip, once begun, never ends."""
    chosen = SlipControlParameters(
        detector='count',
        learning_time=0.1,
        settle_time=0.005,
        gain=0.7,
        memory_time=0.0,
        max_step=5e-5,
        probe_advance=5e-5 if probe else 0.0,
    )
    PLANNER.reset(READY, np.array(SIDEWAYS))
    controller = SlipController(chosen, PLANNER, SIDEWAYS)
    rng = np.random.default_rng(seed)
    forces: list[float] = []
    for ms in range(LEARNED_MS + slip_ms + 100):
        now = 100.0 + 1e-3 * (ms + 1)
        # What is sent becomes a command after its lead, which the planner's own times hold.
        forces.append(contact.follow(PLANNER.advance_at(now - 1e-3) if controller.enabled else 0.0))
        controller.on_heartbeat(now)
        path, at = PLANNER.path, contact.place if controller.enabled else 0.0
        q = READY if path is None else path.derivatives(at)[0]
        controller.on_joint_state(q.tolist(), now)
        if ms >= delay_ms and ms % 2 == 0:
            force = gain * forces[ms - delay_ms] + float(rng.normal(0.0, 0.03))
            stamp_us = 1000 * (ms + 1 - delay_ms)
            controller.on_force(force, stamp_us, now, deviation=share * abs(force))
        slips = ms >= LEARNED_MS + slip_ms
        count = 4000 if slips else int(rng.poisson(30))
        controller.on_events(events(ms, count), 1000 * (ms + 1), now)
        controller.plan(now)
        if ms == LEARNED_MS:
            controller.enable(now)
    return max(forces), controller


@settings(derandomize=True, max_examples=10)
@given(
    st.floats(0.5, 20.0),
    st.integers(0, 20),
    st.floats(0.3, 1.0),
    st.sampled_from([0.0, 3.5e-3, 6e-3]),
    st.integers(1, 250),
    st.booleans(),
    st.booleans(),
    st.integers(0, 1000),
)
@example(20.0, 20, 1.0, 6e-3, 250, False, True, 0)
@example(20.0, 20, 0.3, 6e-3, 20, True, True, 1)
@example(0.5, 20, 0.3, 0.0, 20, False, False, 2)
def test_the_ceiling_is_never_reached(
    n_per_mm: float,
    delay_ms: int,
    preload: float,
    lag_s: float,
    slip_ms: int,
    sphere: bool,
    probe: bool,
    seed: int,
) -> None:
    contact = Contact(preload, n_per_mm, lag_s, sphere=sphere)
    peak, controller = peak_force(contact, delay_ms, slip_ms, seed, probe=probe)
    assert peak <= CEILING_N
    # Near the ceiling the noise of the force may stop it; nothing else may.
    stopped = controller.interlock.state is not InterlockState.ENABLED
    assert not stopped or peak > CEILING_N - 0.15


@pytest.mark.parametrize('n_per_mm', [1.0, 5.0, 10.0])
@pytest.mark.parametrize('sphere', [False, True])
def test_a_sensor_that_tells_too_little_does_not_lead_above_it(
    n_per_mm: float, *, sphere: bool
) -> None:
    contact = Contact(0.6, n_per_mm, 3.5e-3, sphere=sphere)
    deviation = 0.14
    wrong = {'gain': 1.0 / (1.0 + 2.5 * deviation), 'share': deviation}
    peak, controller = peak_force(contact, 3, 2000, 0, probe=True, **wrong)
    assert 0.9 <= peak <= CEILING_N
    assert controller.interlock.state is InterlockState.ENABLED


@pytest.mark.parametrize('n_per_mm', [2.0, 5.0, 10.0])
def test_after_probing_most_of_the_room_is_used(n_per_mm: float) -> None:
    contact = Contact(0.6, n_per_mm, 3.5e-3, sphere=False)
    peak, controller = peak_force(contact, 3, 250, 0, probe=True)
    assert not controller.probing
    assert 1.05 <= peak <= CEILING_N
    assert controller.stiffness == pytest.approx(1e3 * n_per_mm, rel=0.2)
