# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics says of the figures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mixtac_core.node.diagnostics import ERROR, OK, WARN
from mixtac_fger.fger_net import FgerEstimator
from mixtac_fger.live_feed import WATCHED, LiveFeed, feed_diagnosis
from mixtac_fger.streaming import ForceEstimator
from mixtac_fger.validity import Reason


@pytest.fixture(scope='module')
def good(model):
    feed = LiveFeed(ForceEstimator(FgerEstimator(model)))
    feed.close()
    status = feed.status()
    estimator = replace(status.estimator, ready=True, reason='', frame_age_us=60_000)
    return status._replace(estimator=estimator, rate_hz=500.0)


def test_all_is_well(good):
    assert feed_diagnosis(good) == (OK, 'estimating')


def test_the_reason_for_no_force_comes_first(good):
    estimator = replace(good.estimator, ready=False, reason='waiting for a frame')
    found = good._replace(estimator=estimator, rate_hz=0.0, lately={'lost_packets': 3})
    level, text = feed_diagnosis(found)
    assert level == WARN
    assert text.startswith('waiting for a frame; ')
    assert '3 event packets lost' in text


def test_no_packets(good):
    level, text = feed_diagnosis(good._replace(rate_hz=0.0))
    assert level == WARN
    assert 'no event packets arrive' in text


@pytest.mark.parametrize('reason', [each for each in Reason if each is not Reason.TRUSTED])
def test_a_force_that_cannot_be_trusted(good, reason):
    invalid = good._replace(estimator=replace(good.estimator, validity=reason.name))
    level, text = feed_diagnosis(invalid)
    assert level == (WARN if reason is Reason.ZERO_UNKNOWN else ERROR)
    assert reason.text in text


@pytest.mark.parametrize('name', WATCHED)
def test_every_watched_counter_warns(good, name):
    level, text = feed_diagnosis(good._replace(lately={name: 7}))
    assert level == WARN
    assert f'7 {WATCHED[name]}' in text
