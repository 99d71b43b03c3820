# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics says of the figures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.live_feed import WATCHED, LiveFeed, feed_diagnosis
from mixtac_fger.streaming import ForceEstimator
from mixtac_node.diagnostics import OK, WARN

STALE_S = 0.5


@pytest.fixture(scope='module')
def good(model):
    feed = LiveFeed(ForceEstimator(FgerEstimator(model)))
    feed.close()
    status = feed.status()
    estimator = replace(status.estimator, ready=True, reason='', frame_age_us=60_000)
    return replace(status, estimator=estimator, rate_hz=500.0)


def test_all_is_well(good):
    assert feed_diagnosis(good, STALE_S) == (OK, 'estimating')


def test_the_reason_for_no_force_comes_first(good):
    estimator = replace(good.estimator, ready=False, reason='waiting for a frame')
    found = replace(good, estimator=estimator, rate_hz=0.0, lately={'lost_packets': 3})
    level, text = feed_diagnosis(found, STALE_S)
    assert level == WARN
    assert text.startswith('waiting for a frame; ')
    assert '3 event packets lost' in text


def test_no_packets(good):
    level, text = feed_diagnosis(replace(good, rate_hz=0.0), STALE_S)
    assert level == WARN
    assert 'no event packets arrive' in text


def test_old_frames(good):
    old = replace(good, estimator=replace(good.estimator, frame_age_us=700_000))
    level, text = feed_diagnosis(old, STALE_S)
    assert level == WARN
    assert '0.7 s old' in text


@pytest.mark.parametrize('name', WATCHED)
def test_every_watched_counter_warns(good, name):
    level, text = feed_diagnosis(replace(good, lately={name: 7}), STALE_S)
    assert level == WARN
    assert f'7 {WATCHED[name]}' in text


def test_every_watched_counter_is_one(good):
    for name in WATCHED:
        assert isinstance(getattr(good, name, getattr(good.estimator, name, None)), int)
