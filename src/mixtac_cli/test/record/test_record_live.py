# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""`mixtac record` whose terminal or pipe is closed under it."""

from __future__ import annotations

import fcntl
import os
import pty
import signal
import subprocess
import sys
import termios
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from mixtac_recordings.bag import BagFile
from mixtac_recordings.dataset import FILE_NAME, read_recordings

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.dds
END_S = 30.0


@contextmanager
def recording(bag: Path, **options: object) -> Iterator[subprocess.Popen[bytes]]:
    """Record without a sensor; yield the process, which must end well afterwards."""
    words = ['record', str(bag), '--force', '--check-seconds', '0.5']
    process = subprocess.Popen([sys.executable, '-m', 'mixtac_cli', *words], **options)
    try:
        yield process
        assert process.wait(END_S) == 0
    finally:
        process.kill()
        process.wait()
    with BagFile(bag) as found:
        assert found.damage == ''
        assert '/mixtac/events' in found.types
    (entry,) = read_recordings(bag.parent / FILE_NAME)['trials']
    assert entry['name'] == bag.name


def wait_for(bag: Path) -> None:
    """Wait until a bag is written, and for some turns of the display."""
    end_s = time.monotonic() + END_S
    while not bag.exists() and time.monotonic() < end_s:
        time.sleep(0.05)
    time.sleep(1.5)


def take_terminal() -> None:
    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def test_a_closed_terminal_ends_the_recording_and_the_bag_is_whole(ros_domain, tmp_path):
    master, slave = pty.openpty()
    streams = dict.fromkeys(('stdin', 'stdout', 'stderr'), slave)
    with recording(tmp_path / 'bag', env=ros_domain, preexec_fn=take_terminal, **streams):
        os.close(slave)
        wait_for(tmp_path / 'bag')
        os.close(master)


def test_a_terminal_that_goes_without_a_signal_does_not_end_the_recording(ros_domain, tmp_path):
    master, slave = pty.openpty()
    options = {'stdout': slave, 'stderr': slave, 'start_new_session': True}
    with recording(tmp_path / 'bag', env=ros_domain, **options) as process:
        os.close(slave)
        wait_for(tmp_path / 'bag')
        os.close(master)
        time.sleep(1.5)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)


def test_a_closed_pipe_does_not_end_the_recording(ros_domain, tmp_path):
    with recording(tmp_path / 'bag', env=ros_domain, stdout=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stdout.readline()
        process.stdout.close()
        wait_for(tmp_path / 'bag')
        assert process.poll() is None
        process.send_signal(signal.SIGINT)


FAILING = """
import sys
from pathlib import Path
from mixtac_cli.record.recorder_node import Listener
with Listener.opened('record', 'mixtac') as listener:
    listener.listen('/ft_sensor/wrench')
    listener.start(Path(sys.argv[1]))
    raise SystemExit(3)
"""


def test_an_error_leaves_a_bag_that_is_whole(ros_domain, tmp_path):
    command = [sys.executable, '-c', FAILING, str(tmp_path / 'bag')]
    assert subprocess.run(command, env=ros_domain, timeout=END_S, check=False).returncode == 3
    with BagFile(tmp_path / 'bag') as found:
        assert found.damage == ''
