# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sizes of the networks and times of their steps."""

from __future__ import annotations

import numpy as np
import pytest

from mixtac_learning.experiments import model


def test_paper_network_is_counted_and_timed(monkeypatch):
    monkeypatch.setattr(model, 'REPETITIONS', 2)
    parameters, operations, interval, packet = model.paper_rows()
    assert parameters.ours.mean == pytest.approx(parameters.paper, rel=0.005)
    assert operations.ours.mean == pytest.approx(operations.paper, rel=0.01)
    assert not parameters.simulated
    assert interval.ours.mean > 0.0
    assert packet.ours.mean > 0.0
    assert interval.ours.count == packet.ours.count == 2


def test_steps_have_a_median_and_a_percentile_of_their_own_number(monkeypatch):
    times = np.linspace(0.0, 1.0, 101).tolist()
    monkeypatch.setattr(model, 'step_times_ms', lambda _seconds: (times, [2.0] * 7))
    steps = [row for row in model.our_rows(1.0) if ' step' in row.name]
    assert [row.ours.mean for row in steps] == pytest.approx([0.5, 0.99, 2.0, 2.0])
    assert {row.ours.spread for row in steps} == {0.0}
    assert [row.paper for row in steps] == [model.LATENCY_MS, None, None, None]
    assert all('101' in row.conditions for row in steps[:2])


def test_each_window_and_each_frame_after_the_reference_is_timed():
    window_ms, frame_ms = model.step_times_ms(2.6)
    assert len(window_ms) > 1000
    assert 45 < len(frame_ms) < 70
    assert min(window_ms) > 0.0
