# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gestures of the live sensor: press, pull, slide, torsion, load, drop, vibrate, release.

Each gesture is a short profile that is played at once. `TouchControl` carries out the requests of
the service `mixtac_msgs/srv/Touch`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from mixtac_core.node.parameters import build, parameter
from mixtac_sim import SimulationError
from mixtac_sim.live.virtual_sensor import VirtualSensor
from mixtac_sim.mechanics.contact import GRAVITY, Mode
from mixtac_sim.mechanics.elastomer import LIVE_INDENTERS, Indenter
from mixtac_sim.world.segments import Profile, Pulled, Segment, Tone

RAMP_S: Final = 0.2
"""Time in which an object approaches or leaves [s]."""
APART_MM: Final = 0.3
"""Distance from the skin at which a vibration starts and ends [mm]."""
MOVE_S: Final = 1.0
"""Time of a motion across the normal [s]."""
LARGEST_N: Final = 20.0
"""Largest force that may be commanded [N]; the layer's model ends about there."""
ENDLESS_S: Final = 86_400.0
"""Duration of a contact that is held until the next touch [s]."""


def _force(
    tool: Indenter,
    start_s: float,
    end_s: float,
    force_n: tuple[float, ...],
    move: tuple[float, float, float] = (0.0, 0.0, 0.0),
    pull: Pulled | None = None,
) -> Segment:
    """Return a span of a constant force, or from one force to another [N]."""
    knots = (0.0, end_s - start_s)[: len(force_n)]
    return Segment(start_s, end_s, Mode.FORCE, knots, force_n, indenter=tool, move=move, pull=pull)


def press(
    tool: Indenter, force_n: float, hold_s: float, move: tuple[float, float, float] = (0, 0, 0)
) -> Profile:
    """Return a press with a constant force, after a motion across the normal if there is one.

    Args:
        tool: The object.
        force_n: Force [N].
        hold_s: Duration of the hold, at rest [s].
        move: Motion: right and down [mm], turn from right to down [rad]; undone in the air.
    """
    rest = RAMP_S + MOVE_S * any(move)
    up, end = rest + hold_s, rest + hold_s + RAMP_S
    segments = [
        _force(tool, 0.0, RAMP_S, (0.0, force_n)),
        _force(tool, rest, up, (force_n,)),
        _force(tool, up, end, (force_n, 0.0)),
    ]
    if any(move):
        back = (-move[0], -move[1], -move[2])
        segments.insert(1, _force(tool, RAMP_S, rest, (force_n,), move))
        segments.append(Segment(end, end + RAMP_S, Mode.FREE, indenter=tool, move=back))
        end += RAMP_S
    return Profile(end, tuple(segments))


def pull(tool: Indenter, force_n: tuple[float, float], pull_n: Pulled, hold_s: float) -> Profile:
    """Return a press that a force pulls aside, as a weight on a string would; then it is let go.

    Args:
        tool: The object.
        force_n: Normal force before and after [N].
        pull_n: Force across the normal before and after [N].
        hold_s: Duration of the hold [s].
    """
    _, after = force_n
    first, last = pull_n
    rest = RAMP_S + MOVE_S * (first != last)
    up = rest + hold_s
    segments = [
        _force(tool, 0.0, RAMP_S, force_n, pull=(first, first)),
        _force(tool, rest, up, (after,), pull=(last, last)),
        _force(tool, up, up + RAMP_S, (after, 0.0)),
    ]
    if rest > RAMP_S:
        segments.insert(1, _force(tool, RAMP_S, rest, (after,), pull=pull_n))
    return Profile(up + RAMP_S, tuple(segments))


def load(tool: Indenter, hold_s: float) -> Profile:
    """Return an object that is put down gently and taken off after some time [s].

    Raises:
        SimulationError: The object has no mass.
    """
    return press(tool, 1e-3 * _mass_g(tool) * GRAVITY, hold_s)


def drop(tool: Indenter, height_mm: float, hold_s: float) -> Profile:
    """Return an object that falls from a height [mm], rests for some time [s] and is lifted.

    Raises:
        SimulationError: The object has no mass.
    """
    # An object that fell before must have left the skin.
    lift = RAMP_S + hold_s
    lift_n = 1.3e-3 * _mass_g(tool) * GRAVITY
    segments = (
        Segment(RAMP_S, lift, Mode.DROP, (0.0,), (height_mm,), indenter=tool),
        Segment(lift, lift + RAMP_S, Mode.LIFT, (0.0, RAMP_S), (0.0, lift_n), indenter=tool),
    )
    return Profile(lift + RAMP_S, segments)


def _mass_g(tool: Indenter) -> float:
    if tool.mass_g <= 0.0:
        heavy = ', '.join(name for name, each in LIVE_INDENTERS.items() if each.mass_g > 0.0)
        raise SimulationError(f'{tool} has no mass', remedy=f'choose one of {heavy}')
    return tool.mass_g


