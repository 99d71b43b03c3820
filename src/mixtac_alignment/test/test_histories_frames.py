# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Frames and exposures meet in any order, in bounded memory."""

from __future__ import annotations

import numpy as np

from mixtac_alignment.histories import WAITING, FrameHistory


def test_halves_meet_in_any_order() -> None:
    history = FrameHistory(10.0)
    assert history.snapshot() is None
    for k in range(5):
        values = np.full(4, k, np.float32)
        if k % 2:
            history.push_image(k, values)
            history.push_exposure(k, 1000 * k, 1000 * k + 500)
        else:
            history.push_exposure(k, 1000 * k, 1000 * k + 500)
            history.push_image(k, values)
    frames = history.snapshot()
    assert frames is not None
    assert frames.start_us.tolist() == [0, 1000, 2000, 3000, 4000]
    assert frames.values[:, 0].tolist() == [0, 1, 2, 3, 4]


def test_halves_alone_are_dropped_and_counted() -> None:
    history = FrameHistory(10.0)
    for k in range(WAITING + 7):
        history.push_image(k, np.zeros(4, np.float32))
    assert history.unmatched == 7
    history.clear()
    assert history.snapshot() is None


def test_old_frames_are_forgotten_and_a_restart_begins_anew() -> None:
    history = FrameHistory(1.0)
    for k in range(300):
        history.push_image(k, np.zeros(4, np.float32))
        history.push_exposure(k, 40_000 * k, 40_000 * k + 100)
    frames = history.snapshot()
    assert frames is not None
    assert frames.start_us[-1] - frames.start_us[0] <= 1_000_000
    history.push_image(400, np.zeros(4, np.float32))
    history.push_exposure(400, 7, 9)
    restarted = history.snapshot()
    assert restarted is not None
    assert restarted.start_us.tolist() == [7]
