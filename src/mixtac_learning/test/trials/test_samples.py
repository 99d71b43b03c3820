# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Samples: what is available when, labels, files, mirrors, and the seeds of trials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from memory_groups import simulation_of

from mixtac_core.events.arrays import Events
from mixtac_fger.config import FgerConfig
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.paper.samples import event_counts, packet_points
from mixtac_learning.train.sequences import mirror_events, mirror_moments, stack
from mixtac_learning.trials.samples import (
    Sample,
    fger_recipe,
    load_sample,
    make_sample,
    save_sample,
)
from mixtac_learning.trials.trial import DatasetError, ForceLabel, SimulatedSource
from mixtac_sim.world import plans as generation
from mixtac_sim.world.plans import (
    TrialSpec,
    evaluation_plan,
    training_plan,
    unseen_devices,
)


def test_frames_are_used_from_their_arrival_on(config, trial):
    sample = make_sample(config, trial)
    at = np.flatnonzero(sample.slots >= 0)
    middle = (trial.exposure_start_us + trial.exposure_end_us) // 2
    assert np.array_equal(sample.slots[at], np.arange(len(at)))
    for window, frame in zip(at, sample.slots[at] + config.reference_frames - 1, strict=True):
        end = sample.window_end_us[window]
        assert end - config.window_us < trial.arrival_us[frame] <= end
        behind = end - config.window_us - sample.lags[window] * config.window_us - middle[frame]
        assert abs(behind) <= config.window_us / 2
    assert (np.diff(sample.window_end_us) == config.window_us).all()
    assert (sample.window_end_us % config.window_us == 0).all()


def test_no_event_after_a_window_reaches_it(config, trial):
    full = make_sample(config, trial)
    cut = int(full.window_end_us[150])
    early = replace(trial, events=trial.events.between(0, cut))
    part = make_sample(config, early)
    assert np.array_equal(full.event_features[:151], part.event_features[:151])
    assert not part.event_features[151:].any()
    assert full.event_features[151:].any()


def test_frames_beyond_the_known_force_are_left_out(config, trial):
    whole, kept = trial.label(), config.reference_frames
    full = make_sample(config, trial)
    first, last = trial.exposure_start_us[kept + 3], trial.exposure_end_us[-4]
    inside = (whole.t_us >= first) & (whole.t_us <= last)
    known = ForceLabel(whole.t_us[inside], whole.force[inside])
    part = make_sample(config, replace(trial, truth=known))
    at = np.flatnonzero(part.slots >= 0)
    assert part.slots[at].tolist() == list(range(len(at)))
    shift = len(full.frame_force) - len(part.frame_force) - 3
    assert shift >= 4
    assert part.frame_force == pytest.approx(full.frame_force[shift:-3], abs=1e-6)
    assert np.array_equal(part.frame_moments, full.frame_moments[shift:-3])
    windows = np.isin(full.window_end_us, part.window_end_us)
    assert np.array_equal(part.lags, full.lags[windows])
    assert np.array_equal(part.event_features, full.event_features[windows])


def test_labels_are_read_at_window_ends_and_averaged_over_exposures():
    label = ForceLabel(np.array([0.0, 1000.0, 2000.0]), np.array([0.0, 1.0, 1.0]))
    assert label.at(np.array([500, 1500])) == pytest.approx([0.5, 1.0])
    mean = label.mean(np.array([0, 1000, 0]), np.array([1000, 2000, 2000]))
    assert mean == pytest.approx([0.5, 1.0, 0.75])


def test_a_simulated_trial_has_both_forces_on_the_camera_clock(monkeypatch, trial):
    label, clock = trial.truth, (1.0001, 777.0)
    made = simulation_of(trial, reference_t_us=1.0001 * label.t_us + 777.0, clock=clock)
    monkeypatch.setattr(generation, 'simulate', lambda _spec: made)
    found = SimulatedSource(TrialSpec(1, 2, 'press', 4.0)).load()
    assert found.truth.force == pytest.approx(label.force, abs=1e-6)
    assert found.reference.t_us == pytest.approx(label.t_us, abs=1e-3)
    assert found.reference.force == pytest.approx(label.force + 0.01)


def test_samples_survive_the_disk(tmp_path, config, trial):
    sample = make_sample(config, trial)
    save_sample(tmp_path / 'a' / 's', sample)
    loaded = load_sample(tmp_path / 'a' / 's', Sample)
    assert loaded.origin == trial.origin
    for name in Sample.__slots__[:-1]:
        kept, made = getattr(loaded, name), getattr(sample, name)
        assert np.array_equal(kept, made, equal_nan=made.dtype.kind == 'f')


@given(st.sampled_from(['lstm_size', 'flow_radius']))
def test_samples_of_other_features_lie_elsewhere(name):
    source, changed = SimulatedSource(TrialSpec(1, 2, 'press', 4.0)), {name: 12}
    paths = [fger_recipe(FgerConfig(**own)).path(source, Path()) for own in ({}, changed)]
    assert (paths[0] == paths[1]) == (name == 'lstm_size')


@pytest.mark.parametrize('content', [None, b'', b'rubbish', b'\x93NUMPY cut short'])
def test_unreadable_samples_are_named(tmp_path, config, trial, content):
    path = tmp_path / 's'
    save_sample(path, make_sample(config, trial))
    for file in path.iterdir():
        whole = file.read_bytes()
        if content is None:
            file.unlink()
        else:
            file.write_bytes(content)
        with pytest.raises(DatasetError):
            load_sample(path, Sample)
        file.write_bytes(whole)


