# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles with misses."""

from __future__ import annotations

from mixtac_lab.slip.trials import latency_quantiles


def test_misses_are_later_than_everything() -> None:
    assert latency_quantiles([1.0, 2.0, 3.0]) == {'p50': 2.0, 'p99': 3.0}
    assert latency_quantiles([1.0, 2.0, float('nan')]) == {'p50': 2.0, 'p99': None}
    assert latency_quantiles([1.0, 2.0, None]) == {'p50': 2.0, 'p99': None}
    assert latency_quantiles([]) == {'p50': None, 'p99': None}
