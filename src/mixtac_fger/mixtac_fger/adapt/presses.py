# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A recording cut into presses, each of which begins and ends without contact."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_fger.dataset import Sample

RELEASED_PART = 0.1
"""Estimates below this part of the largest count as no contact."""
RELEASED_N = 0.02
"""Estimates below this always do [N]."""
SHORTEST_RELEASE = 50
"""Windows that a release lasts at least."""
SHORTEST_PRESS = 50
"""Windows that a press lasts at least."""


def cut_presses(sample: Sample, estimate: NDArray[np.floating]) -> list[Sample]:
    """Cut a sample in the middle of each release.

    Args:
        sample: A recording; its force is nan where it is not known.
        estimate: The model's force at the same windows [N], [T]; its scale does not matter.

    Returns:
        One sample per press that has known forces.
    """
    limit = max(RELEASED_N, RELEASED_PART * float(np.abs(estimate).max()))
    pressed = np.abs(estimate) > limit
    borders = [0, *_middles(~pressed), len(pressed)]
    parts = [(a, b) for a, b in pairwise(borders) if b > a]
    return [
        part_of(sample, start, stop)
        for start, stop in parts
        if pressed[start:stop].sum() >= SHORTEST_PRESS
        and np.isfinite(sample.force[start:stop]).any()
    ]


def _middles(released: NDArray[np.bool_]) -> list[int]:
    """Return the middles of the releases between two presses."""
    edges = np.flatnonzero(np.diff(released.astype(np.int8)))
    bounds = [0, *(edges + 1).tolist(), len(released)]
    runs = [(a, b) for a, b in pairwise(bounds) if released[a]]
    return [
        (a + b) // 2 for a, b in runs if b - a >= SHORTEST_RELEASE and a > 0 and b < len(released)
    ]


def part_of(sample: Sample, start: int, stop: int) -> Sample:
    """Return the windows from `start` to before `stop`, with the frames that arrive in them."""
    slots = sample.slots[start:stop]
    used = slots[slots >= 0]
    first, last = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 1)
    return replace(
        sample,
        window_end_us=sample.window_end_us[start:stop],
        event_features=sample.event_features[start:stop],
        force=sample.force[start:stop],
        slots=np.where(slots >= 0, slots - first, -1),
        lags=sample.lags[start:stop],
        frame_inputs=sample.frame_inputs[first:last],
        frame_force=sample.frame_force[first:last],
    )


def folds(presses: Sequence[Sample], count: int) -> list[list[int]]:
    """Return the presses to hold out together, by index: every `count`-th.

    Raises:
        CalibrationError: There are fewer than two presses.
    """
    if len(presses) < 2:
        raise CalibrationError(
            f'{len(presses)} press: press at least twice and let go in between, as one press'
            ' fits and another one checks'
        )
    number = min(count, len(presses))
    return [list(range(first, len(presses), number)) for first in range(number)]
