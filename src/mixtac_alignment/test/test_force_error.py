# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running errors of estimates against the interpolated reference."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_alignment.force_error import ForcePairing


def test_errors_are_those_against_the_interpolated_reference() -> None:
    pairing, rng = ForcePairing(), np.random.default_rng(1)
    times = np.sort(rng.choice(1_000_000_000, 400, replace=False))
    errors = rng.normal(0.0, 0.1, 400)
    reference = np.arange(0, 1_000_000_001, 1_250_000)
    estimates = iter(zip(times, 2e-9 * times + errors, strict=True))
    waiting = next(estimates)
    for t in reference:
        pairing.push_reference(int(t), 2e-9 * t)
        while waiting is not None and waiting[0] <= t:
            pairing.push_estimate(int(waiting[0]), float(waiting[1]))
            waiting = next(estimates, None)
    assert pairing.pairs == 400
    assert pairing.unpaired == 0
    assert pairing.mae == pytest.approx(np.abs(errors).mean(), abs=1e-6)
    assert pairing.rmse == pytest.approx(np.sqrt(np.mean(errors**2)), abs=1e-6)


def test_estimates_wait_for_a_late_reference() -> None:
    pairing = ForcePairing()
    pairing.push_estimate(5_000_000, 1.0)
    assert pairing.pairs == 0
    pairing.push_reference(4_000_000, 0.0)
    pairing.push_reference(6_000_000, 1.0)
    assert pairing.pairs == 1
    assert pairing.mae == pytest.approx(0.5)


def test_what_has_no_reference_is_counted() -> None:
    pairing = ForcePairing(window=4, longest_gap_ns=10)
    pairing.push_reference(100, 0.0)
    pairing.push_estimate(50, 1.0)
    pairing.push_estimate(150, 1.0)
    pairing.push_reference(200, 0.0)
    assert (pairing.pairs, pairing.unpaired) == (0, 2)
    for k in range(6):
        pairing.push_estimate(300 + k, 1.0)
    assert pairing.unpaired == 4


def test_a_reference_that_steps_back_restarts() -> None:
    pairing = ForcePairing()
    pairing.push_reference(1000, 5.0)
    pairing.push_reference(100, 1.0)
    pairing.push_estimate(100, 1.5)
    assert pairing.mae == pytest.approx(0.5)
