# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the figures of the live estimator mean for people: a level and one line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from mixtac_fger.live_feed import WATCHED

if TYPE_CHECKING:
    from mixtac_fger.live_feed import FeedStatus

OK: Final = 0
WARN: Final = 1
"""Levels of `diagnostic_msgs/DiagnosticStatus`."""


def judge(found: FeedStatus, stale_s: float) -> tuple[int, str]:
    """Return the level and the message that a status deserves.

    Args:
        found: Figures of the active estimator.
        stale_s: Age from which frames are too old [s].
    """
    parts = []
    if found.estimator.reason:
        parts.append(found.estimator.reason)
    elif found.rate_hz == 0.0:
        parts.append('no force in the last second: no event packets arrive')
    age_s = found.estimator.frame_age_us * 1e-6
    if found.estimator.ready and age_s > stale_s:
        parts.append(f'latest frame is {age_s:.1f} s old: the force drifts')
    if found.lately:
        rises = (f'{count} {WATCHED[name]}' for name, count in found.lately.items())
        parts.append('since the last report: ' + ', '.join(rises))
    if found.problem:
        parts.append(found.problem)
    return (WARN, '; '.join(parts)) if parts else (OK, 'estimating')
