# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ages, rates and losses of forces."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_lab.bench.programs.probe_node import force_figures


def test_ages_rate_and_missing_windows_of_forces():
    stamps = 10**15 + 2_000_000 * np.array([n for n in range(502) if n != 100])
    times = np.column_stack((stamps + 700_000, stamps)).astype(np.int64)
    times[50, 0] += 5_000_000
    figures = force_figures(times, clock_error_us=-200)
    assert figures['force_age_p50_ms'] == pytest.approx(0.5)
    assert figures['force_age_max_ms'] == pytest.approx(5.5)
    assert (figures['forces'], figures['windows_missing']) == (501, 1)
    assert figures['force_rate_hz'] == pytest.approx(500 / 1.002)
