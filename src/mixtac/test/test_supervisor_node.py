# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What is logged about an object that was struck, and the end where none can be."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from mixtac.supervisor_node import Impact
from mixtac_core.node.base_node import QOS_FORCE
from mixtac_msgs.msg import ForceQuality, SlipState

MS = 1e-3


def impact(stop_ms, rise_ms, mm=0.3, **more):
    """Return an impact at 10 ms: the object stops, and the force rises, at times [ms]."""
    t = np.arange(0, 400, 2)
    moved = np.interp(t, (10, stop_ms), (0.0, mm))
    force = np.where(t < rise_ms, 0.7, 0.9)
    places, forces = (list(zip(t * MS, y, strict=True)) for y in (moved, force))
    return Impact(0.55, places, forces, **more)


@pytest.mark.parametrize(
    ('found', 'held', 'words'),
    [
        (impact(22, 60, detected=True), True, 'at rest after 12 ms, before the force rose'),
        (impact(60, 32), True, 'the force rose from 22 ms on'),
        (impact(60, 1000), True, 'before the force rose'),
        (impact(200, 60, 50.0), False, 'not detected'),
        (impact(22, 60, stopped='too much force'), True, 'too much force'),
    ],
)
def test_an_impact_is_described_and_drawn(found, held, words, tmp_path):
    assert found.held == held
    assert words in str(found)
    found.draw(tmp_path / 'impact.png')
    assert (tmp_path / 'impact.png').exists()


@pytest.mark.dds
def test_slip_control_that_cannot_be_enabled_ends_with_its_reason(node_under_test):
    publish = node_under_test.node.create_publisher
    clock = publish(Clock, '/clock', 1)
    quality = publish(ForceQuality, '/mixtac/force_quality', QOS_FORCE)
    slip = publish(SlipState, '/mixtac/slip', QOS_FORCE)
    node_under_test.start('mixtac.supervisor_node', 'use_sim_time:=true')
    process, second = node_under_test.process, 0
    while process.poll() is None:
        second += 1
        clock.publish(Clock(clock=Time(sec=second)))
        quality.publish(ForceQuality(valid=True))
        slip.publish(SlipState(reason='contact lost'))
        node_under_test.executor.spin_once(timeout_sec=0.05)
    assert process.returncode == 1
    assert 'contact lost' in process.stderr
