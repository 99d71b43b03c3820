# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every example runs to its end."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / 'examples'


def run(folder: Path, *words: str) -> str:
    """Run Python in a folder without a screen; return what it prints."""
    environment = {**os.environ, 'MPLBACKEND': 'Agg'}
    command = [sys.executable, *words]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> str:
    """Return a simulated trial of five seconds with a tap at both ends."""
    folder = tmp_path_factory.mktemp('trials')
    options = ('--profile', 'dynamic', '--trials', '1', '--seconds', '5', '--seed', '3')
    run(folder, '-m', 'mixtac', 'simulate', *options, '--out', str(folder / 'bags'))
    return str(folder / 'bags' / 'trial_000')


@pytest.mark.parametrize(
    ('name', 'options', 'printed'),
    [
        ('read_force', ('BAG',), r'N \+- '),
        ('plot_live', ('BAG', '1', 'plot.png'), ''),
        ('record_and_read', ('BAG',), '125 frames'),
        ('align_reference', ('BAG',), 'drift'),
        ('contact_and_shear', ('BAG',), 'mm'),
    ],
)
def test_an_example_runs_on_a_recording(tmp_path, bag, name, options, printed):
    words = [bag if each == 'BAG' else each for each in options]
    assert re.search(printed, run(tmp_path, str(EXAMPLES / f'{name}.py'), *words))
