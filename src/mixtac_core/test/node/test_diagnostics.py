# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Rates, recent values, and what is said while a node compiles."""

from __future__ import annotations

import threading
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
    kept = values[-size:]
    assert len(recent) == len(kept)
    assert recent.quantile(q) == pytest.approx(float(np.quantile(kept, q)))


def test_a_node_that_compiles_says_so_and_only_then(tmp_path, monkeypatch):
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    said, published = [], threading.Event()
    messages = []

    def publish(message):
        messages.append(message)
        published.set()

    stamp = pytest.importorskip('builtin_interfaces.msg', reason='needs ROS 2').Time()
    node = SimpleNamespace(
        create_publisher=lambda *_: SimpleNamespace(publish=publish),
        create_timer=lambda *_: None,
        get_logger=lambda: SimpleNamespace(info=said.append),
        get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: stamp)),
        get_fully_qualified_name=lambda: '/mixtac/test',
    )
    diagnostics = DiagnosticsPublisher(node, 'none', lambda: Status(0, 'ready'))
    kernel = njit(lambda x: x + 1)
    with diagnostics.compiling('a test'):
        assert kernel(1) == 2
        assert published.wait(10.0)
    assert len(said) == 1
    assert [status.message for status in messages[0].status] == said
    with diagnostics.compiling('a test'):
        kernel(1)
    assert len(said) == 1
    diagnostics.publish()
    assert messages[-1].status[0].message == 'ready'
