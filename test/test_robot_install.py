# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A robot runs the sensor with neither PyTorch, matplotlib nor the simulator.

The nodes run in this environment with those modules hidden.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

ROOT = Path(__file__).resolve().parents[1]
HIDDEN = ('torch', 'matplotlib', 'mixtac_sim', 'mixtac_learning', 'mixtac')
NODES = {
    'driver': 'mixtac_driver.node.driver_node',
    'fger': 'mixtac_fger.fger_node',
    'slip_control': 'mixtac_slip_control.slip_control_node',
    'alignment': 'mixtac_fger.alignment.alignment_node',
}
HIDE = f"""
import importlib, sys
sys.modules.update(dict.fromkeys({HIDDEN}))  # importing them fails
sys.argv = sys.argv[1:]
sys.exit(importlib.import_module(sys.argv[0]).main())
"""


@pytest.mark.dds
@pytest.mark.parametrize('node', NODES)
def test_nodes_start_with_nothing_that_robots_lack(node: str, node_under_test: Any):
    command = [sys.executable, '-c', HIDE, NODES[node], '--ros-args']
    process = subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    look = node_under_test.node.get_node_names
    try:
        # Without a camera the driver says so and ends.
        node_under_test.spin_until(
            lambda: process.poll() is not None or (node != 'driver' and node in look())
        )
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
        assert 'Traceback' not in output
        assert ('device:=virtual' in output) == (node == 'driver')
    finally:
        process.kill()
        process.wait()
