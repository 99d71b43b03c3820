# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Starts and ends of a launch, with a program in the place of `ros2 launch`."""

from __future__ import annotations

import contextlib
import sys
from types import SimpleNamespace

import psutil
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_lab.bench.starts import start_and_end, summarise
from mixtac_node.process import GraphError

LAUNCH = """
import signal, sys, time
def end(*_):
    print({last!r})
    sys.exit({status})
signal.signal(signal.SIGINT, end)
open({ready!r}, 'w').close()
while True:
    time.sleep(0.05)
"""


@pytest.mark.parametrize(
    ('last', 'status', 'clean'),
    [('[INFO] ended', 0, True), ('[ERROR] [driver]: gone', 0, False), ('', 3, False)],
)
def test_a_clean_end_has_status_0_and_no_error(tmp_path, last, status, clean):
    ready = tmp_path / 'ready'
    code = LAUNCH.format(last=last, status=status, ready=str(ready))

    class Forces:
        @property
        def force_count(self) -> int:
            return int(ready.exists())

    run = start_and_end([sys.executable, '-c', code], Forces(), tmp_path / 'output.txt')
    assert (run['status'], run['clean'], run['orphans']) == (status, clean, 0)
    report = summarise([run])
    assert (report['count'], report['clean']) == (1, int(clean))
    assert report['end_s']['p50'] == run['end_s']


def test_a_launch_that_ends_before_a_force_is_an_error(tmp_path):
    monitor = SimpleNamespace(force_count=0)
    with pytest.raises(GraphError):
        start_and_end([sys.executable, '-c', ''], monitor, tmp_path / 'output.txt')


def test_an_interrupt_before_the_first_force_leaves_no_node(tmp_path):
    node = tmp_path / 'node'
    code = (
        'import subprocess, sys\n'
        "child = subprocess.Popen(['sleep', '600'])\n"
        f"open({str(node)!r} + '.part', 'w').write(str(child.pid))\n"
        f'import os; os.rename({str(node)!r} + ".part", {str(node)!r})\n'
        'child.wait()\n'
    )

    class Interrupted:
        @property
        def force_count(self) -> int:
            if node.exists():
                raise KeyboardInterrupt
            return 0

    with pytest.raises(KeyboardInterrupt):
        start_and_end([sys.executable, '-c', code], Interrupted(), tmp_path / 'output.txt')
    with contextlib.suppress(psutil.NoSuchProcess):
        psutil.Process(int(node.read_text())).wait(10)
    assert not psutil.pid_exists(int(node.read_text()))
