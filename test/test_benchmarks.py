# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The benchmarks run, and write the figures under their names."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(
    ('name', 'options', 'figures'),
    [
        (
            'decode',
            ('--seconds', '0', '--megabytes', '1'),
            {'events_per_s', 'memcpy_ratio', 'frames_per_s', 'start_s'},
        ),
        ('infer', ('--seconds', '3'), {'step_ms', 'between_ms', 'frame_ms', 'windows', 'late'}),
        pytest.param(
            *('latency', ('--seconds', '3'), {'force_hz', 'force_age_p50_ms', 'forces_lost'}),
            marks=pytest.mark.dds,
        ),
    ],
)
def test_a_benchmark_writes_its_figures(tmp_path, name, options, figures, ros_domain):
    file = tmp_path / 'figures.json'
    command = [sys.executable, str(ROOT / 'benchmarks' / f'{name}.py'), *options]
    subprocess.run([*command, '--json', str(file)], check=True, capture_output=True, env=ros_domain)
    assert figures <= set(json.loads(file.read_text()))
