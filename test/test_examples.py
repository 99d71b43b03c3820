# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every example runs to its end; that of the calibration beside the tests of its command."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mixtac_sim.bags.trial_bag import write_trial
from mixtac_sim.world.plans import plan_profile

pytestmark = pytest.mark.timeout(600)  # a busy machine may take its time
EXAMPLES = Path(__file__).resolve().parents[1] / 'examples'


@pytest.fixture(scope='module')
def bags(tmp_path_factory) -> Path:
    """Return a folder with two copies of a simulated trial of five seconds, tapped at both ends."""
    folder = tmp_path_factory.mktemp('trials')
    spec = plan_profile('dynamic', 1, 5.0, 3)[0]
    write_trial(spec, folder)
    for name in ('a', 'b'):
        shutil.copytree(folder / spec.name, folder / 'bags' / name)
    return folder / 'bags'


@pytest.mark.parametrize(
    ('name', 'options', 'printed'),
    [
        ('read_force', ('BAG',), r'N \+- '),
        ('plot_live', ('BAG', '1', 'plot.png'), ''),
        ('record_and_read', ('BAG',), '125 frames'),
        ('align_reference', ('BAG',), 'drift'),
        ('contact_and_shear', ('BAG',), 'mm'),
        ('train_on_own_bags', ('BAGS',), 'wrote mine.safetensors'),
    ],
)
def test_an_example_runs_on_recordings(run_example, bags, name, options, printed):
    if name.startswith('train'):
        pytest.importorskip('torch', reason='needs the extra learn')
    places = {'BAG': str(bags / 'a'), 'BAGS': str(bags)}
    words = [places.get(each, each) for each in options]
    assert re.search(printed, run_example(name, *words))


@pytest.mark.dds
def test_the_subscriber_prints_the_published_force(ros_domain):
    rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
    from geometry_msgs.msg import WrenchStamped

    from mixtac_msgs.msg import ForceQuality

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(ros_domain['ROS_DOMAIN_ID']))
    node = rclpy.create_node('sensor', context=context)
    force = node.create_publisher(WrenchStamped, '/mixtac/force', 10)
    quality = node.create_publisher(ForceQuality, '/mixtac/force_quality', 10)
    wrench = WrenchStamped()
    wrench.wrench.force.z = 0.75
    command = [sys.executable, '-u', str(EXAMPLES / 'ros_subscriber.py'), '500']
    example = subprocess.Popen(command, env=ros_domain, stdout=subprocess.PIPE, text=True)
    try:
        while example.poll() is None:
            force.publish(wrench)
            quality.publish(ForceQuality(valid=True))
            time.sleep(0.002)
        assert '0.750 N' in example.stdout.read()
    finally:
        example.kill()
        rclpy.shutdown(context=context)
