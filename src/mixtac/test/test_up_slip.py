# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac up slip` as a whole over DDS: an impact is detected, the arm holds the object, all ends.

Nothing here depends on how fast the host is: simulated time waits for the nodes.
"""

from __future__ import annotations

import contextlib
import functools
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import numpy as np
import psutil
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('mixtac_msgs.msg', reason='needs the built workspace')
pytest.importorskip('event_camera_msgs.msg', reason='needs the built workspace')

from mixtac_sim.arm import READY, flange_place  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = [pytest.mark.dds, pytest.mark.timeout(900)]
ARM_TOPIC = '/fr3_arm_controller/joint_trajectory'
PATIENCE_S = 600.0
"""Six processes compile what they need when their caches are empty."""
FALLEN_MM = 20.0
"""The open loop lets the object fall this far and farther."""


class Witness:
    """Starts `mixtac up slip` and notes what its nodes say."""

    def __init__(self, env: dict[str, str], log) -> None:
        from geometry_msgs.msg import PointStamped
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

        from mixtac_core.node.base_node import QOS_FORCE, QOS_SENSOR
        from mixtac_msgs.msg import SlipState

        self.log = log
        options = ['--preset', 'easy', '--every', '2.0', '--disturb', '50.0']
        with log.open('w') as stream:
            self.process = subprocess.Popen(
                [sys.executable, '-m', 'mixtac', 'up', 'slip', *options],
                env=env,
                stdout=stream,
                stderr=stream,
                # Where tests run in the background, an interrupt would be ignored from birth.
                preexec_fn=functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
            )
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=int(env['ROS_DOMAIN_ID']))
        self.node = rclpy.create_node('witness', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.slipped_while_enabled = False
        self.trajectories: list[JointTrajectory] = []
        self.joints: list[JointState] = []
        self.lowest_mm = 0.0
        listen = self.node.create_subscription
        listen(SlipState, '/mixtac/slip', self._on_slip, QOS_FORCE)
        listen(JointTrajectory, ARM_TOPIC, self.trajectories.append, 10)
        listen(JointState, '/joint_states', self.joints.append, QOS_SENSOR)
        listen(PointStamped, '/mixtac/truth/object', self._on_place, QOS_FORCE)

    def _on_slip(self, message) -> None:
        self.slipped_while_enabled |= message.slipping and message.state == message.ENABLED

    def _on_place(self, message) -> None:
        self.lowest_mm = max(self.lowest_mm, -1e3 * message.point.y)

    def words(self) -> str:
        return self.log.read_text(errors='replace')

    def wait(self, condition) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, self.words()[-3000:]
            assert self.process.poll() is None, self.words()[-3000:]
            # The log is not read at each of some thousand messages per second.
            end = time.monotonic() + 0.1
            while (left_s := end - time.monotonic()) > 0.0:
                self.executor.spin_once(timeout_sec=left_s)

    def close(self) -> None:
        self.node.destroy_node()
        self.context.try_shutdown()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(60.0)
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


@pytest.fixture
def witness(ros_domain: dict[str, str], tmp_path) -> Iterator[Witness]:
    made = Witness(ros_domain, tmp_path / 'up.log')
    yield made
    made.close()


def test_an_impact_is_detected_and_the_object_held_and_everything_ends(witness: Witness) -> None:
    witness.wait(lambda: 'the object moved' in witness.words())
    assert 'impact detected' in witness.words(), witness.words()
    witness.wait(lambda: witness.slipped_while_enabled)
    assert witness.slipped_while_enabled
    # The first one leads the controller to the measured positions and moves nothing.
    assert len(witness.trajectories) > 1
    places = [flange_place(np.array(each.position)) for each in witness.joints[::10]]
    assert np.max(places - flange_place(READY), axis=0)[1] > 1e-5
    assert 0.05 < witness.lowest_mm < FALLEN_MM

    # Slip control got the estimate, never the truth itself.
    publishers = witness.node.get_publishers_info_by_topic('/mixtac/force')
    assert [each.node_name for each in publishers] == ['fger']

    children = psutil.Process(witness.process.pid).children(recursive=True)
    assert len(children) == 6
    witness.process.send_signal(signal.SIGINT)
    witness.process.wait(120.0)
    gone, left = psutil.wait_procs(children, timeout=30.0)
    assert len(gone) == 6, left
    assert 'Traceback' not in witness.words()
    _, summary, end = witness.words().partition('impacts held')
    assert summary
    assert '[ERROR]' not in end
