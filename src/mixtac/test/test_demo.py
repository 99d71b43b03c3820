# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The demo as a user runs it: processes, middleware, summary, figure and bag."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from rosbags.highlevel import AnyReader

from mixtac_core.node.topics import EVENTS, FORCE, IMAGE_RAW, TOPICS
from mixtac_core.recordings.bag import typestore

if TYPE_CHECKING:
    from pathlib import Path

SECONDS = 12.0

pytestmark = [pytest.mark.dds, pytest.mark.timeout(1000)]


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


def test_the_bag_opens_in_another_reader(run: Path):
    with AnyReader([run / 'bag'], default_typestore=typestore()) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        assert types == {t.resolved('mixtac'): t.type_name for t in TOPICS}
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts[FORCE.resolved('mixtac')] > 450 * (SECONDS - 2)
    assert counts[EVENTS.resolved('mixtac')] > 450 * (SECONDS - 2)
    assert counts[IMAGE_RAW.resolved('mixtac')] > 20 * (SECONDS - 2)
