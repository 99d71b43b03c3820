# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the demo computes from the streams of its bag."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mixtac.demo import compare


def test_the_press_calibrates_and_the_drift_of_the_reference_is_removed():
    """A gain, and a zero that drifts along a line, do not appear in the error."""
    t_ms, force_ms = np.arange(10_000), np.arange(2, 10_001, 2)

    def load(at_ms):
        return 0.8 * ((at_ms > 3000) & (at_ms < 5000)) + 0.5 * ((at_ms > 6000) & (at_ms < 7000))

    recording = SimpleNamespace(force_t_s=1e-3 * t_ms, force=load(t_ms) + 0.02 + 1e-5 * t_ms)
    taps = [SimpleNamespace(camera_us=us) for us in (1_000_000, 9_000_000)]
    fit = SimpleNamespace(
        anchors=taps,
        to_camera=lambda s: np.rint(1e6 * s).astype(np.int64),
    )
    figures = compare(recording, 1000 * force_ms, load(force_ms) / 1.25, fit, (1.5, 4.5)).figures
    assert figures['gain'] == pytest.approx(1.25, rel=1e-3)
    assert figures['mae_n'] < 1e-3 < figures['mae_uncalibrated_n']
