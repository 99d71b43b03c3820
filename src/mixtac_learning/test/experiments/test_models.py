# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The table: mean and spread, and suites whose trials never meet."""

from __future__ import annotations

import pytest

from mixtac_learning.experiments.harness import (
    ALL_ROWS,
    TABLE_SIZES,
    run_config,
)
from mixtac_learning.experiments.models import (
    aggregate,
    lines_of,
    rows_of,
    table_data,
    test_specs,
    unseen_specs,
)
from mixtac_learning.train.run import training_sources

test_specs.__test__ = False


def config(size, model, seed):
    sizes = TABLE_SIZES[size]
    return run_config(sizes, model, seed, table_data(sizes, model))


def test_mean_and_spread_over_seeds():
    runs = [{'dynamic': {'mae': mae, 'r2': 0.5}} for mae in (0.1, 0.2, 0.3)]
    table = aggregate({'fger': runs})
    assert table['fger']['dynamic']['mae'] == {'mean': 0.2, 'spread': 0.1, 'seeds': 3}
    assert table['fger']['dynamic']['r2']['spread'] == 0.0
    assert lines_of(table) == [['model', 'dynamic'], ['fger', '0.200 +-0.100']]
    assert aggregate({'fger': runs[:1]})['fger']['dynamic']['mae']['spread'] == 0.0


def test_a_row_has_the_error_of_each_kind_of_trial():
    runs = [{'dynamic': {'mae': mae}, 'long_term': {'mae': 2 * mae}} for mae in (0.1, 0.3)]
    (row,) = rows_of(aggregate({'fger': runs}), 'paper', 'full')
    assert (row['model'], row['protocol'], row['size']) == ('fger', 'paper', 'full')
    assert row['dynamic'] == {'mae': 0.2, 'sd': pytest.approx(0.1414, abs=1e-4), 'seeds': 2}
    assert row['hold']['mae'] == 0.4
    assert 'static' not in row
    (single,) = rows_of(aggregate({'fger': runs[:1]}), 'paper', 'full')
    assert single['dynamic'] == {'mae': 0.1, 'sd': None, 'seeds': 1}


@pytest.mark.parametrize('size', TABLE_SIZES)
def test_the_papers_protocol_stays_in_one_session(size):
    sizes = TABLE_SIZES[size]
    trained = [source.spec for source in training_sources(table_data(sizes, 'fger', 'paper'))]
    tested = test_specs(sizes, trained[0].device_seed, 'paper')
    assert len({(spec.device_seed, spec.session) for spec in [*trained, *tested]}) == 1
    assert not {spec.trial_seed for spec in trained} & {spec.trial_seed for spec in tested}
    assert {spec.profile for spec in tested} == {'dynamic', 'static', 'long_term', 'impact'}
    assert table_data(sizes, 'ours', 'paper') == table_data(sizes, 'fger', 'paper')


@pytest.mark.parametrize('model', ALL_ROWS)
def test_no_test_trial_is_trained_on(model):
    trained = [source.spec for source in training_sources(table_data(TABLE_SIZES['full'], model))]
    seen = test_specs(TABLE_SIZES['full'], trained[0].device_seed, 'other_days')
    unseen, presses = unseen_specs(TABLE_SIZES['full'])
    assert {s.device_seed for s in seen} <= {s.device_seed for s in trained}
    assert not {s.trial_seed for s in trained} & {s.trial_seed for s in [*seen, *unseen, *presses]}
    assert not {s.device_seed for s in trained} & {s.device_seed for s in unseen}
    assert not {s.trial_seed for s in unseen} & {s.trial_seed for s in presses}
    names = [spec.name for spec in [*seen, *unseen, *presses]]
    assert len(set(names)) == len(names)


def test_all_seeds_see_the_same_trials():
    runs = [config('full', 'fger', seed) for seed in (0, 1)]
    assert runs[0].data == runs[1].data
    assert runs[0].training != runs[1].training


def test_a_session_has_its_own_training():
    sizes = TABLE_SIZES['full']
    for model, kind in (('fger', 'paper'), ('without_reference', 'ours')):
        trained = run_config(sizes, model, 0, table_data(sizes, model, 'paper')).training
        other = config('full', model, 0).training
        assert trained == other | sizes.session_training[kind]
        assert trained != other
