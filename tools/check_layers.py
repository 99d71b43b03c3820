# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check the structure of the source tree.

* A package imports only packages of lower floors.
* Only modules named `*_node.py` import rclpy.
* Imports inside a package form no circle.
* Modules have at most 300 lines and the SPDX header; no module unpickles.
* `package.xml` declares every workspace package that the code imports.
"""

from __future__ import annotations

import ast
import re
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FLOORS = {
    'mixtac_msgs': 0,
    'event_camera_msgs': 0,
    'mixtac_events': 1,
    'mixtac_node': 2,
    'mixtac_driver': 3,
    'mixtac_sim': 3,
    'mixtac_alignment': 4,
    'mixtac_fger': 4,
    'mixtac_slip_control': 5,
    'mixtac_bringup': 6,
}
MAX_LINES = 300
UNSAFE = re.compile(r'pickle\.loads?\(|torch\.load\(|yaml\.load\(|allow_pickle=True')


def imports(tree: ast.Module) -> set[str]:
    """Return the full names of all modules that a syntax tree imports, type checking included."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found.update(f'{node.module}.{alias.name}' for alias in node.names)
    return found


def runtime_imports(tree: ast.Module) -> set[str]:
    """Return the modules that are imported when the module is loaded."""
    found: set[str] = set()
    for node in tree.body:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            found |= imports(ast.Module([node], []))
    return found


def check_module(path: Path, package: str) -> list[str]:
    """Return what is wrong with one module."""
    text = path.read_text()
    where = path.relative_to(ROOT)
    wrong = []
    lines = text.count('\n')
    if lines > MAX_LINES:
        wrong.append(f'{where}: {lines} lines, at most {MAX_LINES}: split it by concept')
    if 'SPDX-License-Identifier: Apache-2.0' not in text[:200]:
        wrong.append(f'{where}: no SPDX header')
    if UNSAFE.search(text):
        wrong.append(f'{where}: loads data that can run code; use safetensors, npz or safe_load')
    for name in sorted({each.partition('.')[0] for each in imports(ast.parse(text))}):
        if name == 'rclpy' and not path.stem.endswith('_node'):
            wrong.append(f'{where}: imports rclpy; only *_node.py modules do')
        if name in FLOORS and name != package and FLOORS[name] >= FLOORS[package]:
            wrong.append(f'{where}: {package} imports {name}, which is not on a lower floor')
    return wrong


def check_circles(package: str, modules: dict[str, Path]) -> list[str]:
    """Return the import circles inside a package."""
    graph = {
        name: runtime_imports(ast.parse(path.read_text())) & set(modules) - {name}
        for name, path in modules.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return [f'{package}: modules import each other in a circle: {" -> ".join(error.args[1])}']
    return []


def check_manifest(package: str, modules: dict[str, Path]) -> list[str]:
    """Return the workspace packages that are imported but not declared in package.xml."""
    manifest = (ROOT / 'src' / package / 'package.xml').read_text()
    declared = set(re.findall(r'<(?:exec_|test_|build_)?depend>([^<]+)<', manifest))
    used = {
        name.partition('.')[0]
        for path in modules.values()
        for name in imports(ast.parse(path.read_text()))
    }
    ros = {n for n in used if n.endswith('_msgs') or n in ('rclpy', 'std_srvs') or n in FLOORS}
    missing = sorted(ros - declared - {package, 'launch_msgs'})
    return [f'src/{package}/package.xml: {name} is imported but not declared' for name in missing]


def main() -> int:
    """Check everything; print one line per fault."""
    wrong: list[str] = []
    for package in FLOORS:
        base = ROOT / 'src' / package / package
        if not base.is_dir():
            continue
        paths = sorted(base.rglob('*.py'))
        modules = {
            '.'.join(p.relative_to(base.parent).with_suffix('').parts).removesuffix('.__init__'): p
            for p in paths
        }
        for path in paths:
            wrong += check_module(path, package)
        wrong += check_circles(package, modules)
        wrong += check_manifest(package, modules)
    print('\n'.join(wrong) or f'layers: {len(FLOORS)} packages in order')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
