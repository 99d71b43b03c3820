# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The commands end to end, with the toy sensor in place of the simulator."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from memory_groups import simulation_of

from mixtac_fger.config import ConfigError, FgerConfig, ModelError, from_mapping
from mixtac_fger.weights import find_model, read_model, write_model
from mixtac_learning import commands as training_cli
from mixtac_learning.judge.estimators import stream, trial_estimator
from mixtac_learning.network import network_of
from mixtac_learning.paper.config import PaperConfig
from mixtac_learning.train.config import (
    ADAPTING,
    DataConfig,
    RunConfig,
    SimulatedData,
    TrainingSettings,
    read_run_config,
    shipped_runs,
    with_overrides,
)
from mixtac_learning.train.loop import TrainingError
from mixtac_learning.train.paper_stage import PaperTraining
from mixtac_learning.train.run import held_out, run_training, train_model
from mixtac_learning.trials.bags import BagSource
from mixtac_learning.trials.trial import DatasetError, ForceLabel, SimulatedSource
from mixtac_sim.world import plans as generation
from mixtac_sim.world.plans import TrialSpec


@pytest.fixture
def simulated(monkeypatch, trial) -> list[str]:
    """Names of the trials that were simulated, each the same toy trial."""
    names: list[str] = []

    toy = simulation_of(trial)

    def simulate(spec):
        names.append(spec.name)
        return toy

    monkeypatch.setattr(generation, 'simulate', simulate)
    monkeypatch.setattr(generation, 'simulator_digest', lambda: 'toy')
    return names


RUN = """model: ours
judged: 1
training: {{seed: 1, recurrent_epochs: 2}}
data:
  simulated: {{presets: [easy], sensors: 3, trials: 3, seconds: 6.0, seed: 1}}
  cache: {cache}
  checked: 0.0
"""


def test_train_writes_weights_with_their_figures(tmp_path, simulated, capsys):
    run, out, report = (tmp_path / name for name in ('run.yaml', 'a.safetensors', 'report.json'))
    run.write_text(RUN.format(cache=tmp_path / 'data'))
    training_cli.train(str(run), out=out, jobs=1, folder=tmp_path / 'run', json=report)
    card = read_model(out).card
    assert card.training['device_seeds'] == [101_000, 101_002]
    assert card.training['trials'] == 3
    assert card.training['simulator'] == 'toy'
    assert set(card.metrics) == {'unseen_devices'}
    assert set(card.metrics['unseen_devices']) > {'all', 'press', 'impact'}
    assert json.loads(report.read_text())['metrics'] == card.metrics
    assert 'unseen devices' in capsys.readouterr().out
    assert 'simulated data only' in out.with_suffix('.md').read_text()
    kept = sorted(path.name.rpartition('-')[0] for path in (tmp_path / 'data').iterdir())
    assert kept == sorted(simulated[:3])
    curves = json.loads((tmp_path / 'run' / 'curves.json').read_text())['epochs']
    stages = [row['stage'] for row in curves]
    assert stages == ['recurrent', 'recurrent']
    picture = tmp_path / 'trials.png'
    training_cli.evaluate(None, str(out), 2, 1, 6.0, figures=picture, json=report)
    figures = json.loads(report.read_text())['metrics']['unseen_devices']
    assert figures['all']['mae'] == pytest.approx(card.metrics['unseen_devices']['all']['mae'])
    assert figures['all']['reference_mae'] > 0.0
    assert picture.exists()


