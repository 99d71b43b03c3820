# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The retarded responses of the gel against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_alignment.gel_lag import TIMES_S, LaggedForce


def test_means_over_exposures_are_those_of_a_smooth_force() -> None:
    t = np.arange(0.0, 2.0, 1.25e-3)
    lagged = LaggedForce(t, np.sin(5.0 * t))
    start = np.linspace(0.2, 1.7, 20)
    mean, slope = lagged.mean(start, start + 0.03)
    wanted = (np.cos(5.0 * start) - np.cos(5.0 * (start + 0.03))) / (5.0 * 0.03)
    assert mean[:, 0] == pytest.approx(wanted, abs=1e-6)
    rise = (np.sin(5.0 * (start + 0.03)) - np.sin(5.0 * start)) / 0.03
    assert slope[:, 0] == pytest.approx(rise, abs=1e-4)


def test_a_ramp_is_answered_by_the_slope_times_each_retardation_time() -> None:
    """After a high-pass of time T, a ramp of slope s settles at s T; short times have settled."""
    t = np.arange(0.0, 2.0, 1.25e-3)
    mean, _ = LaggedForce(t, 3.0 * t).mean(np.array([1.8]), np.array([1.81]))
    responses = np.delete(mean[0, 1:], 2)
    assert responses[:3] == pytest.approx(3.0 * np.array(TIMES_S[:3]), rel=1e-3)


def test_two_samples_are_joined_by_a_line() -> None:
    mean, _ = LaggedForce(np.array([0.0, 1.0]), np.array([1.0, 3.0])).mean(
        np.array([0.25]), np.array([0.75])
    )
    assert mean[0, 0] == pytest.approx(2.0)
