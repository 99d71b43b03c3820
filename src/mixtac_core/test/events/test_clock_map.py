# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The running clock map on made-up arrivals whose clocks are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixtac_core.events.clock_map import ClockMap

EPOCH_NS = 1_760_000_000_000_000_000


def arrivals(seconds, skew_ppm, delays_us, period_us=2000, start_us=0):
    """Camera times [us] and host times [ns] of arrival."""
    camera = start_us + np.arange(0, int(seconds * 1e6), period_us, dtype=np.int64)
    true = EPOCH_NS + np.round(camera * 1000.0 * (1 + skew_ppm * 1e-6)).astype(np.int64)
    return camera, true, true + np.round(delays_us[: len(camera)] * 1000).astype(np.int64)


def mapped(camera, host):
    clock = ClockMap()
    for pair in zip(camera.tolist(), host.tolist(), strict=True):
        clock.add(*pair)
    return clock


@settings(max_examples=15)
@given(st.floats(-100, 100), st.floats(0, 3000), st.integers(0, 1000))
def test_skew_and_offset_are_found_under_one_sided_delays(skew, base, seed):
    rng = np.random.default_rng(seed)
    delays = base + rng.exponential(300, 20_000)
    camera, true, host = arrivals(40, skew, delays)
    clock = mapped(camera, host)
    estimate = clock.estimate()
    assert estimate.skew_ppm == pytest.approx(skew, abs=3)
    error_us = (clock.to_host_ns(int(camera[-1])) - true[-1]) / 1000 - base
    assert abs(error_us) < 60
    assert estimate.steps == 0


@settings(max_examples=20)
@given(st.floats(-200, 200), st.integers(-10_000_000, 100_000_000))
def test_both_directions_agree(skew, ahead_us):
    camera, _, host = arrivals(15, skew, np.random.default_rng(1).exponential(200, 7500))
    clock = mapped(camera, host)
    t = int(camera[-1]) + ahead_us
    assert abs(clock.to_camera_us(clock.to_host_ns(t)) - t) <= 1


def test_single_late_data_do_not_move_the_map():
    delays = np.full(10_000, 100.0)
    camera, _, host = arrivals(20, 20, delays)
    quiet = mapped(camera, host)
    host[np.random.default_rng(0).random(len(host)) < 0.2] += 50_000_000
    noisy = mapped(camera, host)
    t = int(camera[-1])
    assert abs(noisy.to_host_ns(t) - quiet.to_host_ns(t)) < 5000
    assert noisy.estimate().steps == 0


@pytest.mark.parametrize('jump_s', [-3.0, -0.5, 0.5, 3600.0])
def test_steps_of_the_host_clock_are_followed(jump_s):
    camera, _, host = arrivals(20, 0, np.full(10_000, 100.0))
    host[5000:] += int(jump_s * 1e9)
    clock = mapped(camera, host)
    assert clock.estimate().steps == 1
    assert abs(clock.to_host_ns(int(camera[-1])) - host[-1]) < 1_000_000


def test_restart_forgets():
    clock = ClockMap()
    assert not clock.ready
    clock.add(1000, EPOCH_NS)
    clock.add(1_000_000, EPOCH_NS)
    # The span is too short for a skew.
    assert (clock.ready, clock.estimate().steps, clock.estimate().skew_ppm) == (True, 1, 0.0)
    clock.restart()
    assert not clock.ready
    assert clock.estimate().steps == 0
