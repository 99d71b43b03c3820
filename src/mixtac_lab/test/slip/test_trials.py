# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles with misses, and trials that are read back from the store."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np

from mixtac_lab.slip.trials import COURSE_MS, TrialResult, latency_quantiles, stored_trial


def test_misses_are_later_than_everything() -> None:
    assert latency_quantiles([1.0, 2.0, 3.0]) == {'p50': 2.0, 'p99': 3.0}
    assert latency_quantiles([1.0, 2.0, float('nan')]) == {'p50': 2.0, 'p99': None}
    assert latency_quantiles([]) == {'p50': None, 'p99': None}


def test_a_stored_trial_has_its_misses_back() -> None:
    fields = {each.name: 1.0 for each in dataclasses.fields(TrialResult)}
    result = TrialResult(**fields | {'arrest_ms': math.nan, 'held': False})
    stored = result.as_dict() | {'course_mm': [0.25] * len(COURSE_MS)}
    assert stored['arrest_ms'] is None
    found, course = stored_trial(json.loads(json.dumps(stored, allow_nan=False)))
    assert math.isnan(found.arrest_ms)
    assert dataclasses.replace(found, arrest_ms=1.0) == dataclasses.replace(result, arrest_ms=1.0)
    np.testing.assert_array_equal(course, 0.25)
