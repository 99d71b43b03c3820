# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The windows of a trial on the camera clock, and which frame arrives in which."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_fger.errors import DatasetError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mixtac_fger.dataset import ForceLabel, RecordedTrial


def window_ends(
    trial: RecordedTrial, label: ForceLabel, window_us: int, begin_us: int
) -> NDArray[np.int64]:
    """Return the ends of the windows of a trial, multiples of `window_us`.

    Args:
        trial: Events and frames.
        label: Force; there are no windows outside its time.
        window_us: Length of a window [us].
        begin_us: The first window ends here or later [us, camera clock].

    Raises:
        DatasetError: There are none.
    """
    first_us = -(-max(begin_us, int(np.ceil(label.t_us[0]))) // window_us) * window_us
    last_us = int(min(label.t_us[-1], camera_end_us(trial)))
    if last_us < first_us + window_us:
        raise DatasetError(
            'the camera and the force sensor have no time in common: check the clock fit'
        )
    return np.arange(first_us, last_us + 1, window_us, dtype=np.int64)


def frame_arrivals(
    arrival_us: NDArray[np.int64], ends: NDArray[np.int64], first: int = 0
) -> NDArray[np.int64]:
    """Return, per window, the latest frame from `first` on that arrived in it, -1 for none.

    Args:
        arrival_us: When the host had each frame [us, camera clock].
        ends: Ends of the windows [us].
        first: Frames before this one do not count.
    """
    slots = np.full(len(ends), -1, np.int64)
    for frame in range(first, len(arrival_us)):
        window = int(np.searchsorted(ends, arrival_us[frame]))
        if window < len(ends):
            slots[window] = frame
    return slots


def camera_end_us(trial: RecordedTrial) -> int:
    """Return until when the camera is known to have run [us, camera clock]."""
    latest = int(trial.events.t[-1]) if len(trial.events) else 0
    return max(latest, int(trial.arrival_us[-1]) if len(trial.arrival_us) else 0)
