# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Data sets made in parallel, cut off and continued."""

from __future__ import annotations

import shutil

import pytest

from mixtac_core.recordings.dataset import DatasetDescription
from mixtac_core.recordings.recording import RecordingError
from mixtac_sim.bags import trial_bag
from mixtac_sim.bags.trial_bag import UNFINISHED, generate, write_trial
from mixtac_sim.world.plans import describe, plan_profile


def description(trials=2, seconds=2.6):
    planned = plan_profile('idle', trials, seconds, preset='easy')
    return describe('idle', 0, 'easy', 'trial', planned)


def contents(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob('*') if path.is_file()
    }


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Return a data set that was made in one go, in this process."""
    folder = tmp_path_factory.mktemp('whole')
    assert generate(description(), folder) == 2
    return folder


def test_a_data_set_is_its_bags_and_its_description_and_left_alone_when_finished(whole):
    names = {path.name for path in whole.iterdir()}
    assert names == {'dataset.yaml', 'trial_000', 'trial_001'}
    assert DatasetDescription.read(whole).complete
    before = contents(whole)
    assert generate(description(), whole) == 0
    assert contents(whole) == before


def test_processes_write_the_same_bytes(whole, tmp_path):
    steps = []
    made = generate(
        description(),
        tmp_path,
        jobs=2,
        on_progress=lambda done, total: steps.append((done, total)),
    )
    assert made == 2
    assert steps == [(0, 2), (1, 2), (2, 2)]
    assert contents(tmp_path) == contents(whole)


def test_a_run_that_was_killed_goes_on_where_it_was(whole, tmp_path):
    kept = tmp_path / 'trial_000'
    shutil.copytree(whole / 'trial_000', kept)
    half = tmp_path / UNFINISHED / 'trial_001'
    half.mkdir(parents=True)
    (half / 'trial_001.mcap').write_bytes(b'half')
    description().write(tmp_path)
    assert not DatasetDescription.read(tmp_path).complete
    written = (kept / 'trial_000.mcap').stat().st_mtime_ns
    assert generate(description(), tmp_path) == 1
    assert (kept / 'trial_000.mcap').stat().st_mtime_ns == written
    assert contents(tmp_path) == contents(whole)
    assert not (tmp_path / UNFINISHED).exists()


def test_another_data_set_or_other_files_are_not_touched(whole, tmp_path):
    with pytest.raises(RecordingError):
        generate(description(trials=1), whole)
    (tmp_path / 'notes.txt').write_text('mine')
    with pytest.raises(RecordingError):
        generate(description(), tmp_path)


def test_a_bag_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / UNFINISHED).write_text('in the way')
    spec = description(trials=1).trials[0]
    with pytest.raises(RecordingError) as failure:
        write_trial(spec, tmp_path)
    assert str(tmp_path / spec.name) in str(failure.value)


def test_a_killed_worker_is_an_expected_failure(tmp_path, monkeypatch):
    def killed(*_args, **_kwargs):
        raise trial_bag.TerminatedWorkerError('gone')

    monkeypatch.setattr(trial_bag, 'write_trial', killed)
    with pytest.raises(RecordingError):
        generate(description(trials=1), tmp_path)