def vibrate(
    tool: Indenter, depth_mm: float, amplitude_mm: float, frequency_hz: float, hold_s: float
) -> Profile:
    """Return an object that vibrates in the skin.

    Args:
        tool: The object.
        depth_mm: Mean depth [mm].
        amplitude_mm: Zero to peak [mm].
        frequency_hz: Frequency [Hz].
        hold_s: Duration [s].

    Raises:
        SimulationError: It would leave the skin.
    """
    if amplitude_mm >= depth_mm:
        raise SimulationError(
            f'amplitude {amplitude_mm} mm at a depth of {depth_mm} mm would leave the skin',
            remedy='give a smaller amplitude or a larger depth',
        )
    tone = Tone(amplitude_mm, frequency_hz, 0.0, min(0.05, 0.25 * hold_s))
    down, up = RAMP_S, RAMP_S + hold_s
    segments = (
        Segment(0.0, down, Mode.POSITION, (0.0, RAMP_S), (-APART_MM, depth_mm), indenter=tool),
        Segment(down, up, Mode.POSITION, (0.0,), (depth_mm,), (tone,), tool),
        Segment(up, up + RAMP_S, Mode.POSITION, (0.0, RAMP_S), (depth_mm, -APART_MM), (), tool),
    )
    return Profile(up + RAMP_S, segments)


def release(tool: Indenter, from_n: float) -> Profile:
    """Return the release from a force [N]."""
    way = _force(tool, 0.0, RAMP_S, (from_n, 0.0))
    return Profile(RAMP_S, (way,) if from_n > 0.0 else ())


@dataclass(frozen=True)
class Touch:
    """A request to touch the sensor: the fields of `mixtac_msgs/srv/Touch`, with their limits.

    Attributes:
        gesture: Name of the gesture
        object: Object that touches
        force: Normal force
        hold: Duration at rest; 0 holds until the next touch
        pull: Force across the normal
        pull_direction: Direction of the pull in the image: 0 to the right, 90 upwards
        distance: Slide to the right
        angle: Turn about the normal
        height: Height of a drop
        depth: Mean depth of a vibration
        amplitude: Amplitude of a vibration, zero to peak
        frequency: Frequency of a vibration
    """

    gesture: str = parameter(
        'release',
        choices=('press', 'pull', 'slide', 'torsion', 'load', 'drop', 'vibrate', 'release'),
    )
    object: str = parameter('hemisphere', choices=tuple(LIVE_INDENTERS))
    force: float = parameter(0.5, unit='N', within=(0.0, LARGEST_N))
    hold: float = parameter(2.0, unit='s', within=(0.0, 3600.0))
    pull: float = parameter(0.2, unit='N', within=(0.0, LARGEST_N))
    pull_direction: float = parameter(0.0, unit='deg', within=(-180.0, 180.0))
    distance: float = parameter(2.0, unit='mm', within=(-5.0, 5.0))
    angle: float = parameter(20.0, unit='deg', within=(-90.0, 90.0))
    height: float = parameter(50.0, unit='mm', within=(0.0, 200.0))
    depth: float = parameter(0.3, unit='mm', within=(0.01, 1.5))
    amplitude: float = parameter(0.05, unit='mm', within=(0.0, 1.0))
    frequency: float = parameter(100.0, unit='Hz', within=(1.0, 500.0))

    @property
    def tool(self) -> Indenter:
        """Return the object."""
        return LIVE_INDENTERS[self.object]

    @property
    def hold_s(self) -> float:
        """Return the duration at rest [s]."""
        return self.hold or ENDLESS_S


_PROFILES: Final[Mapping[str, Callable[[Touch], Profile]]] = MappingProxyType(
    {
        'press': lambda t: press(t.tool, t.force, t.hold_s),
        'slide': lambda t: press(t.tool, t.force, t.hold_s, (t.distance, 0.0, 0.0)),
        'torsion': lambda t: press(t.tool, t.force, t.hold_s, (0.0, 0.0, math.radians(t.angle))),
        'load': lambda t: load(t.tool, t.hold_s),
        'drop': lambda t: drop(t.tool, t.height, t.hold_s),
        'vibrate': lambda t: vibrate(t.tool, t.depth, t.amplitude, t.frequency, t.hold_s),
    }
)
"""Gestures that do not depend on the touch before them."""


class TouchControl:
    """Carries out touches.

    Args:
        sensor: The live sensor.
    """

    def __init__(self, sensor: VirtualSensor) -> None:
        self._sensor = sensor

    def touch(self, **request: object) -> str:
        """Touch the sensor; return a description for the user.

        Args:
            **request: Fields of `Touch`; those that are absent have their defaults.

        Raises:
            MixtacError: A value is not allowed, or the gesture is not possible with it.
        """
        touch = build(Touch, request)
        if touch.gesture == 'release':
            force_n, tool = self._sensor.commanded_force()
            self._sensor.play(release(tool or touch.tool, force_n))
            return 'released'
        make = self._pull if touch.gesture == 'pull' else _PROFILES[touch.gesture]
        self._sensor.play(make(touch))
        length = f'for {touch.hold:g} s' if touch.hold else 'until the next touch'
        return f'{touch.gesture}: {touch.object} {length}'

    def _pull(self, touch: Touch) -> Profile:
        """Return a pull that continues a press or pull of the same object."""
        angle = math.radians(touch.pull_direction)
        force_n, tool = self._sensor.commanded_force()
        same = tool == touch.tool
        before = self._sensor.commanded_pull() if same else (0.0, 0.0)
        # Upwards in the image is against the rows.
        after = (touch.pull * math.cos(angle), -touch.pull * math.sin(angle))
        forces = (force_n if same else 0.0, touch.force)
        return pull(touch.tool, forces, (before, after), touch.hold_s)
