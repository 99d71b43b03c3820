# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record` without a sensor, and a recording that an error ends."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_core.recordings.bag import BagFile

pytestmark = pytest.mark.dds
END_S = 60.0


def test_without_a_sensor_nothing_is_recorded(ros_domain, tmp_path):
    words = [sys.executable, '-m', 'mixtac', 'record', str(tmp_path / 'bag'), '--wait', '0']
    result = subprocess.run(
        words, env=ros_domain, timeout=END_S, capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    assert '/mixtac/events' in result.stderr
    assert list(tmp_path.iterdir()) == []


FAILING = """
import sys
from pathlib import Path
from mixtac.recorder_node import Listener
with Listener.opened('record', 'mixtac') as listener:
    listener.listen('/ft_sensor/wrench')
    listener.start(Path(sys.argv[1]))
    raise SystemExit(3)
"""


def test_an_error_leaves_a_bag_that_is_whole(ros_domain, tmp_path):
    command = [sys.executable, '-c', FAILING, str(tmp_path / 'bag')]
    assert subprocess.run(command, env=ros_domain, timeout=END_S, check=False).returncode == 3
    with BagFile(tmp_path / 'bag') as found:
        assert found.damage == ''
