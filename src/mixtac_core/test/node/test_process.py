# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Starting, watching and ending processes."""

from __future__ import annotations

import fcntl
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import psutil
import pytest

from mixtac_core.node.process import (
    GraphError,
    ProcessGroup,
    fatal_text,
)

if TYPE_CHECKING:
    from pathlib import Path

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
