# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running errors of the latest pairs."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_alignment.force_error_node import RunningError


def test_errors_are_those_of_the_latest_pairs() -> None:
    errors = np.random.default_rng(1).normal(0.0, 0.1, 400)
    running = RunningError(100)
    assert (running.pairs, running.mae, running.rmse) == (0, 0.0, 0.0)
    for k, error in enumerate(errors):
        running.push(k + error, float(k))
    latest = errors[-100:]
    assert running.pairs == 100
    assert running.mae == pytest.approx(np.abs(latest).mean())
    assert running.rmse == pytest.approx(np.sqrt(np.mean(latest**2)))


def test_a_force_that_is_no_number_is_left_out() -> None:
    running = RunningError(100)
    for reference in (1.0, float('nan'), float('inf')):
        running.push(1.25, reference)
    assert (running.pairs, running.mae, running.rmse) == (1, 0.25, 0.25)
