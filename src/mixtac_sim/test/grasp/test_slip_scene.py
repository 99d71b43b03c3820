# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the camera sees of slip."""

import numpy as np
import pytest

from mixtac_sim.grasp.slip_scene import SlipScene, knock_profile
from mixtac_sim.world.effects import EASY

ONSET_MS = 40


def _counts(speed: float) -> tuple[np.ndarray, SlipScene]:
    scene = SlipScene(1, 5, EASY)
    blocks = list(scene.play(knock_profile(speed, 1e-3 * ONSET_MS, 0.01, 0.06)))
    return np.array([len(block.events) for block in blocks]), scene


def test_a_knock_makes_events_within_two_milliseconds() -> None:
    counts, _ = _counts(50.0)
    quiet = counts[15:ONSET_MS]
    assert counts[ONSET_MS : ONSET_MS + 2].max() > quiet.max() + 6 * quiet.std()


def test_an_object_at_rest_makes_none_but_noise() -> None:
    counts, scene = _counts(0.0)
    block = scene.advance(np.zeros(8))
    assert block.slipped_mm < 0.02
    assert counts[30:].mean() < 1.5 * max(counts[15:30].mean(), 5.0)


def test_object_moves_as_prescribed_and_slips_by_the_rest() -> None:
    scene = SlipScene(1, 5, EASY)
    profile = knock_profile(30.0, 0.01, 0.02, 0.05)
    last = list(scene.play(profile))[-1]
    assert last.object_mm == pytest.approx(30.0 * (0.02 - 5e-4), rel=0.02)
    # What is not slip is shear of the gel, far below 0.2 mm here.
    assert 0.5 * last.object_mm < last.slipped_mm <= last.object_mm + 0.01


def test_the_same_seeds_give_the_same_events() -> None:
    parts = []
    for _ in range(2):
        scene = SlipScene(2, 3, EASY)
        parts.append([scene.advance(np.full(8, 20.0)).events for _ in range(4)])
    for one, other in zip(*parts, strict=True):
        assert np.array_equal(one.t, other.t)
        assert np.array_equal(one.x, other.x)


def test_events_follow_in_time() -> None:
    scene = SlipScene(1, 5, EASY)
    events = [block.events for block in scene.play(knock_profile(50.0, 2e-3, 5e-3, 0.02))]
    times = np.concatenate([e.t for e in events])
    assert np.all(np.diff(times) >= 0)
    assert times[-1] < 20_000


def test_frames_come_at_their_rate() -> None:
    scene = SlipScene(1, 5, EASY)
    frames = [f for block in scene.play(np.zeros(1600), block_steps=32) for f in block.frames]
    assert [f.exposure_start_us for f in frames] == [5_000 + 40_000 * k for k in range(5)]
    assert frames[0].intensity.std() > 5.0
