# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A robot runs the sensor with neither PyTorch, matplotlib nor the simulator.

By default the nodes run in this environment with those modules hidden. With
`MIXTAC_TEST_INSTALL=1` they run in an environment of their own, made by
`tools/setup.py --robot` in a copy of the sources.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

ROOT = Path(__file__).resolve().parents[1]
HIDDEN = ('torch', 'matplotlib', 'mixtac_sim', 'mixtac_learning', 'mixtac')
NODES = {
    'driver': 'mixtac_driver.node.driver_node',
    'fger': 'mixtac_fger.fger_node',
    'slip_control': 'mixtac_slip_control.slip_control_node',
    'alignment': 'mixtac_fger.alignment.alignment_node',
}
HIDE = textwrap.dedent(
    """
    import importlib, sys

    class Hide:
        def find_spec(self, name, path=None, target=None):
            if name.partition('.')[0] in {hidden!r}:
                raise ModuleNotFoundError(f'{{name}} is not installed on robots')

    sys.meta_path.insert(0, Hide())
    sys.argv = sys.argv[1:]
    sys.exit(importlib.import_module(sys.argv[0]).main())
    """
).format(hidden=HIDDEN)


@pytest.mark.dds
@pytest.mark.parametrize('node', NODES)
def test_nodes_start_with_nothing_that_robots_lack(node: str, node_under_test: Any):
    command = [sys.executable, '-c', HIDE, NODES[node], '--ros-args']
    if node == 'driver':
        # Without a camera the driver says so and ends.
        command += ['-p', 'device:=davis346']
    process = subprocess.Popen(command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        if node == 'driver':
            output, _ = process.communicate(timeout=120)
            assert 'device:=virtual' in output
            assert 'Traceback' not in output
        else:
            look = node_under_test.node.get_node_names
            node_under_test.spin_until(lambda: process.poll() is not None or node in look())
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            output, _ = process.communicate(timeout=60)
            assert 'Traceback' not in output
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_environment_of_its_own(tmp_path: Path):
    if not os.environ.get('MIXTAC_TEST_INSTALL'):
        pytest.skip('downloads packages: set MIXTAC_TEST_INSTALL=1')
    clone = tmp_path / 'mixtac'
    left_out = shutil.ignore_patterns('.git', '.venv*', 'build', 'install', 'log', '__pycache__')
    shutil.copytree(ROOT, clone, ignore=left_out, symlinks=True)
    python = getattr(sys, '_base_executable', sys.executable)
    kept = {k: v for k, v in os.environ.items() if k in ('PATH', 'HOME', 'TMPDIR', 'LANG')}
    kept.update({k: v for k, v in os.environ.items() if k.startswith(('PIP_', 'SSL_'))})
    kept['PATH'] = kept['PATH'].replace(f'{ROOT}/.venv/bin:', '')
    subprocess.run([python, str(clone / 'tools' / 'setup.py'), '--robot'], env=kept, check=True)
    listed = subprocess.run(
        [clone / '.venv' / 'bin' / 'python', '-m', 'pip', 'list', '--format=freeze'],
        env=kept,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    names = {line.partition('=')[0].lower() for line in listed.splitlines()}
    assert not names & {'torch', 'matplotlib', 'ruff', 'mypy'}
    for module in NODES.values():
        node = f'python -m mixtac_core.node {module} --ros-args -p device:=davis346'
        shell = f'. tools/env.sh && exec timeout -s INT 15 {node}'
        ended = subprocess.run(
            ['bash', '-c', shell],
            cwd=clone,
            env=kept | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'},
            capture_output=True,
            text=True,
            check=False,
        )
        assert 'Traceback' not in ended.stdout + ended.stderr
    size = sum(p.lstat().st_size for p in (clone / '.venv').rglob('*') if not p.is_symlink())
    print(f'{size / 1e6:.0f} MB installed')
