# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What users may do to the live sensor, on request: press, put down, drop, vibrate, release."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Protocol

from mixtac_sim import live_gestures
from mixtac_sim.errors import SimulationError
from mixtac_sim.live_objects import OBJECTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from mixtac_sim.indenter import Indenter
    from mixtac_sim.segments import Profile
    from mixtac_sim.touch_parameters import TouchParameters

LARGEST_N: Final = 20.0
"""Largest force that may be commanded [N]; the layer's model ends about there."""
ENDLESS_S: Final = 86_400.0
"""How long something is held that is held until released [s]."""


class Touchable(Protocol):
    """What is needed of `mixtac_sim.virtual_sensor.VirtualSensor`."""

    def play(self, scenario: Profile) -> int:
        """Play a scenario as soon as possible."""

    def commanded_force(self) -> tuple[float, Indenter | None]:
        """Return the force [N] in force when a scenario would begin now, and of what."""


class TouchControl:
    """Carries out requests with the settings of the moment.

    Args:
        sensor: The live sensor.
    """

    def __init__(self, sensor: Touchable) -> None:
        self._sensor = sensor
        self.gestures: dict[str, Callable[[TouchParameters], str]] = {
            'press': self.press,
            'load': self.load,
            'drop': self.drop,
            'vibrate': self.vibrate,
            'release': self.release,
        }

    def press(self, p: TouchParameters) -> str:
        """Press the object on the skin; return what is done, for people."""
        self._sensor.play(live_gestures.press(OBJECTS[p.object], p.press_force, _hold_s(p)))
        return f'pressing {p.object} with {p.press_force} N {_for(p)}'

    def load(self, p: TouchParameters) -> str:
        """Put the object down; return what is done.

        Raises:
            SimulationError: The object has no mass.
        """
        self._sensor.play(live_gestures.load(OBJECTS[p.object], _hold_s(p)))
        return f'putting {p.object} down {_for(p)}'

    def drop(self, p: TouchParameters) -> str:
        """Drop the object; return what is done.

        Raises:
            SimulationError: The object has no mass.
        """
        self._sensor.play(live_gestures.drop(OBJECTS[p.object], p.drop_height, _hold_s(p)))
        return f'dropping {p.object} from {p.drop_height} mm'

    def vibrate(self, p: TouchParameters) -> str:
        """Let the object vibrate in the skin; return what is done.

        Raises:
            SimulationError: It would leave the skin.
        """
        gesture = live_gestures.vibrate(
            OBJECTS[p.object],
            p.vibration_depth,
            p.vibration_amplitude,
            p.vibration_frequency,
            _hold_s(p),
        )
        self._sensor.play(gesture)
        return f'vibrating {p.object} at {p.vibration_frequency} Hz {_for(p)}'

    def release(self, p: TouchParameters) -> str:
        """Take off what touches; return what is done."""
        force_n, tool = self._sensor.commanded_force()
        self._sensor.play(live_gestures.release(tool or OBJECTS[p.object], force_n))
        return 'released'

    def follow(self, p: TouchParameters, force_n: float) -> None:
        """Press the object with a force [N] until the next one is commanded, for a moment at most.

        Raises:
            SimulationError: The force is not a number, or out of range.
        """
        if not math.isfinite(force_n) or not 0.0 <= force_n <= LARGEST_N:
            raise SimulationError(f'commanded force {force_n} N: 0 to {LARGEST_N} N are possible')
        wanted = OBJECTS[p.object]
        before_n, tool = self._sensor.commanded_force()
        start_n = before_n if tool == wanted else 0.0
        self._sensor.play(live_gestures.follow(wanted, start_n, force_n))


def _hold_s(p: TouchParameters) -> float:
    return p.hold_seconds or ENDLESS_S


def _for(p: TouchParameters) -> str:
    return f'for {p.hold_seconds} s' if p.hold_seconds else 'until released'
