# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frames of the last minutes, in bounded memory."""

from __future__ import annotations

import numpy as np

from mixtac_alignment.histories import FRAMES_PER_S, FrameHistory, by_cell, reduce_frame
from mixtac_events.arrays import Events


def test_a_sensor_of_any_size_has_cells_that_can_be_numbered() -> None:
    events = Events(
        np.arange(3),
        np.array([0, 15, 9], np.uint16),
        np.array([0, 0, 25], np.uint16),
        np.ones(3, bool),
    )
    assert by_cell(events, 346, 260).cell.tolist() == [0, 1, 68]
    for size in ((2**32 - 1, 2**32 - 1), (70_000, 10), (0, 0)):
        assert len(by_cell(events, *size).cell) == 3


def test_frames_of_another_size_begin_anew() -> None:
    frames = FrameHistory(10.0)
    frames.push(1000, 2000, np.zeros(4, np.float32))
    frames.push(3000, 4000, np.zeros(5, np.float32))
    found = frames.snapshot()
    assert found is not None
    assert found.values.shape == (1, 5)


def test_frames_come_back_in_order() -> None:
    history = FrameHistory(10.0)
    assert history.snapshot() is None
    for k in range(5):
        history.push(1000 * k, 1000 * k + 500, np.full(4, k, np.float32))
    frames = history.snapshot()
    assert frames is not None
    assert frames.start_us.tolist() == [0, 1000, 2000, 3000, 4000]
    assert frames.values[:, 0].tolist() == [0, 1, 2, 3, 4]


def test_frames_are_bounded_in_time_and_number() -> None:
    history = FrameHistory(1.0)
    for k in range(300):
        history.push(40_000 * k, 40_000 * k + 100, np.zeros(4, np.float32))
    frames = history.snapshot()
    assert frames is not None
    assert 24 <= len(frames.start_us) <= 26
    for k in range(300):
        history.push(12_000_000 + 10 * k, 12_000_005 + 10 * k, np.zeros(4, np.float32))
    frames = history.snapshot()
    assert frames is not None
    assert len(frames.start_us) == FRAMES_PER_S


def test_a_restart_of_the_clock_begins_anew() -> None:
    history = FrameHistory(1.0)
    history.push(400, 500, np.zeros(4, np.float32))
    history.push(7, 9, np.zeros(4, np.float32))
    frames = history.snapshot()
    assert frames is not None
    assert frames.start_us.tolist() == [7]


def test_images_smaller_than_a_cell_are_left_out() -> None:
    history = FrameHistory(1.0)
    history.push(400, 500, reduce_frame(np.zeros((260, 9), np.uint8), 255.0))
    assert history.snapshot() is None


def test_frames_without_the_times_of_their_exposure_are_left_out() -> None:
    history = FrameHistory(1.0)
    for start_us, end_us in ((400, 500), (0, 0), (600, 600), (700, 800)):
        history.push(start_us, end_us, np.zeros(4, np.float32))
    frames = history.snapshot()
    assert frames is not None
    assert frames.start_us.tolist() == [400, 700]
