# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The table: mean and spread, and suites whose trials never meet."""

from __future__ import annotations

import pytest

from mixtac_lab.experiments.sizes import (
    ALL_ROWS,
    OURS_MANY,
    TABLE_FULL,
    TABLE_REDUCED,
    table_run_config,
    test_specs,
    unseen_specs,
)
from mixtac_lab.experiments.studies.models import aggregate, as_markdown
from mixtac_learning.train.config import find_run_config, read_run_config
from mixtac_learning.train.run import training_sources

test_specs.__test__ = False


def test_mean_and_spread_over_seeds():
    def result(seed: int, mae: float) -> dict:
        return {'model': 'fger', 'seed': seed, 'figures': {'dynamic': {'mae': mae, 'r2': 0.5}}}

    table = aggregate([result(0, 0.1), result(1, 0.2), result(2, 0.3)])
    assert table['fger']['dynamic']['mae'] == {'mean': 0.2, 'spread': 0.1, 'seeds': 3}
    assert table['fger']['dynamic']['r2']['spread'] == 0.0
    assert '| fger | 0.200 +-0.100 |' in as_markdown(table)
    assert aggregate([result(0, 0.1)])['fger']['dynamic']['mae']['spread'] == 0.0


@pytest.mark.parametrize('model', ALL_ROWS)
def test_no_test_trial_is_trained_on(model):
    trained = [
        source.spec for source in training_sources(table_run_config(TABLE_FULL, model, 1, '').data)
    ]
    seen = test_specs(TABLE_FULL, trained[0].device_seed)
    unseen, presses = unseen_specs(TABLE_FULL)
    assert {s.device_seed for s in seen} <= {s.device_seed for s in trained}
    assert not {s.trial_seed for s in trained} & {s.trial_seed for s in [*seen, *unseen, *presses]}
    assert not {s.device_seed for s in trained} & {s.device_seed for s in unseen}
    assert not {s.trial_seed for s in unseen} & {s.trial_seed for s in presses}
    names = [spec.name for spec in [*seen, *unseen, *presses]]
    assert len(set(names)) == len(names)


def test_all_seeds_see_the_same_trials():
    runs = [table_run_config(TABLE_FULL, 'fger', seed, '') for seed in (0, 1)]
    assert runs[0].data == runs[1].data
    assert runs[0].training != runs[1].training


def test_shipped_run_is_that_of_the_table():
    shipped = read_run_config(find_run_config('ours'))
    for suite in (TABLE_FULL, TABLE_REDUCED):
        assert shipped.fingerprint() == table_run_config(suite, OURS_MANY, 0, '').fingerprint()
