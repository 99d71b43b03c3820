# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Learning rates over the course of a stage."""

from __future__ import annotations

import math

from mixtac_fger.errors import TrainingError

SCHEDULES = ('cosine', 'constant')
_WARM = 0.05
_LAST = 0.02


def schedule_factor(name: str, part: float) -> float:
    """Return the factor of the learning rate.

    Args:
        name: `cosine`: up within the first 5 %, then down to 2 % along a cosine; `constant`.
        part: Part of the stage that is done, 0 to 1.

    Raises:
        TrainingError: Unknown name.
    """
    if name == 'constant':
        return 1.0
    if name != 'cosine':
        raise TrainingError(f'schedule {name!r} is unknown: choose one of {", ".join(SCHEDULES)}')
    if part < _WARM:
        return _LAST + (1.0 - _LAST) * part / _WARM
    phase = min((part - _WARM) / (1.0 - _WARM), 1.0)
    return _LAST + 0.5 * (1.0 - _LAST) * (1.0 + math.cos(math.pi * phase))
