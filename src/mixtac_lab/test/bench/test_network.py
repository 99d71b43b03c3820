# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Driver and estimator in two network namespaces, with a link that loses, delays and reorders."""

from __future__ import annotations

import contextlib
import json
import sys
import textwrap
import time

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from lossy_link import LossyLink, Quality, why_not

from mixtac_node.graph import NodeSpec
from mixtac_node.process import JsonProcess, ProcessGroup

NAMESPACE = 'mixtac_net'
PATIENCE_S = 120.0
WATCHER = textwrap.dedent(
    """
    import json, sys, time
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import WrenchStamped
    from mixtac_node.base_node import QOS_FORCE
    from mixtac_node.lifecycle_node import LifecycleClient
    from mixtac_node.stamps import stamp_to_us
    from rclpy.signals import SignalHandlerOptions
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('watcher', namespace=sys.argv[1])
    found = {'forces': 0}

    def on_force(message):
        found['forces'] += 1
        found['stamp_us'] = stamp_to_us(message.header.stamp)

    def on_diagnostics(message):
        for status in message.status:
            if status.name.endswith('fger'):
                found.update({v.key: v.value for v in status.values if 'frames' in v.key})

    LifecycleClient(node, f'/{sys.argv[1]}/fger', lambda: None).bring_up()
    node.create_subscription(WrenchStamped, 'force', on_force, QOS_FORCE)
    node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
    while True:
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.05)
        print(json.dumps(found), flush=True)
    """
)


@pytest.mark.dds
def test_forces_go_on_after_a_loss(ros_domain, tmp_path):
    if reason := why_not():
        pytest.skip(reason)
    environment = {name: value for name, value in ros_domain.items() if 'PROFILES' not in name} | {
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
        'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4',
        'MIXTAC_HOME': str(tmp_path),
    }
    camera = {'device': f'virtual:{tmp_path}/usb.sock', 'compressed_frames': 'jpeg'}
    estimator = {'image_transport': 'compressed', 'invalid_force': 'publish', 'assume_free': True}
    programs = [sys.executable, '-m', 'mixtac_lab.bench.programs.camera', 'pattern']
    options = [f'--socket={tmp_path}/usb.sock', '--rate=20000', '--frame-interval=40000']
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(contextlib.closing(LossyLink()))
        group = stack.enter_context(ProcessGroup(tmp_path / 'log', environment))
        source = stack.enter_context(JsonProcess('camera', [*programs, *options], environment))
        source.expect('ready', PATIENCE_S)
        for side, package, name, values in (
            (0, 'mixtac_driver', 'driver', camera),
            (1, 'mixtac_fger', 'fger', estimator),
        ):
            spec = NodeSpec(package, f'{name}_node', name, overrides=values)
            group.start(name, link.command(side, *spec.command(NAMESPACE)))
        watcher = link.command(1, sys.executable, '-c', WATCHER, NAMESPACE)
        watch = stack.enter_context(JsonProcess('watcher', watcher, environment))

        def wait(enough) -> dict[str, object]:
            deadline_s = time.monotonic() + PATIENCE_S
            while time.monotonic() < deadline_s:
                group.check()
                found = watch.expect('forces', PATIENCE_S)
                if enough(found):
                    return found
            pytest.fail(json.dumps(found))

        wait(lambda found: found['forces'] > 500)
        link.quality = Quality(loss=0.05, delay_s=0.02, jitter_s=0.02, bytes_per_s=4e6)
        poor_us = time.time_ns() // 1000
        wait(lambda found: found['stamp_us'] > poor_us + 2_000_000)
        link.quality = Quality(loss=1.0)
        time.sleep(2.0)
        link.quality = Quality()
        restored_us = time.time_ns() // 1000
        found = wait(lambda found: found['stamp_us'] > restored_us - 500_000)
        # A second at rest; the rests of incomplete frames would stop them for half a minute.
        assert found['stamp_us'] < restored_us + 10_000_000
        again = found['forces']
        found = wait(lambda found: found['forces'] > again + 500)
        assert int(found['frames_missing']) > 0
        assert link.lost > 100
