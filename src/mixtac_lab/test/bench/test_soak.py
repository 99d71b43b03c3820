# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slopes and figures of the soak run; the graph itself runs in the pipeline's tests."""

from __future__ import annotations

import numpy as np
import psutil
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_lab.bench.soak import draw, force_figures, resources, slopes
from mixtac_node.process import GraphError


def test_slopes_are_found_within_their_errors(tmp_path):
    rng = np.random.default_rng(0)
    t_s = np.arange(0.0, 1800.0, 5.0)
    samples = [
        {'t_s': t, 'driver rss [MiB]': 90.0 + 6.0 * t / 3600.0 + noise, 'driver threads': 7.0}
        for t, noise in zip(t_s.tolist(), rng.normal(0.0, 0.5, len(t_s)).tolist(), strict=True)
    ]
    # What is large at the start is left out.
    samples[0]['driver rss [MiB]'] = 500.0
    found = slopes(samples)
    memory = found['driver rss [MiB]']
    assert abs(memory['per_hour'] - 6.0) < 4.0 * memory['standard_error'] < 2.0
    assert found['driver threads']['per_hour'] == pytest.approx(0.0)
    draw(samples, tmp_path / 'soak.png', 'soak')
    assert (tmp_path / 'soak.png').stat().st_size > 0


def test_missing_windows_and_the_mean_force_of_a_period():
    stamp_ns = 2_000_000 * np.array([1, 2, 3, 6, 7], np.int64)
    force = np.array([0.5, 0.1, 0.3, 0.2, 0.2])
    found = force_figures(stamp_ns, stamp_ns, force, 1)
    assert found['force windows missing'] == 2
    assert found['zero [N]'] == pytest.approx(0.2)
    assert found['force [Hz]'] == pytest.approx(4 / 0.012)
    assert force_figures(stamp_ns, stamp_ns, force, 5)['force [Hz]'] == 0.0


def test_windows_missing_between_periods_are_in_the_later_one():
    stamp_ns = 2_000_000 * np.array([1, 2, 3, 6, 7], np.int64)
    parts = [
        force_figures(stamp_ns[:end], stamp_ns[:end], np.zeros(end), first)
        for first, end in ((1, 3), (3, 3), (3, 5))
    ]
    assert [each['force windows missing'] for each in parts] == [0, 0, 2]
    assert [each['force [Hz]'] for each in parts] == pytest.approx([500.0, 0.0, 2 / 0.008])


def test_a_process_that_has_ended_is_named():
    found = resources({'me': psutil.Process()})
    assert found['me rss [MiB]'] > 1.0
    assert found['me threads'] >= 1

    class Gone(psutil.Process):
        def num_fds(self) -> int:
            raise psutil.NoSuchProcess(1)

    with pytest.raises(GraphError, match='driver'):
        resources({'driver': Gone()})
