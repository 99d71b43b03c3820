# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that report JSON lines."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys

import psutil
import pytest

from mixtac_core.node.process import GraphError, JsonProcess

REPORT = 'import json, time; print(json.dumps({"ready": 1}), flush=True); time.sleep(60)'


def test_lines_are_received_and_a_missing_one_is_named():
    with JsonProcess('speaker', [sys.executable, '-c', REPORT], {}) as process:
        assert process.expect('ready', 60.0) == {'ready': 1}
        with pytest.raises(GraphError) as caught:
            process.expect('more', 0.2)
    assert 'speaker' in str(caught.value)
    assert repr('more') in str(caught.value)


@pytest.mark.parametrize('line', ['5', 'null', '["ready"]', '"ready"', 'ready'])
def test_lines_that_are_no_objects_are_left_out(line: str):
    with JsonProcess(
        'speaker', [sys.executable, '-c', f'print({line!r}); {REPORT}'], {}
    ) as process:
        assert process.expect('ready', 60.0) == {'ready': 1}


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGKILL])
def test_it_ends_with_its_parent(number: int):
    if shutil.which('setpriv') is None:
        pytest.skip('needs setpriv (util-linux)')
    script = (
        'import sys, time\n'
        'from mixtac_core.node.process import JsonProcess\n'
        f'process = JsonProcess("child", [sys.executable, "-c", {REPORT!r}], None)\n'
        'process.expect("ready", 60.0); print("ready", flush=True); time.sleep(60)\n'
    )
    parent = subprocess.Popen([sys.executable, '-c', script], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    assert parent.stdout.readline() == 'ready\n'
    (child,) = psutil.Process(parent.pid).children()
    parent.send_signal(number)
    parent.wait(30)
    child.wait(30)
