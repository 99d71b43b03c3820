# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the shipped profiles of Fast DDS are for, over real DDS."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import psutil
import pytest

from mixtac_core.node.process import FASTDDS_VARIABLES, profile_environment


def uses_fast_dds() -> bool:
    rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
    return 'fastrtps' in rclpy.get_rmw_implementation_identifier()


def test_the_profile_of_the_user_stays() -> None:
    assert profile_environment({'FASTRTPS_DEFAULT_PROFILES_FILE': '/mine.xml'}) == {}
    assert profile_environment({'FASTDDS_DEFAULT_PROFILES_FILE': '/mine.xml'}) == {}


@pytest.mark.parametrize(
    ('reach', 'name'),
    [('LOCALHOST', 'local'), ('OFF', 'local'), ('SUBNET', 'network'), ('', 'network')],
)
def test_the_range_of_discovery_decides(reach: str, name: str) -> None:
    chosen = profile_environment({'ROS_AUTOMATIC_DISCOVERY_RANGE': reach})
    # Ours stays in a shell in which the range is changed.
    for before in ('LOCALHOST', 'SUBNET'):
        ours = profile_environment({'ROS_AUTOMATIC_DISCOVERY_RANGE': before})
        assert profile_environment({**ours, 'ROS_AUTOMATIC_DISCOVERY_RANGE': reach}) == chosen
    assert set(chosen) == set(FASTDDS_VARIABLES)
    (path,) = {Path(each) for each in chosen.values()}
    assert path.name == f'{name}.xml'
    text = path.read_text(encoding='utf-8')
    assert ET.fromstring(text).tag.endswith('dds')
    assert ('interfaceWhiteList' in text) == (name == 'local')


def test_the_environment_of_a_clone_follows_the_range_as_well() -> None:
    source = f'. {Path(__file__).resolve().parents[4]}/tools/env.sh'
    show = f'echo ${FASTDDS_VARIABLES[0]}'
    script = f'{source}; export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET; {source}; {show};'
    script += f'export {FASTDDS_VARIABLES[0]}=/mine.xml; {source}; {show}'
    shown = subprocess.run(['bash', '-c', script], check=True, capture_output=True, text=True)
    assert [Path(each).name for each in shown.stdout.split()] == ['network.xml', 'mine.xml']


@pytest.mark.dds
def test_nothing_listens_beyond_this_machine(ros_domain: dict[str, str]) -> None:
    if not uses_fast_dds():
        pytest.skip('needs rmw_fastrtps')
    script = (
        "import rclpy, time; rclpy.init(); n = rclpy.create_node('n'); print('up', flush=True); "
        'time.sleep(60)'
    )
    process = subprocess.Popen(
        [sys.executable, '-c', script], env=ros_domain, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == 'up\n'
        # Ports of the DDS standard (RTPS 2.2, 9.6.1); sockets that only send have random ones.
        first = 7400 + 250 * int(ros_domain['ROS_DOMAIN_ID'])
        found = [
            each.laddr
            for each in psutil.Process(process.pid).net_connections('udp')
            if each.laddr and first <= each.laddr.port < first + 250
        ]
        assert found
        assert {each.ip for each in found} == {'127.0.0.1'}
    finally:
        process.kill()
        process.wait()
