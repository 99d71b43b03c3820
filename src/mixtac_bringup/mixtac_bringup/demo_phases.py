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

_PRESS, _OSCILLATION, _IMPACT = 'press and hold', 'oscillation', 'impact of a dropped weight'
_TREMOR_N = 0.05
_MARGIN_S = 0.1
_WAVES_S = 2.0
_BOUNCES_S = 0.8


def phases(seconds: float, seed: int) -> list[tuple[str, float, float]]:
    """Return name, start and end [s, as in the comparison] of what to show of each phase.

    The comparison begins at the first synchronising impulse, of which the profile knows the time.

    Args:
        seconds: Length of the scenario [s].
        seed: Its seed.
    """
    profile = make_profile('demo', seed, seconds, sync=True)
    origin = profile.sync_s[0] - EDGE_US / 1e6
    inner = [s for s in profile.segments if profile.sync_s[0] < s.start_s]
    inner = [s for s in inner if s.end_s < profile.sync_s[-1]]
    spans: dict[str, tuple[float, float]] = {}
    for segment in inner:
        name = _name(segment)
        start = spans.get(name, (segment.start_s - origin, 0.0))[0]
        spans[name] = (start, segment.end_s - origin)
    return [(name, *_shown(name, *span)) for name, span in spans.items()]


def _name(segment: Segment) -> str:
    if segment.mode >= Mode.DROP:
        return _IMPACT
    return _OSCILLATION if segment.tones and segment.tones[0].amplitude > _TREMOR_N else _PRESS


def _shown(name: str, start: float, end: float) -> tuple[float, float]:
    if name == _OSCILLATION:
        middle = (start + end) / 2
        return max(start, middle - _WAVES_S / 2), min(end, middle + _WAVES_S / 2)
    if name == _IMPACT:
        return start, min(end, start + _BOUNCES_S)
    return start - _MARGIN_S, end + _MARGIN_S