def test_a_model_is_adapted_to_bags_and_judged_before_and_after(tmp_path, trial, monkeypatch):
    """The bags are of a gel twice as stiff as the one that the model was trained on."""
    stiff = replace(trial, truth=ForceLabel(trial.truth.t_us, 2.0 * trial.truth.force))
    for name, value in (('recurrent_rate', 3e-3), ('recurrent_epochs', 3)):
        monkeypatch.setitem(ADAPTING, name, value)
    monkeypatch.setattr(BagSource, 'load', lambda bag: replace(stiff, origin=bag.origin))
    monkeypatch.setattr(BagSource, 'content_key', lambda bag: bag.name)
    bags = [BagSource(tmp_path / f'trial_{number}') for number in range(3)]
    monkeypatch.setattr('mixtac_learning.train.run.bag_sources', lambda *_: bags)
    report, out = tmp_path / 'report.json', tmp_path / 'lab.safetensors'
    folders = {'data': tmp_path / 'data', 'folder': tmp_path / 'run'}
    options = {'bags': [tmp_path], 'start': 'fger_small', 'out': out, 'jobs': 1, 'json': report}
    training_cli.train('ours', **options, **folders)
    start, model = read_model(find_model('fger_small')), read_model(out)
    figures = json.loads(report.read_text())['metrics']
    assert figures['after']['all']['mae'] < 0.9 * figures['before']['all']['mae']
    assert figures['before']['all']['trials'] == 1
    assert (model.card.training['trials'], model.card.training['start']) == (2, 'fger_small')
    assert model.config == start.config
    changed = {
        n for n, value in model.tensors.items() if not np.array_equal(value, start.tensors[n])
    }
    assert {'frame.press', 'increment.2.weight'} <= changed
    assert not [n for n in changed if n.startswith(('frame.spread', 'shear.'))]


def test_a_single_bag_and_networks_of_the_paper_are_not_adapted(tmp_path, trial, monkeypatch):
    with pytest.raises(ConfigError):
        training_cli.train('frames', bags=[tmp_path], start='fger_small')
    monkeypatch.setattr(BagSource, 'load', lambda _bag: trial)
    monkeypatch.setattr(BagSource, 'content_key', lambda bag: bag.name)
    monkeypatch.setattr('mixtac_learning.train.run.bag_sources', lambda *_: [BagSource(tmp_path)])
    with pytest.raises(DatasetError):
        training_cli.train(
            'ours', bags=[tmp_path], start='fger_small', jobs=1, data=tmp_path / 'data'
        )


def test_the_weights_of_a_model_that_cannot_be_judged_are_written(
    tmp_path, simulated, monkeypatch, capsys
):
    toy = generation.simulate

    def untouched(spec):
        found = toy(spec)
        if spec.device_seed < generation.UNSEEN:
            return found
        truth = np.zeros_like(found.truth)
        truth['t_us'] = found.truth['t_us']
        return SimpleNamespace(**vars(found) | {'truth': truth})

    monkeypatch.setattr(generation, 'simulate', untouched)
    out = tmp_path / 'small.safetensors'
    config = RunConfig(
        out=str(out),
        training={'recurrent_epochs': 1},
        data=DataConfig(SimulatedData(('easy',), 1, 2, 4.0), cache=str(tmp_path), checked=0.0),
        judged=1,
    )
    run_training(config, tmp_path / 'run', 1, None)
    assert 'not judged' in capsys.readouterr().out
    card = read_model(out).card
    assert card.training['trials'] == 2
    assert card.metrics == {}


def test_a_finished_run_is_not_trained_again(tmp_path, simulated):
    config = tmp_path / 'run.yaml'
    config.write_text(
        'model: ours\n'
        'training: {recurrent_epochs: 1}\n'
        'data:\n'
        '  simulated: {presets: [easy], sensors: 2, trials: 3, seconds: 4.0, profiles: [press]}\n'
        '  checked: 0.34\n'
    )
    chosen = with_overrides(read_run_config(str(config)), None, 3, tmp_path / 'data')
    assert chosen.training['seed'] == 3
    first = train_model(chosen, tmp_path / 'run')
    assert [row['validation'] is not None for row in first.curves] == [True]
    assert (first.model.card.training['trials'], first.model.card.training['held_out_trials']) == (
        2,
        1,
    )
    stages = []
    again = train_model(chosen, tmp_path / 'run', show=lambda *row: stages.append(row[0]))
    assert set(stages) == {'preparing'}
    assert again.curves == first.curves
    for name, value in first.model.tensors.items():
        assert np.array_equal(value, again.model.tensors[name])
    other = with_overrides(chosen, None, 4, None)
    with pytest.raises(TrainingError):
        train_model(other, tmp_path / 'run')


