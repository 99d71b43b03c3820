# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The virtual grasp as a process of its own: clocks and frames of what it publishes."""

from __future__ import annotations

import struct

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import PointStamped, WrenchStamped
from std_srvs.srv import Trigger

from mixtac_core.node.base_node import QOS_FORCE
from mixtac_core.node.topics import stamp_to_ns
from mixtac_sim.usb.pyusb_backend import SocketLink

pytestmark = pytest.mark.dds
FORCE, TRUTH = '/mixtac/force', '/mixtac/truth/wrench'


def time_s(message):
    return 1e-9 * stamp_to_ns(message.header.stamp)


def values(message):
    force = message.wrench.force
    return force.x, force.y, force.z


def test_the_force_goes_by_the_clock_of_the_camera(node_under_test, tmp_path):
    graph, path = node_under_test, str(tmp_path / 'camera.sock')
    force = graph.listen(WrenchStamped, FORCE, QOS_FORCE)
    truth = graph.listen(WrenchStamped, TRUTH, QOS_FORCE)
    node = ('mixtac_sim.virtual_grasp_node', f'socket:={path}', 'preset:=easy', 'skew_ppm:=500.0')
    graph.start(*node)
    graph.spin_until(lambda: force)
    link = SocketLink(path)
    link.control((0x40, 0xBF, 0, 2), struct.pack('>I', 1), 1000)
    force.clear()

    graph.spin_until(lambda: len(force) > 1500)
    link.close()
    # The same wrench was published as the truth and as the force.
    true_s = {values(message): time_s(message) for message in truth}
    found = [(true_s.get(values(each), np.nan), time_s(each)) for each in force[100:]]
    pairs = np.array([pair for pair in found if pair[0] == pair[0]])
    assert np.ptp(pairs[:, 0]) > 0.5
    # A fit over seconds distinguishes 500 ppm from zero.
    rate = np.polyfit(*(pairs - pairs[0]).T, 1)[0]
    assert rate - 1.0 == pytest.approx(500e-6, abs=50e-6)
    assert graph.stop()[0] == 0


def test_what_is_struck_goes_down_in_the_contact_frame_and_drags_the_skin_along(
    node_under_test, tmp_path
):
    graph = node_under_test
    truth = graph.listen(WrenchStamped, TRUTH, QOS_FORCE)
    places = graph.listen(PointStamped, '/mixtac/truth/object', QOS_FORCE)
    graph.start('mixtac_sim.virtual_grasp_node', f'socket:={tmp_path}/camera.sock', 'preset:=easy')
    graph.spin_until(lambda: places)
    assert graph.call(Trigger, '/mixtac/virtual_grasp/knock').success
    graph.spin_until(lambda: places[-1].point.y < -1e-4)
    assert places[-1].header.frame_id == truth[-1].header.frame_id == 'mixtac_contact'
    assert (places[-1].point.x, places[-1].point.z) == (0.0, 0.0)
    force = truth[-1].wrench.force
    assert force.y < 0.0 < force.z
