# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the estimator: what it feeds is what the driver would publish."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_events.codec import decode_message
from mixtac_fger.estimator import open_estimator
from mixtac_fger.streaming import warm_up
from mixtac_fger.weights import DEFAULT_MODEL, Model, find_model, read_model
from mixtac_lab.bench.infer import (
    DEVICE_SEED,
    EPOCH_US,
    TRIAL_SEED,
    Scene,
    frame_times_ms,
    make_scene,
    run_paced,
    validity_share,
)
from mixtac_recordings.dataset import TrialSpec
from mixtac_sim.world.trial import TrialStream

SECONDS = 3.0


@pytest.fixture(scope='module')
def scene() -> Scene:
    return make_scene(SECONDS, 'easy')


@pytest.fixture(scope='module')
def model() -> Model:
    model = read_model(find_model(DEFAULT_MODEL))
    warm_up(open_estimator(model))
    return model


def test_packets_carry_every_event_of_the_trial(scene: Scene) -> None:
    spec = TrialSpec('other', 'dynamic', SECONDS, DEVICE_SEED, TRIAL_SEED, 'easy', 'test')
    wanted = np.concatenate([part.sensor.events.t for part in TrialStream(spec).stretches()])
    found = np.concatenate([decode_message(packet).events.t for packet in scene.packets])
    assert np.array_equal(found - EPOCH_US, wanted)
    assert scene.events == len(wanted) > 0


def test_packets_say_how_far_they_reach(scene: Scene) -> None:
    ends = [decode_message(packet).complete_until for packet in scene.packets]
    assert ends == scene.ends_us
    assert set(np.diff(ends)) == {1000}


def test_paced_run_gives_a_force_per_window(scene: Scene, model: Model) -> None:
    run = run_paced(model, scene)
    first_frame_us = scene.frames[model.config['reference_frames'] - 1].ready_us - EPOCH_US
    # The frame is fed before the packet that ends with it, so the window that ends there counts.
    possible = 1 + (SECONDS * 1e6 - first_frame_us) / model.config['window_us']
    # On a busy machine the frame thread may finish the first frame later.
    assert 0 < len(run['step_ms']) <= run['windows'] <= possible
    assert 0 <= run['late'] <= len(run['step_ms'])


def test_frame_times_leave_out_the_reference(scene: Scene, model: Model) -> None:
    times = frame_times_ms(model, scene)
    assert len(times) == len(scene.frames) - model.config['reference_frames']


def test_checks_of_validity_are_a_small_part_of_a_window(scene: Scene, model: Model) -> None:
    assert 0.0 < validity_share(model, scene) < 0.5
