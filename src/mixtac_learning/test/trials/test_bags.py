# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A simulated bag gives the trial that the simulator gives; what cannot be used is named."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict

import numpy as np
import pytest

from mixtac_core.recordings.bag import BagFile
from mixtac_core.recordings.dataset import TrialSpec
from mixtac_core.recordings.recording import RecordingError
from mixtac_fger.alignment.bags import write_fit
from mixtac_fger.alignment.clock_fit import AlignmentError, Anchor, fit_clock
from mixtac_fger.config import FgerConfig
from mixtac_learning.trials.bags import (
    BagSource,
    bag_sources,
    host_to_camera_us,
)
from mixtac_learning.trials.samples import Sample, fger_recipe, load_sample, prepare
from mixtac_learning.trials.trial import DatasetError
from mixtac_sim.bags.trial_bag import write_trial
from mixtac_sim.world.trial import simulate_trial

SPEC = TrialSpec('press_000', 'press', 4.0, 41, 42, 'easy', 'train')


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp('bags')
    write_trial(SPEC, path)
    (path / 'dataset.yaml').write_text(json.dumps({'trials': [asdict(SPEC)]}))
    return path


@pytest.fixture(scope='module')
def loaded(folder):
    return bag_sources(folder)[0].load()


def test_a_bag_holds_what_was_simulated(loaded):
    trial = simulate_trial(41, 42, 'press', 4.0, sync=True)
    shift = int(loaded.exposure_start_us[0]) - int(trial.exposure_start_us[0])
    # The bag's camera clock has an origin of its own and runs up to 50 ppm fast or slow.
    assert np.array_equal(loaded.frames, trial.frames)
    # The last few events are still in the camera when the recording ends.
    count = len(loaded.events)
    assert 0 <= len(trial.events) - count < 20
    assert np.array_equal(loaded.events.x, trial.events.x[:count])
    assert np.abs(loaded.events.t - shift - trial.events.t[:count]).max() < 4e6 * 50e-6 + 5
    assert (loaded.arrival_us >= loaded.exposure_end_us).all()
    assert np.abs(loaded.arrival_us - shift - trial.arrival_us).max() < 5_000
    at = trial.truth['t_us'][500::500]
    assert loaded.truth.at(at + shift) == pytest.approx(trial.truth['fz'][500::500], abs=0.01)
    pressed = trial.truth['fz'] > 0.2
    times = trial.truth['t_us'][pressed]
    assert np.abs(loaded.reference.at(times + shift) - trial.truth['fz'][pressed]).mean() < 0.1
    assert loaded.profile == 'press'
    assert loaded.origin['device_seed'] == 41


def test_lost_packets_leave_a_gap(folder, loaded, monkeypatch):
    assert list(loaded.gaps_us) == []
    whole = BagFile.messages

    def holed(self, *wanted, **options):
        for topic, received_ns, message in whole(self, *wanted, **options):
            if not (topic.endswith('/events') and 1000 <= message.seq < 1200):
                yield topic, received_ns, message

    monkeypatch.setattr(BagFile, 'messages', holed)
    trial = bag_sources(folder)[0].load()
    ((begin_us, end_us),) = trial.gaps_us
    inside = (loaded.events.t >= begin_us) & (loaded.events.t < end_us)
    assert len(trial.events) == len(loaded.events) - np.count_nonzero(inside)
    assert end_us - begin_us > 100_000


def test_another_description_is_another_content(folder):
    bag = folder / SPEC.name
    keys = {BagSource(bag, described={'sensor': name}).content_key() for name in 'ab'}
    assert len(keys) == 2


def test_the_fit_beside_the_bag_is_used(folder, loaded, tmp_path):
    bag = tmp_path / SPEC.name
    shutil.copytree(folder / SPEC.name, bag)
    beside = tmp_path / f'{SPEC.name}.clock_fit.json'
    before = BagSource(bag).content_key()
    write_fit(fit_clock([Anchor(0, 0.25, 1e-3), Anchor(100_000_000, 100.25, 1e-3)]), bag)
    assert BagSource(bag).content_key() != before
    assert BagSource(bag).load().reference.t_us[0] != loaded.reference.t_us[0]
    for damaged in ('{"schema": 1, "a": 0}', 'cut of'):
        beside.write_text(damaged)
        with pytest.raises(AlignmentError):
            BagSource(bag).load()


def test_host_times_are_placed_by_the_drivers_pairs():
    host = np.arange(0, 10_000_000_000, 1_000_000_000) + 1_700_000_000_000_000_000
    pairs = [(int(h), int(h + 7_000_000 + 20e-6 * (h - host[0]))) for h in host]
    placed = host_to_camera_us(np.array([int(host[5]) + 500_000_000]), pairs)
    wanted = (int(host[5]) + 500_000_000 + 7_000_000 + 20e-6 * 5.5e9) / 1000
    assert placed[0] == pytest.approx(wanted, abs=2)
    with pytest.raises(DatasetError):
        host_to_camera_us(host, [])


def test_damaged_bags_are_named_and_left_out(folder, tmp_path):
    shutil.copytree(folder, tmp_path / 'set')
    cut = tmp_path / 'set' / 'press_001'
    shutil.copytree(folder / SPEC.name, cut)
    (data,) = cut.glob('*.mcap')
    data.write_bytes(data.read_bytes()[: data.stat().st_size // 2])
    sources = bag_sources(tmp_path / 'set')
    assert [source.name for source in sources] == ['press_000', 'press_001']
    with pytest.raises(RecordingError):
        sources[1].load()
    recipe = fger_recipe(FgerConfig())
    paths, skipped = prepare(sources, [recipe], tmp_path / 'cache')
    assert list(skipped) == ['press_001']
    assert list(paths) == [0]
    sample = load_sample(paths[0][0], Sample)
    assert sample.origin['profile'] == 'press'
    assert sample.force.max() > 0.2
    with pytest.raises(DatasetError):
        prepare(sources[1:], [recipe], tmp_path / 'cache')


def test_samples_are_not_prepared_twice(folder, tmp_path, monkeypatch):
    recipe, sources = fger_recipe(FgerConfig()), bag_sources(folder)
    first = prepare(sources, [recipe], tmp_path)
    monkeypatch.setattr(BagSource, 'load', lambda _self: pytest.fail('loaded again'))
    assert prepare(sources, [recipe], tmp_path) == first


def test_a_simulated_bag_says_what_it_is_by_itself(folder, tmp_path):
    shutil.copytree(folder / SPEC.name, tmp_path / 'elsewhere')
    (source,) = bag_sources(tmp_path / 'elsewhere')
    assert source.origin['profile'] == 'press'
    assert source.origin['name'] == 'elsewhere'


def test_a_folder_without_bags_is_refused(tmp_path):
    with pytest.raises(DatasetError):
        bag_sources(tmp_path)
