# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Commands for a gripper."""

from __future__ import annotations

import pytest

from mixtac_slip_control.gripper import FASTEST, GripperGoal
from mixtac_slip_control.parameters import SlipControlParameters

STEP_US = 50_000


class Grasp:
    """A grasp that asks its gripper every 50 ms."""

    def __init__(self, kind: str, force: float | None = 0.5) -> None:
        self.goal, self.us, self.force = GripperGoal(), 0, force
        self.parameters = SlipControlParameters(gripper=kind)

    def ask(self, *, slipping: bool = False, trusted: bool = True) -> float | None:
        self.us += STEP_US
        given = self.us, self.force, self.parameters
        return self.goal.update(*given, slipping=slipping, trusted=trusted)

    def settled(self) -> Grasp:
        for _ in range(12):
            self.ask()
        return self


def test_the_force_is_the_margin_over_that_of_the_grasp_and_a_slip_raises_it() -> None:
    grasp = Grasp('force').settled()
    assert grasp.ask() == pytest.approx(1.3 * 0.5)
    # The force that follows the command does not raise it further.
    grasp.force = 0.65
    assert grasp.ask() == pytest.approx(1.3 * 0.5)
    assert grasp.ask(slipping=True) == pytest.approx(1.0)
    assert grasp.ask() == pytest.approx(1.0)


def test_the_force_never_exceeds_the_usable_share() -> None:
    grasp = Grasp('force', 1.2).settled()
    assert grasp.ask(slipping=True) == pytest.approx(grasp.parameters.usable_force)


def test_a_speed_closes_until_the_force_is_reached() -> None:
    grasp = Grasp('speed').settled()
    assert 0.0 < grasp.ask() <= FASTEST
    grasp.force = 0.65
    assert grasp.ask() == 0.0


def test_a_slip_between_two_commands_counts() -> None:
    grasp = Grasp('force').settled()
    grasp.us += 10_000
    between = grasp.us, 0.5, grasp.parameters
    assert grasp.goal.update(*between, slipping=True, trusted=True) is None
    grasp.us -= 10_000
    assert grasp.ask() == pytest.approx(1.0)


@pytest.mark.parametrize(('kind', 'expected'), [('force', None), ('speed', 0.0)])
def test_a_force_that_cannot_be_trusted_closes_nothing(kind: str, expected: float | None) -> None:
    grasp = Grasp(kind).settled()
    assert grasp.ask(trusted=False) == expected
    assert Grasp(kind, None).ask() == expected


def test_a_released_object_is_forgotten() -> None:
    grasp = Grasp('force').settled()
    grasp.ask(slipping=True)
    grasp.force = 0.0
    assert grasp.ask() is None
    grasp.force = 0.3
    assert grasp.settled().ask() == pytest.approx(1.3 * 0.3)
