# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Where the phases of the demo's scenario lie in its figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_bringup.evaluation import EDGE_US
from mixtac_sim.contact import Mode
from mixtac_sim.profiles import make_profile

if TYPE_CHECKING:
    from mixtac_sim.segments import Segment

_AFTER_IMPACT_S = 0.6


def phases(seconds: float, seed: int) -> list[tuple[str, float, float]]:
    """Return name, start and end [s, as in the comparison] of the scenario's phases.

    The comparison begins at the first synchronising impulse, of which the profile knows the time.

    Args:
        seconds: Length of the scenario [s].
        seed: Its seed.
    """
    profile = make_profile('demo', seed, seconds, sync=True)
    origin = profile.sync_s[0] - EDGE_US / 1e6
    between = [s for s in profile.segments if profile.sync_s[0] < s.start_s < s.end_s]
    between = [s for s in between if s.end_s < profile.sync_s[-1]]
    return [(_name(s), *_span(s, origin)) for s in between]


def _name(segment: Segment) -> str:
    if segment.mode >= Mode.DROP:
        return 'impact of a dropped weight'
    return 'oscillation' if segment.tones else 'press and hold'


def _span(segment: Segment, origin: float) -> tuple[float, float]:
    start, end = segment.start_s - origin, segment.end_s - origin
    if segment.mode >= Mode.DROP:
        return start, min(end, start + _AFTER_IMPACT_S)
    return start - 0.1, end + 0.1
