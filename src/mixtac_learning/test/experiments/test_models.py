# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The table of models: mean and spread over seeds, and trials that never meet."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_learning.experiments import model
from mixtac_learning.experiments.harness import PAPER_SIZES, TABLE_SIZES, run_config
from mixtac_learning.experiments.models import (
    PROFILES,
    PROTOCOLS,
    aggregate,
    cell,
    rows_of,
    table_data,
    test_specs,
    test_trials,
    training_data,
)
from mixtac_learning.judge.estimators import TrialEstimate
from mixtac_learning.train.run import training_sources

test_specs.__test__ = test_trials.__test__ = False


def estimates(errors, profiles):
    """Return estimates of a model by seed that are off by these errors [N]."""
    t_us, known = 2000 * np.arange(1000), np.linspace(0.0, 1.0, 1000)
    return {
        seed: [
            TrialEstimate('t', profile, 'd', t_us, known + error * factor, known)
            for factor, profile in enumerate(profiles, start=1)
        ]
        for seed, error in enumerate(errors)
    }


def test_a_table_has_mean_and_spread_over_seeds():
    found = {'fger': estimates((0.1, 0.2, 0.3), ('dynamic',))}
    table = aggregate(found, {'fger': [1.0, 3.0, 2.0]})
    assert table['fger']['dynamic']['mae'] == {'mean': 0.2, 'spread': 0.1, 'seeds': 3}
    assert table['fger']['training']['core_minutes']['mean'] == 2.0


def test_a_row_has_the_error_of_each_kind_of_trial():
    found = estimates((0.1, 0.3), ('dynamic', 'long_term'))
    (row,) = rows_of(aggregate({'fger': found}, {'fger': [1.0, 1.0]}), 'paper', 'full')
    assert (row['model'], row['protocol'], row['size']) == ('fger', 'paper', 'full')
    assert row['dynamic'] == {'mae': 0.2, 'sd': pytest.approx(0.1414, abs=1e-4), 'seeds': 2}
    assert row['hold']['mae'] == 0.4
    assert cell(row['dynamic']) == '0.200 +-0.141'
    assert cell(row.get('static')) == '-'
    (single,) = rows_of(aggregate({'fger': {0: found[0]}}, {'fger': [1.0]}), 'paper', 'full')
    assert single['dynamic'] == {'mae': 0.1, 'sd': None, 'seeds': 1}


@pytest.mark.parametrize('protocol', PROTOCOLS)
@pytest.mark.parametrize('size', TABLE_SIZES)
def test_no_test_trial_is_trained_on(size, protocol):
    sizes = TABLE_SIZES[size]
    trained = [source.spec for source in training_sources(table_data(sizes, protocol))]
    tested = test_specs(sizes, protocol)
    assert len({(spec.device_seed, spec.session) for spec in [*trained, *tested]}) == 1
    assert not {spec.trial_seed for spec in trained} & {spec.trial_seed for spec in tested}
    assert len({spec.trial_seed for spec in tested}) == len(tested)
    assert {spec.profile for spec in tested} == {'dynamic', 'static', 'long_term', 'impact'}


@pytest.mark.parametrize(('model', 'kind'), [('fger_reference', 'paper'), ('ours', 'ours')])
def test_a_session_has_its_own_training(model, kind):
    sizes = TABLE_SIZES['full']
    session, other = (run_config(sizes, model, 0, table_data(sizes, each)) for each in PROTOCOLS)
    assert session.training == other.training | sizes.session_training[kind]
    assert session.training != other.training


def test_tests_are_other_days_of_the_sensor_that_was_trained_on():
    full, sensors = PAPER_SIZES['full'], set()
    for seed in range(3):
        trained = [source.spec for source in training_sources(training_data(full, seed))]
        tested = [spec for name in PROFILES for spec in test_trials(full, seed, name)]
        (device,) = {spec.device_seed for spec in trained}
        assert {spec.device_seed for spec in tested} == {device}
        days = [spec.trial_seed for spec in tested]
        assert len(set(days)) == len(days)
        assert not set(days) & {spec.trial_seed for spec in trained}
        sensors.add(device)
    assert len(sensors) == 3


def test_paper_network_is_counted_and_timed(monkeypatch):
    monkeypatch.setattr(model, 'REPETITIONS', 2)
    parameters, operations, interval, packet = model.paper_rows()
    assert parameters.ours.mean == pytest.approx(parameters.paper, rel=0.005)
    assert operations.ours.mean == pytest.approx(operations.paper, rel=0.01)
    assert not parameters.simulated
    assert interval.ours.mean > 0.0
    assert packet.ours.mean > 0.0
    assert interval.ours.count == packet.ours.count == 2


def test_steps_have_a_median_and_a_percentile_of_their_own_number(monkeypatch):
    times = np.linspace(0.0, 1.0, 101).tolist()
    monkeypatch.setattr(model, 'step_times_ms', lambda _seconds: (times, [2.0] * 7))
    steps = [row for row in model.our_rows(1.0) if ' step' in row.name]
    assert [row.ours.mean for row in steps] == pytest.approx([0.5, 0.99, 2.0, 2.0])
    assert {row.ours.spread for row in steps} == {0.0}
    assert [row.paper for row in steps] == [model.LATENCY_MS, None, None, None]
    assert all('101' in row.conditions for row in steps[:2])