def test_trials_that_begin_in_contact_or_are_too_short_are_refused(config, trial):
    pressed = ForceLabel(trial.truth.t_us, trial.truth.force + 0.2)
    short = replace(trial, frames=trial.frames[:5], arrival_us=trial.arrival_us[:5])
    for each in (replace(trial, truth=pressed), short):
        with pytest.raises(DatasetError):
            make_sample(config, each)


@pytest.mark.parametrize(('columns', 'rows'), [(True, False), (False, True), (True, True)])
def test_mirror_images_are_what_a_mirrored_sensor_sees(config, trial, columns, rows):
    # 344 columns divide into whole bins and equal grid cells; the real 346 leave 2 at one side.
    narrow = replace(config, width=344, grid_columns=4, grid_rows=5)
    events = trial.events[trial.events.x < 344]
    first = replace(trial, frames=trial.frames[:, :, :344], events=events)
    x = (343 - events.x).astype(np.uint16) if columns else events.x
    y = (259 - events.y).astype(np.uint16) if rows else events.y
    axes = [axis for axis, wanted in ((1, rows), (2, columns)) if wanted]
    second = replace(
        first,
        frames=np.ascontiguousarray(np.flip(first.frames, axes)),
        events=Events(events.t, x, y, events.polarity),
    )
    one, other = (make_sample(narrow, part) for part in (first, second))
    turned = mirror_events(torch.from_numpy(one.event_features).float(), columns, rows)
    assert np.allclose(turned.numpy(), other.event_features, atol=2e-2)
    moments = mirror_moments(torch.from_numpy(one.frame_moments), columns, rows)
    size = np.abs(other.frame_moments).max(axis=0)
    assert size[0] > 1.0
    assert (np.abs(moments.numpy() - other.frame_moments) <= 2e-2 * np.maximum(size, size[0])).all()


def test_stacked_trials_keep_their_frames_and_their_lengths(config, trial):
    long = make_sample(config, trial)
    until = ForceLabel(trial.truth.t_us[:900], trial.truth.force[:900])
    short = make_sample(config, replace(trial, truth=until))
    both = stack([long, short], [0, 1], len(long.force))
    assert both.valid.sum(dim=0).tolist() == [len(long.force), len(short.force)]
    assert not both.event_features[len(short.force) :, 1].any()
    at = (both.slots.frame[:, 1] >= 0) & both.valid[:, 1]
    shown = short.frame_moments[short.slots[short.slots >= 0]]
    assert np.array_equal(both.frame_moments[both.slots.frame[at, 1]].numpy(), shown)


@given(st.integers(1, 400), st.integers(1, 400), st.integers(0, 9), st.integers(2, 400))
def test_training_and_evaluation_never_meet(trials, gels, seed, other):
    plan = training_plan(trials, gels, 6.0, seed)
    judged = evaluation_plan(unseen_devices(5, other), 6.0, other)
    assert len({spec.trial_seed for spec in plan}) == trials
    assert len({spec.device_seed for spec in plan}) == min(gels, trials)
    assert not {s.device_seed for s in plan} & {s.device_seed for s in judged}
    assert not {s.trial_seed for s in plan} & {s.trial_seed for s in judged}
    assert len({(s.device_seed, s.profile) for s in judged}) == len(judged)


def test_the_true_force_is_learned_where_it_is_known(trial):
    assert trial.label() is trial.truth
    assert replace(trial, truth=None).label() is trial.reference
    with pytest.raises(DatasetError):
        replace(trial, truth=None, reference=None).label()


def test_packets_are_thinned_evenly_and_normalised():
    t = np.concatenate([np.arange(0, 2000, 100), [2500, 6100]])
    zeros = np.zeros(22, np.uint16)
    events = Events(t, zeros + 345, zeros, np.arange(22) % 2 == 0)
    config = PaperConfig(events_per_packet=5)
    points, starts = packet_points(config, events, np.array([2000, 4000, 6000, 8000]))
    assert starts.tolist() == [0, 5, 6, 6, 7]
    assert points[:, 2] == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 0.25, 0.05], abs=1e-3)
    assert set(points[:, 0].tolist()) == {1.0}
    assert set(points[:, 1].tolist()) == {-1.0}
    assert points[:, 3].tolist() == [1, 1, 1, 1, 1, 1, -1]


def test_event_pictures_hold_every_event_inside():
    random = np.random.default_rng(4)
    t = np.sort(random.integers(0, 90_000, 3000))
    x = random.integers(0, 346, 3000).astype(np.uint16)
    y = random.integers(0, 260, 3000).astype(np.uint16)
    polarity = random.random(3000) > 0.3
    config = PaperConfig(scale=4)
    counts = event_counts(config, Events(t, x, y, polarity), np.array([0, 40_000, 80_000]))
    wanted = np.zeros((2, 2, 65, 86), int)
    for when, column, row, on in zip(t, x, y, polarity, strict=True):
        if when < 80_000 and column // 4 < 86:
            wanted[when // 40_000, 0 if on else 1, row // 4, column // 4] += 1
    assert np.array_equal(counts, wanted)
