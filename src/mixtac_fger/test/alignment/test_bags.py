# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags: force samples and packets, and what is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_core.events.arrays import Events
from mixtac_core.node import topics
from mixtac_core.recordings.bag_writer import McapBag
from mixtac_core.recordings.importing import StreamWriter
from mixtac_core.recordings.recording import RecordingError
from mixtac_fger.alignment.bags import read_recording
from mixtac_fger.alignment.clock_fit import GapError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SECOND_NS = 1_000_000_000


def bag(
    path: Path, samples: list[tuple[int, float]], packets_us: Sequence[int] = (1_000_000,)
) -> Path:
    """Write a bag with forces at times [ns] and packets of one event at times [us]."""
    with McapBag(path) as written:
        writer = StreamWriter(written, (346, 260))
        for t_us in packets_us:
            event = np.array([t_us]), np.zeros(1, np.uint16), np.zeros(1, np.uint16)
            writer.events(Events(*event, np.ones(1, np.bool_)), t_us + 1000, SECOND_NS)
        for k, (stamp_ns, normal) in enumerate(samples):
            values = (0.0, 0.0, normal, 0.0, 0.0, 0.0)
            data = topics.WrenchWriter('').serialised(stamp_ns, values)
            writer.put(topics.REFERENCE_WRENCH, SECOND_NS + k, data)
    return path


def test_samples_without_a_later_stamp_or_a_number_are_left_out(tmp_path: Path) -> None:
    samples = [(SECOND_NS + 1_000_000 * k, float(k)) for k in range(9)]
    samples[0] = (0, 1.0)
    samples[3] = (0, 3.0)
    samples[5] = (samples[4][0], 5.0)
    samples[7] = (samples[7][0], float('nan'))
    recording = read_recording(bag(tmp_path / 'bag', samples))
    assert recording.force.tolist() == [1.0, 2.0, 4.0, 6.0, 8.0]
    assert recording.force_t_s.tolist() == [1.001, 1.002, 1.004, 1.006, 1.008]


@pytest.mark.parametrize('still_s', [0, 2, 5])
def test_a_reference_that_does_not_move_is_reported(tmp_path: Path, still_s: int) -> None:
    samples = [(SECOND_NS // 10 * k, float(k)) for k in range(1, 10 + 10 * still_s)]
    samples[5 : 5 + 10 * still_s] = [(stamp, 1.5) for stamp, _ in samples[5 : 5 + 10 * still_s]]
    assert bool(read_recording(bag(tmp_path / 'bag', samples)).damage) == (still_s > 3)


def test_a_reference_clock_that_goes_back_is_refused(tmp_path: Path) -> None:
    samples = [(SECOND_NS * k, float(k)) for k in (8, 9, 5, 6)]
    with pytest.raises(GapError):
        read_recording(bag(tmp_path / 'bag', samples))


def test_a_bag_without_packets_is_refused(tmp_path: Path) -> None:
    samples = [(SECOND_NS + 1_000_000 * k, float(k)) for k in range(9)]
    with pytest.raises(RecordingError):
        read_recording(bag(tmp_path / 'bag', samples, packets_us=()))


def test_a_camera_clock_that_jumps_is_refused(tmp_path: Path) -> None:
    samples = [(SECOND_NS + 1_000_000 * k, float(k)) for k in range(9)]
    with pytest.raises(GapError):
        read_recording(bag(tmp_path / 'bag', samples, packets_us=(1_000_000, 5_000_000_000)))
