# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rates, recent values, and the log of a compilation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from mixtac_core.node.diagnostics import DiagnosticsPublisher, RateMeter, RecentValues, Status


def test_rate_is_counts_over_time():
    meter = RateMeter()
    assert meter.read(10.0) == 0.0
    meter.add(500)
    assert meter.read(11.0) == pytest.approx(500.0)
    meter.add()
    assert meter.read(13.0) == pytest.approx(0.5)
    assert meter.total == 501


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50),
    st.integers(1, 20),
    st.floats(0, 1),
)
def test_quantiles_are_those_of_the_latest_values(values: list[float], size: int, q: float):
    recent = RecentValues(size)
    for value in values:
        recent.add(value)
    assert recent.quantile(q) == pytest.approx(float(np.quantile(values[-size:], q)))


def test_a_node_that_compiles_logs_it_once(tmp_path, monkeypatch):
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    logged: list[str] = []
    node = SimpleNamespace(
        create_publisher=lambda *_: None,
        create_timer=lambda *_: None,
        get_logger=lambda: SimpleNamespace(info=logged.append),
    )
    diagnostics = DiagnosticsPublisher(node, 'none', lambda: Status(0, 'ready'))
    kernel = njit(lambda x: x + 1)
    for _ in range(2):
        with diagnostics.compiling('a test'):
            assert kernel(1) == 2
    assert len(logged) == 1
