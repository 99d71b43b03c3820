# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac up slip` as a whole over DDS: an impact is detected, the arm holds the object, all ends.

Nothing here depends on how fast the host is: simulated time waits for the nodes.
"""

from __future__ import annotations

import functools
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import numpy as np
import psutil
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')
pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')

from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from mixtac_core.node.base_node import QOS_FORCE, QOS_SENSOR
from mixtac_msgs.msg import SlipState
from mixtac_sim.arm import READY, flange_place

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = [pytest.mark.dds, pytest.mark.timeout(900)]
ARM_TOPIC = '/fr3_arm_controller/joint_trajectory'
PATIENCE_S = 600.0
"""Six processes compile what they need when their caches are empty."""
FALLEN_MM = 20.0
"""The open loop lets the object fall this far and farther."""


@pytest.fixture
def log(tmp_path) -> Path:
    return tmp_path / 'up.log'


@pytest.fixture
def process(ros_domain: dict[str, str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run `mixtac up slip`."""
    words = ['up', 'slip', '--preset', 'easy', '--every', '2.0', '--disturb', '50.0']
    with (
        log.open('w') as stream,
        subprocess.Popen(
            [sys.executable, '-m', 'mixtac', *words],
            env=ros_domain,
            stdout=stream,
            stderr=stream,
            # Where tests run in the background, an interrupt would be ignored from birth.
            preexec_fn=functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
        ) as started,
    ):
        yield started
        if started.poll() is None:
            started.terminate()


def test_an_impact_is_detected_and_the_object_held_and_everything_ends(
    node_under_test, process, log
) -> None:
    graph, slipped, deadline = node_under_test, [], time.monotonic() + PATIENCE_S

    def on_slip(message: SlipState) -> None:
        if message.slipping and message.state == SlipState.ENABLED:
            slipped.append(message)

    graph.node.create_subscription(SlipState, '/mixtac/slip', on_slip, QOS_FORCE)
    trajectories = graph.listen(JointTrajectory, ARM_TOPIC, 10)
    joints = graph.listen(JointState, '/joint_states', QOS_SENSOR)
    places = graph.listen(PointStamped, '/mixtac/truth/object', QOS_FORCE)
    while not slipped or 'the object moved' not in log.read_text():
        assert time.monotonic() < deadline, log.read_text()[-3000:]
        assert process.poll() is None, log.read_text()[-3000:]
        # The log is not read at each of some thousand messages per second.
        end_s = time.monotonic() + 0.1
        while (left_s := end_s - time.monotonic()) > 0.0:
            graph.executor.spin_once(timeout_sec=left_s)
    assert 'impact detected' in log.read_text()
    # The first one leads the controller to the measured positions and moves nothing.
    assert len(trajectories) > 1
    moved = [flange_place(np.array(each.position)) for each in joints[::10]]
    assert np.max(moved - flange_place(READY), axis=0)[1] > 1e-5
    assert 0.05 < max(-1e3 * each.point.y for each in places) < FALLEN_MM

    # Slip control got the estimate, never the truth itself.
    publishers = graph.node.get_publishers_info_by_topic('/mixtac/force')
    assert [each.node_name for each in publishers] == ['fger']

    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) == 6
    process.send_signal(signal.SIGINT)
    process.wait(120.0)
    gone, left = psutil.wait_procs(children, timeout=30.0)
    assert len(gone) == 6, left
    assert 'Traceback' not in log.read_text()
    _, summary, end = log.read_text().partition('impacts held')
    assert summary
    assert '[ERROR]' not in end
