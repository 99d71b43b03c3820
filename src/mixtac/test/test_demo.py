# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The demo as a user runs it, and what it computes from the streams of its bag."""

from __future__ import annotations

import json
import subprocess
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from rosbags.highlevel import AnyReader

from mixtac.demo import compare
from mixtac_core.node.topics import EVENTS, FORCE, IMAGE_RAW, TOPICS
from mixtac_core.recordings.bag import typestore

if TYPE_CHECKING:
    from pathlib import Path

SECONDS = 12.0

pytestmark = pytest.mark.timeout(1000)


@pytest.fixture(scope='module')
def run(module_ros_domain, tmp_path_factory) -> Path:
    """Run a short demo on the default sensor, which no model was trained on; return its folder."""
    out = tmp_path_factory.mktemp('demo') / 'run'
    command = [sys.executable, '-m', 'mixtac', 'demo', '--seconds', str(SECONDS)]
    command += ['--seed', '77', '--out', str(out)]
    result = subprocess.run(
        command, env=module_ros_domain, capture_output=True, text=True, timeout=900, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert '\x1b[' not in result.stdout, 'control codes although there is no terminal'
    return out


@pytest.mark.dds
def test_the_summary_has_its_figures_and_a_picture(run: Path):
    report = json.loads((run / 'demo.json').read_text())
    assert {'force_hz', 'lost'} <= set(report)
    assert (report['mae_n'] is None) == bool(report['refused'])
    if report['waited_s'] > 0.5:
        pytest.skip('frames and taps get lost on a machine that is too busy')
    assert 0.8 < report['gain'] < 1.6
    assert report['mae_n'] < 0.10
    assert abs(report['clock_drift_ppm']) < 500
    assert (run / 'demo.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.dds
def test_the_bag_opens_in_another_reader(run: Path):
    with AnyReader([run / 'bag'], default_typestore=typestore()) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        assert types == {t.resolved('mixtac'): t.type_name for t in TOPICS}
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts[FORCE.resolved('mixtac')] > 450 * (SECONDS - 2)
    assert counts[EVENTS.resolved('mixtac')] > 450 * (SECONDS - 2)
    assert counts[IMAGE_RAW.resolved('mixtac')] > 20 * (SECONDS - 2)


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