@pytest.mark.parametrize('model', ['fger', 'frames', 'events', 'fusion'])
def test_the_papers_networks_train_and_are_judged(tmp_path, simulated, model):
    config = RunConfig(
        model=model,
        network={'scale': 8, 'events_per_packet': 16, 'channels': 8, 'lstm_size': 8}
        | {'event_widths': (8, 8)},
        training={
            'frame_epochs': 1,
            'event_epochs': 1,
            'recurrent_epochs': 1,
            'joint_epochs': 1,
            'event_updates': 4,
            'cycles': 10,
        },
        data=DataConfig(SimulatedData(('easy',), 1, 2, 4.0), cache=str(tmp_path), checked=0.5),
    )
    trained = train_model(config, tmp_path / 'run')
    stages = {'fger': 4, 'events': 3, 'frames': 2, 'fusion': 2}
    assert [row['epoch'] for row in trained.curves] == [1] * stages[model]
    out = tmp_path / 'm.safetensors'
    write_model(out, trained.model)
    source = SimulatedSource(TrialSpec(1, 2, 'press', 4.0))
    loaded = trial_estimator(read_model(out))(source.load())
    direct = trial_estimator(trained.model)(source.load())
    assert np.array_equal(loaded.force, direct.force)
    assert np.isfinite(direct.force).all()
    assert (np.diff(direct.t_us) == 2000).all()
    # Live, window by window, the same forces come out.
    live = stream(read_model(out), source.load())
    force = live.force[np.isin(live.t_us, direct.t_us)]
    if model == 'fusion':
        # Events between two frames are counted in whole windows.
        assert np.abs(force - direct.force).max() < 0.2 * np.ptp(direct.force) + 1e-3
    else:
        # Increments of an untrained network add up to any force.
        assert np.abs(force - direct.force).max() < 1e-4 + 1e-4 * np.ptp(direct.force)
    with pytest.raises(ModelError):
        network_of(read_model(out))


def test_shipped_runs_can_be_read():
    names = sorted(path.stem for path in shipped_runs().glob('*.yaml'))
    assert names == ['events', 'fger_paper', 'frames', 'fusion', 'ours', 'smoke']
    for name in names:
        run = read_run_config(name)
        if run.model == 'ours':
            from_mapping(TrainingSettings, run.training, 'training')
            FgerConfig.from_dict(asdict(FgerConfig()) | run.network)
        else:
            from_mapping(PaperTraining, run.training, 'training')
            assert PaperConfig.from_dict({'model': run.model} | run.network).model == run.model


def test_the_shipped_weights_are_those_of_the_shipped_run():
    run, model = read_run_config('ours'), read_model(find_model('fger_small'))
    assert model.config == asdict(FgerConfig()) | run.network
    card, settings = model.card.training, from_mapping(TrainingSettings, run.training, 'training')
    assert card['settings'] == asdict(settings)
    assert card['trials'] + card['held_out_trials'] == run.data.simulated.trials
    assert card['profiles'] == sorted(set(run.data.simulated.profiles))


@pytest.mark.parametrize(
    'text',
    [
        'model: [',
        '- a',
        'model: ours',
        'model: snn\ndata: {bags: [a]}',
        'speed: 1\ndata: {bags: [a]}',
        'data: {bags: [a], checked: much}',
    ],
)
def test_impossible_runs_are_refused(tmp_path, text):
    path = tmp_path / 'run.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError):
        read_run_config(str(path))


@pytest.mark.parametrize(
    ('settings', 'name', 'value'),
    [
        (TrainingSettings, 'group_trials', 0),
        (TrainingSettings, 'recurrent_epochs', -1),
        (PaperTraining, 'event_batch', 1),
        (PaperTraining, 'frame_rate', float('nan')),
    ],
)
def test_impossible_settings_are_refused_before_the_data_are_read(settings, name, value):
    with pytest.raises(ConfigError):
        from_mapping(settings, {name: value}, 'training')


@given(st.lists(st.sampled_from('abcdefgh'), min_size=2, max_size=60), st.floats(0.01, 0.9))
def test_a_part_is_held_out_and_a_part_is_trained_on(sensors, part):
    numbered = dict(enumerate(sensors))
    held = held_out(numbered, part)
    assert held == sorted(set(held)) == held_out(numbered, part)
    assert 0 < len(held) < len(sensors)
    different = len(set(sensors))
    kept = {sensor for index, sensor in enumerate(sensors) if index not in held}
    if part * different >= 1.0:
        assert kept.isdisjoint(sensors[index] for index in held)
        assert len(kept) >= 1
    else:
        assert len(held) == min(max(round(part * len(sensors)), 1), len(sensors) - 1)
    assert held_out(numbered, 0.0) == []
