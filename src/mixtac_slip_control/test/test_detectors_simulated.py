# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The shipped thresholds on the virtual sensor: sensors and days that set none of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from mixtac_sim.grasp.slip_scene import SlipScene, knock_profile
from mixtac_slip_control.detectors import Detectors
from mixtac_slip_control.features import SlipFeatures
from mixtac_slip_control.parameters import SlipControlParameters

if TYPE_CHECKING:
    from numpy.typing import NDArray

ONSET_S = 0.7023
TOTAL_S = 0.76
TRANSFER_US = 1500


def detections(
    device_seed: int, seed: int, speed: NDArray[np.float64], force: NDArray[np.float64] | None
) -> tuple[list[int], list[int]]:
    """Return the ends of the windows in which flow and count say slip [us]."""
    settings = SlipControlParameters(learning_time=0.4, settle_time=0.01)
    detectors, features = Detectors(settings), SlipFeatures(settings)
    flow, count, frames = [], [], []
    for block in SlipScene(device_seed, seed, load_ratio=0.8).play(speed, force):
        frames += block.frames
        while frames and frames[0].frame_end_us + TRANSFER_US <= block.end_us:
            frame = frames.pop(0)
            middle = (frame.exposure_start_us + frame.exposure_end_us) // 2
            features.frame(frame.intensity, middle)
        for window in features.push(block.events, block.end_us):
            if window.end_us < 100_000:
                continue
            detectors.update(window, 0.0)
            flow += [window.end_us] * detectors.flow.slipping
            count += [window.end_us] * detectors.count.slipping
    assert detectors.learned
    return flow, count


@pytest.mark.parametrize(('device_seed', 'seed'), [(81, 8101), (82, 8201)])
def test_a_knock_is_seen_within_4_ms_and_nothing_before(device_seed: int, seed: int) -> None:
    speed = knock_profile(40.0, ONSET_S, 0.05, TOTAL_S)
    flow, _ = detections(device_seed, seed, speed, None)
    assert 0 < flow[0] - 1e6 * ONSET_S <= 4000


def test_a_change_of_force_is_no_slip_to_the_flow_detector_but_is_to_the_count() -> None:
    t = np.arange(1, round(TOTAL_S / 125e-6) + 1) * 125e-6
    force = 0.7 + 0.3 * np.clip((t - 0.6) / 0.06, 0.0, 1.0)
    flow, count = detections(83, 8301, np.zeros(len(t)), force)
    assert flow == []
    assert count
    assert count[0] > 600_000
