# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write config/*.yaml and the parameters of docs/reference.md from the code that defines them.

With `--check` nothing is written; the exit status is 1 when a file is out of date.
"""

from __future__ import annotations

import sys
import textwrap
from itertools import groupby
from pathlib import Path
from typing import Any

import yaml

from mixtac.parameters import SupervisorParameters, ViewParameters
from mixtac_core.node.parameters import ParameterSpec, specs, yaml_scalar
from mixtac_core.node.topics import DEFAULT_NAMESPACE, TOPICS
from mixtac_driver.parameters import DriverParameters
from mixtac_fger.alignment.parameters import AlignmentParameters, ForceErrorParameters
from mixtac_fger.parameters import FgerParameters
from mixtac_sim.parameters import (
    VirtualArmParameters,
    VirtualGraspParameters,
    VirtualSensorParameters,
)
from mixtac_slip_control.parameters import SlipControlParameters

ROOT = Path(__file__).resolve().parent.parent
SCHEMAS: dict[str, type[Any]] = {
    'driver': DriverParameters,
    'virtual_sensor': VirtualSensorParameters,
    'virtual_arm': VirtualArmParameters,
    'virtual_grasp': VirtualGraspParameters,
    'fger': FgerParameters,
    'alignment': AlignmentParameters,
    'force_error': ForceErrorParameters,
    'slip_control': SlipControlParameters,
    'view': ViewParameters,
    'supervisor': SupervisorParameters,
}
HEADER = (
    '# SPDX-FileCopyrightText: 2026 Mixtac maintainers\n# SPDX-License-Identifier: Apache-2.0\n'
)


def allowed(spec: ParameterSpec) -> str:
    """Return the allowed values in words."""
    if spec.choices:
        return ', '.join(map(str, spec.choices))
    if spec.minimum is None and spec.maximum is None:
        return ''
    low = '' if spec.minimum is None else f'{spec.minimum:g}'
    high = '' if spec.maximum is None else f'{spec.maximum:g}'
    return f'{low} .. {high}'


def config(node: str, schema: type[Any]) -> str:
    """Return the parameter file of a node."""
    lines = [HEADER + f'# Parameters of the node {node}, at their defaults.', '']
    lines += [f'/**/{node}:', '  ros__parameters:']
    for spec in specs(schema):
        notes = [spec.description]
        if allowed(spec):
            notes.append(f'Allowed: {allowed(spec)}{" " + spec.unit if spec.unit else ""}.')
        elif spec.unit:
            notes.append(f'Unit: {spec.unit}.')
        if spec.read_only:
            notes.append('Fixed while the node runs.')
        lines += ['', *(f'    # {line}' for note in notes for line in textwrap.wrap(note, 92))]
        lines.append(f'    {spec.name}: {yaml_scalar(spec.default)}')
    return '\n'.join(lines) + '\n'


def stem(spec: ParameterSpec) -> tuple[str, str]:
    """Return what the fields of one bias share: the start of their names and descriptions."""
    subject, comma, _ = spec.description.partition(', ')
    return (spec.name.rpartition('_')[0], subject) if comma else (spec.name, '')


def row(fields: list[ParameterSpec]) -> str:
    """Return the row of a parameter, or of the fields of one bias."""
    first, (start, subject) = fields[0], stem(fields[0])
    names = [first.name, *(each.name.removeprefix(start) for each in fields[1:])]
    parts = '; '.join(each.description.partition(', ')[2] for each in fields)
    cells = (
        ', '.join(f'`{name}`' for name in names),
        ', '.join(f'`{yaml_scalar(each.default)}`' for each in fields),
        first.unit,
        ', '.join(filter(None, map(allowed, fields))),
        'fixed' if first.read_only else 'yes',
        f'{subject}: {parts}' if len(fields) > 1 else first.description,
    )
    return f'| {" | ".join(cells)} |'


def reference() -> str:
    """Return the page of topics, services and parameters; what is above these stays as it is."""
    page = (ROOT / 'docs' / 'reference.md').read_text()
    lines = [page.partition('\n## Parameters of')[0]]
    for node, schema in SCHEMAS.items():
        lines += [f'## Parameters of `{node}`', '']
        lines += ['| parameter | default | unit | allowed | at run time | what |']
        lines += ['|---|---|---|---|---|---|']
        lines += [row(list(fields)) for _, fields in groupby(specs(schema), stem)]
        lines.append('')
    return '\n'.join(lines)


def rosbag2() -> str:
    """Return the QoS overrides with which `ros2 bag record` loses no messages."""
    text = (
        '# For ros2 bag record --qos-profile-overrides-path: its queues of 10 lose event packets.'
    )
    overrides = {
        topic.resolved(DEFAULT_NAMESPACE): {
            'history': 'keep_last',
            'depth': 1 if topic.latched else max(1000, 5 * topic.depth),
            'reliability': 'reliable' if topic.reliable else 'best_effort',
            'durability': 'transient_local' if topic.latched else 'volatile',
        }
        for topic in TOPICS
    }
    return f'{HEADER}{text}\n{yaml.safe_dump(overrides, sort_keys=False)}'


def pages() -> dict[Path, str]:
    """Return all generated files with their contents."""
    written = {
        ROOT / 'config' / f'{node}.yaml': config(node, schema) for node, schema in SCHEMAS.items()
    }
    written[ROOT / 'config' / 'rosbag2_qos.yaml'] = rosbag2()
    written[ROOT / 'docs' / 'reference.md'] = reference()
    return written


def main() -> int:
    """Write the files, or check them."""
    check = '--check' in sys.argv[1:]
    stale = [p for p, text in pages().items() if not p.exists() or p.read_text() != text]
    for path in stale:
        if check:
            print(f'{path.relative_to(ROOT)} is out of date: run `make docs`')
        else:
            path.parent.mkdir(exist_ok=True)
            path.write_text(pages()[path])
    return 1 if check and stale else 0


if __name__ == '__main__':
    sys.exit(main())
