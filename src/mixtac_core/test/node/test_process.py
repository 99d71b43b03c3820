# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Starting, watching and ending processes; what the shipped profiles of Fast DDS are for."""

from __future__ import annotations

import fcntl
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree as ET

import psutil
import pytest

from mixtac_core.node.process import (
    FASTDDS_VARIABLES,
    GraphError,
    ProcessGroup,
    fatal_text,
    profile_environment,
)

WAIT = [sys.executable, '-c', 'import time; time.sleep(60)']


def wait_until(condition, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert condition()


def died(group: ProcessGroup) -> bool:
    try:
        group.check()
    except GraphError:
        return True
    return False


def test_a_dead_process_is_named_with_its_last_words_and_the_others_are_ended(tmp_path: Path):
    script = "import sys; print('error: no camera'); print('bye'); sys.exit(3)"
    with ProcessGroup(tmp_path) as group:
        group.start('other', WAIT)
        other = psutil.Process(group.pid('other'))
        group.check()
        group.start('driver', [sys.executable, '-c', script])
        wait_until(lambda: died(group))
        with pytest.raises(GraphError) as caught:
            group.check()
    assert 'status 3' in str(caught.value)
    assert str(caught.value).endswith('no camera')
    assert not other.is_running()


def test_why_a_node_ends_is_read_from_its_last_words():
    assert fatal_text('error: no camera\n') == 'no camera'
    assert fatal_text('[INFO] [1.0] [driver]: error: no camera') == ''


def test_a_process_that_ignores_sigterm_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr('mixtac_core.node.process.STOP_GRACE_S', 0.5)
    script = (
        'import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); '
        "print('ready', flush=True); time.sleep(60)"
    )
    group = ProcessGroup(tmp_path)
    group.start('deaf', [sys.executable, '-c', script])
    wait_until(lambda: 'ready' in (tmp_path / 'deaf.log').read_text())
    assert group.stop() == {'deaf': -9}


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_no_process_outlives_the_group_however_it_is_ended(tmp_path: Path, number: int):
    if number == signal.SIGKILL and shutil.which('setpriv') is None:
        pytest.skip('needs setpriv (util-linux)')
    script = (
        'import sys, time; from pathlib import Path; '
        'from mixtac_core.node.process import ProcessGroup\n'
        'with ProcessGroup(Path(sys.argv[1])) as group:\n'
        f'    group.start("node", {WAIT!r}); print("ready", flush=True); time.sleep(60)\n'
    )
    parent = subprocess.Popen(
        [sys.executable, '-c', script, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    assert parent.stdout.readline() == 'ready\n'
    (child,) = psutil.Process(parent.pid).children()
    # Only once it is the command itself does it end with its parent.
    wait_until(lambda: 'setpriv' not in child.name())
    parent.send_signal(number)
    code = parent.wait(30)
    assert code == (-number if number == signal.SIGKILL else 128 + number)
    wait_until(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)


COMPILES = """
import time
from numba import njit
from mixtac_core.node.process import compiling

@njit
def kernel(x):
    time_it_takes = x + 1
    return time_it_takes

with compiling('a test', lambda: print('compiles', flush=True)):
    print('inside', flush=True)
    if {compiles}:
        kernel(1)
        print('begun', flush=True)
    input()
print('out', flush=True)
"""


def compiler(folder: Path, *, compiles: bool) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, '-c', COMPILES.format(compiles=compiles)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, 'TMPDIR': str(folder)},
    )


def test_kernels_are_compiled_by_one_process_at_a_time(tmp_path: Path):
    with compiler(tmp_path, compiles=True) as first:
        assert [first.stdout.readline() for _ in range(3)] == ['inside\n', 'compiles\n', 'begun\n']
        (lock,) = (tmp_path / f'mixtac-kernels-{os.getuid()}').iterdir()
        with lock.open('w') as mine:
            with pytest.raises(BlockingIOError):
                fcntl.flock(mine, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with compiler(tmp_path, compiles=False) as warm:
                # What is compiled already waits for nobody.
                assert warm.communicate('\n')[0] == 'inside\nout\n'
            assert first.communicate('\n')[0] == 'out\n'
            fcntl.flock(mine, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with compiler(tmp_path, compiles=True) as second:
                assert [second.stdout.readline() for _ in range(2)] == ['inside\n', 'compiles\n']
                assert not select.select([second.stdout], [], [], 0.5)[0]
                fcntl.flock(mine, fcntl.LOCK_UN)
                assert second.communicate('\n')[0] == 'begun\nout\n'


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
