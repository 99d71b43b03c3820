# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which impulse of one recording is which of the other, with nothing known about the clocks.

`prefer_isolated` first leaves out impulses without stillness on both sides: a deliberate tap has
it, a bouncing load has not. Every two impulses of one recording laid over two of the other then
propose a map, if the time between them agrees within the drift that clocks may have. The map under
which most impulses meet wins.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np

from mixtac_alignment.errors import AmbiguousImpulsesError, NoImpulseError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_alignment.impulses import Impulse, ImpulseSettings


QUIET_S: Final = 0.3
"""How long before and after a tap nothing may happen [s]."""
IMPULSE_S: Final = 0.08
"""Time around an impulse that belongs to it [s]."""
DISTURBANCE_SHARE: Final = 0.25
"""What counts as something happening: this part of the impulse's own height."""


def prefer_isolated(
    impulses: list[Impulse], time_s: NDArray[np.float64], signal: NDArray[np.float64]
) -> list[Impulse]:
    """Return the isolated impulses, or all where fewer than two are isolated.

    Args:
        impulses: Impulses found in a signal.
        time_s: Times of the signal [s], increasing, on the impulses' clock.
        signal: What the impulses stand out of: event rate or force, in any unit.
    """
    height = np.abs(signal - np.median(signal))
    chosen = [impulse for impulse in impulses if _is_isolated(impulse.time_s, time_s, height)]
    return chosen if len(chosen) >= 2 else impulses


def _is_isolated(at_s: float, time_s: NDArray[np.float64], height: NDArray[np.float64]) -> bool:
    far, left, right, end = np.searchsorted(
        time_s, (at_s - QUIET_S, at_s - IMPULSE_S, at_s + IMPULSE_S, at_s + QUIET_S)
    )
    own = height[left:right]
    around = np.concatenate([height[far:left], height[right:end]])
    if not len(own) or not len(around):
        return False
    return bool(around.max() < DISTURBANCE_SHARE * own.max())


MOST_IMPULSES: Final = 24
"""Impulses of each recording that are tried, the strongest ones."""
RIVAL: Final = 0.8
"""A second map that explains this part of what the best explains makes the answer ambiguous."""


@dataclass(frozen=True, slots=True)
class ImpulsePair:
    """The same impulse in both recordings.

    Attributes:
        camera: In the events, camera clock.
        reference: In the force, reference clock.
        weight: How strong it is in both, 0 to 1.
    """

    camera: Impulse
    reference: Impulse
    weight: float


@dataclass(frozen=True, slots=True)
class _Match:
    offset_s: float
    score: float
    pairs: tuple[ImpulsePair, ...]


def pair_impulses(
    camera: list[Impulse], reference: list[Impulse], settings: ImpulseSettings
) -> tuple[ImpulsePair, ...]:
    """Pair the impulses of both recordings.

    Args:
        camera: Impulses in the events, at least two.
        reference: Impulses in the force, at least two.
        settings: Limits of clocks and of the agreement of pairs.

    Returns:
        At least two pairs in the order of time.

    Raises:
        NoImpulseError: No two impulses agree.
        AmbiguousImpulsesError: Two different maps fit about as well.
    """
    events, forces = _leading(camera), _leading(reference)
    matches = [
        _match(e, f, events, forces, settings)
        for e in combinations(events, 2)
        for f in combinations(forces, 2)
        if _agree(e, f, settings)
    ]
    if not matches:
        raise NoImpulseError(
            f'{len(camera)} impulses in the events and {len(reference)} in the force, but no two '
            'with the same time between them: record both over the same two taps'
        )
    best = max(matches, key=lambda match: match.score)
    _require_no_rival(best, matches, settings)
    return best.pairs


def _leading(impulses: list[Impulse]) -> list[Impulse]:
    chosen = sorted(impulses, key=lambda i: -i.strength)[:MOST_IMPULSES]
    return sorted(chosen, key=lambda i: i.time_s)


def _agree(
    e: tuple[Impulse, Impulse], f: tuple[Impulse, Impulse], settings: ImpulseSettings
) -> bool:
    span = e[1].time_s - e[0].time_s
    std = np.sqrt(sum(impulse.std_s**2 for impulse in (*e, *f)))
    difference = abs(f[1].time_s - f[0].time_s - span)
    return bool(difference <= settings.max_drift * span + max(settings.match_s, 3.0 * std))


def _match(
    e: tuple[Impulse, Impulse],
    f: tuple[Impulse, Impulse],
    events: list[Impulse],
    forces: list[Impulse],
    settings: ImpulseSettings,
) -> _Match:
    """Return what the map through two impulses explains."""
    rate = (f[1].time_s - f[0].time_s) / (e[1].time_s - e[0].time_s)
    expected = [f[0].time_s + rate * (impulse.time_s - e[0].time_s) for impulse in events]
    times = np.array([impulse.time_s for impulse in forces])
    pairs = []
    for impulse, at in zip(events, expected, strict=True):
        nearest = int(np.argmin(np.abs(times - at)))
        if abs(times[nearest] - at) <= settings.match_s:
            weight = _weight(impulse, events) * _weight(forces[nearest], forces)
            pairs.append(ImpulsePair(impulse, forces[nearest], float(np.sqrt(weight))))
    middle = events[len(events) // 2].time_s
    offset = f[0].time_s + rate * (middle - e[0].time_s) - middle
    return _Match(offset, sum(pair.weight for pair in pairs), tuple(pairs))


def _weight(impulse: Impulse, among: list[Impulse]) -> float:
    return impulse.strength / max(other.strength for other in among)


def _require_no_rival(best: _Match, matches: list[_Match], settings: ImpulseSettings) -> None:
    for match in matches:
        apart = abs(match.offset_s - best.offset_s)
        if apart > 4.0 * settings.match_s and match.score > RIVAL * best.score:
            raise AmbiguousImpulsesError(
                f'impulses match at clock offsets of {best.offset_s:.3f} s and '
                f'{match.offset_s:.3f} s alike: leave other taps out, or tap twice at one end so '
                'that the pattern has one fit only'
            )
