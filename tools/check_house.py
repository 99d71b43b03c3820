# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check the structure of the source tree, and print its size.

Fails when

* a package imports a package of its own floor or of a higher one,
* imports inside a package form a circle, between modules or between folders of modules,
* a module that is not named `*_node.py` imports rclpy, or one uses tasks or event callbacks of it,
* a package that robots run imports torch, matplotlib or the simulator,
* a package has more code lines than its ceiling in pyproject.toml,
* a module is too long, has no SPDX header, unpickles, or assigns constants as tuples,
* `package.xml` does not declare a workspace package that the code imports, or its elements are not
  those of package_format3.xsd in their order.

Imports under `TYPE_CHECKING` and inside functions count like all others. The table of modules and
code lines per package is printed and never fails.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import statistics
import sys
import tokenize
from collections import defaultdict
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from setup_steps import ROOT, project_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

FLOORS = {
    'mixtac_msgs': 0,
    'event_camera_msgs': 0,
    'mixtac_core': 1,
    'mixtac_driver': 2,
    'mixtac_fger': 2,
    'mixtac_slip_control': 2,
    'mixtac_sim': 3,
    'mixtac': 4,
    'mixtac_learning': 5,
    'mixtac_bringup': 6,
}
RUN = frozenset({'mixtac_core', 'mixtac_driver', 'mixtac_fger', 'mixtac_slip_control'})
NOT_ON_ROBOTS = ('torch', 'matplotlib', 'mixtac_sim')
MAX_CODE_LINES = 400
UNSAFE = re.compile(r'pickle\.loads?\(|torch\.load\(|yaml\.load\(|allow_pickle=True')
UNRELIABLE = re.compile(r'async def |\.create_task\(|event_callbacks=')
"""What EventsExecutor loses or never ends (ros2/rclpy#1718, ros2/rclpy#1644)."""
SCHEMA = re.compile(
    r'3 name version description( maintainer)+( license)+( url)*( author)*'
    r'( (build|build_export|buildtool|buildtool_export|exec|doc|test)_depend| depend| conflict'
    r'| replace)*( group_depend)*( member_of_group)*( export)?'
)
"""Format and elements of a `package.xml`, as package_format3.xsd demands them."""


@dataclass(frozen=True)
class Module:
    """A source file.

    Attributes:
        name: Dotted name.
        path: Where it lies.
        text: Its source.
        imports: Full names of what it imports anywhere, type checking included.
        code_lines: Lines that are neither blank, comment nor docstring.
    """

    name: str
    path: Path
    text: str
    imports: frozenset[str]
    code_lines: int

    @property
    def package(self) -> str:
        """Top-level package."""
        return self.name.partition('.')[0]

    @property
    def folder(self) -> str:
        """Package or sub-package in which it lies."""
        return self.name.rpartition('.')[0]


def imported_names(tree: ast.AST) -> frozenset[str]:
    """Return the full names of everything that a syntax tree imports."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found.update(f'{node.module}.{alias.name}' for alias in node.names)
    return frozenset(found)


def docstring_lines(tree: ast.AST) -> set[int]:
    """Return the numbers of the lines that docstrings take."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if not isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        first = node.body[0] if node.body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            lines.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return lines


def count_code_lines(text: str, tree: ast.AST) -> int:
    """Count the lines that hold code."""
    skipped = {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    }
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skipped:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstring_lines(tree))


def read_modules(root: Path) -> list[Module]:
    """Read every module of every package below `src`."""
    found = []
    for package in sorted(p for p in (root / 'src').iterdir() if p.is_dir()):
        for path in sorted((package / package.name).rglob('*.py')):
            text = path.read_text()
            tree = ast.parse(text)
            parts = path.relative_to(package).with_suffix('').parts
            name = '.'.join(parts).removesuffix('.__init__')
            found.append(
                Module(name, path, text, imported_names(tree), count_code_lines(text, tree))
            )
    return found


def check_imports(module: Module) -> list[str]:
    """Return the imports of a module that the floors forbid."""
    wrong = []
    for name in sorted({each.partition('.')[0] for each in module.imports}):
        if name == 'rclpy' and not module.path.stem.endswith('_node'):
            wrong.append('imports rclpy; only *_node.py modules do')
        if name in NOT_ON_ROBOTS and module.package in RUN:
            wrong.append(f'imports {name}, which is not installed on robots')
        elif (
            name in FLOORS
            and name != module.package
            and FLOORS[name] >= FLOORS.get(module.package, 0)
        ):
            wrong.append(f'imports {name}, which is not on a lower floor')
    return wrong


def check_text(module: Module) -> list[str]:
    """Return what is wrong with the text of a module."""
    wrong = []
    if module.code_lines > MAX_CODE_LINES:
        wrong.append(f'{module.code_lines} code lines, at most {MAX_CODE_LINES}')
    if 'SPDX-License-Identifier: Apache-2.0' not in module.text[:200]:
        wrong.append('no SPDX header')
    wrong += [
        f'line {node.lineno}: give each constant a line and a sentence of its own'
        for node in ast.parse(module.text).body
        if isinstance(node, ast.Assign) and shares_a_line(node, module.text)
    ]
    if UNSAFE.search(module.text):
        wrong.append('loads data that can run code; use safetensors, npz or safe_load')
    if module.path.stem.endswith('_node') and UNRELIABLE.search(module.text):
        wrong.append('uses tasks or event callbacks, which EventsExecutor loses; use a timer')
    return wrong


def shares_a_line(node: ast.Assign, text: str) -> bool:
    """Return whether constants share an assignment (`A, B = 1, 2`), or one is bare (`A = 1, 2`)."""
    value = str(ast.get_source_segment(text, node.value))
    if isinstance(node.targets[0], ast.Tuple):
        return isinstance(node.value, ast.Tuple) or value.startswith('range(')
    return isinstance(node.value, ast.Tuple) and not value.startswith('(')


def edges(modules: Iterable[Module]) -> dict[str, set[str]]:
    """Return which modules of a package import which, by name."""
    modules = list(modules)
    names = {module.name for module in modules}
    return {module.name: set(module.imports & names) - {module.name} for module in modules}


def folders_of(graph: Mapping[str, set[str]], package: str) -> dict[str, set[str]]:
    """Return which folders of a package import which; a top module is a folder of its own."""

    def folder(name: str) -> str:
        parent = name.rpartition('.')[0]
        return name if parent == package else parent

    found: dict[str, set[str]] = defaultdict(set)
    for name, imported in graph.items():
        found[folder(name)] |= {folder(each) for each in imported} - {folder(name)}
    return dict(found)


def find_circle(graph: Mapping[str, set[str]]) -> str:
    """Return the first circle of a graph in words, or nothing."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return ' -> '.join(reversed(error.args[1]))
    return ''


def check_manifest(root: Path, package: str, modules: Iterable[Module]) -> list[str]:
    """Return the workspace packages that are imported but not declared in package.xml."""
    manifest = (root / 'src' / package / 'package.xml').read_text()
    declared = set(re.findall(r'<(?:exec_|test_|build_)?depend>([^<]+)<', manifest))
    used = {name.partition('.')[0] for module in modules for name in module.imports}
    ros = {n for n in used if n.endswith('_msgs') or n in ('rclpy', 'std_srvs') or n in FLOORS}
    missing = sorted(ros - declared - {package})
    return [f'src/{package}/package.xml: {name} is imported but not declared' for name in missing]


def check_schema(path: Path) -> list[str]:
    """Return what package_format3.xsd forbids in a package.xml: elements, order, name, version."""
    package = ET.parse(path).getroot()
    wrong = []
    if not SCHEMA.fullmatch(' '.join([package.get('format', ''), *(each.tag for each in package)])):
        wrong.append('its elements or their order are not those of package_format3.xsd')
    patterns = {'name': '[a-z](_?[a-z0-9]+)*', 'version': r'\d+\.\d+\.\d+', 'license': r'\S.*'}
    for tag, pattern in patterns.items():
        if not re.fullmatch(pattern, package.findtext(tag, '')):
            wrong.append(f'{tag} {package.findtext(tag)!r} is not valid')
    return [f'{path.parent.name}/package.xml: {each}' for each in wrong]


def check(root: Path, modules: list[Module]) -> list[str]:
    """Return all faults, one line each."""
    wrong = []
    for module in modules:
        where = module.path.relative_to(root)
        wrong += [f'{where}: {fault}' for fault in check_imports(module) + check_text(module)]
    for package in sorted({module.package for module in modules}):
        inside = [module for module in modules if module.package == package]
        graph = edges(inside)
        for circle in {find_circle(graph), find_circle(folders_of(graph, package))} - {''}:
            wrong.append(f'{package}: imports form a circle: {circle}')
        wrong += check_manifest(root, package, inside)
    for path in sorted(root.glob('*/*/package.xml')):
        wrong += check_schema(path)
    return wrong + check_ceilings(modules, project_file()['tool']['mixtac']['ceilings'])


def check_ceilings(modules: list[Module], most: Mapping[str, int]) -> list[str]:
    """Return the packages that have grown beyond their ceilings."""
    lines: dict[str, int] = defaultdict(int)
    for module in modules:
        lines[module.package] += module.code_lines
    return [
        f'{package}: {count} code lines, at most {most[package]}'
        for package, count in lines.items()
        if count > most.get(package, count)
    ]


def table(modules: list[Module]) -> str:
    """Return the table of modules, code lines and median module per package."""
    rows = ['package                modules  code lines  median module']
    sizes: dict[str, list[int]] = defaultdict(list)
    lines: dict[str, int] = defaultdict(int)
    for module in modules:
        lines[module.package] += module.code_lines
        if module.path.name != '__init__.py':
            sizes[module.package].append(module.code_lines)
    for package in sorted(lines, key=lambda name: (FLOORS.get(name, 0), name)):
        median = statistics.median(sizes[package]) if sizes[package] else 0
        rows.append(f'{package:22} {len(sizes[package]):7} {lines[package]:11} {median:14.0f}')
    every = [size for package in sizes.values() for size in package]
    median = statistics.median(every)
    rows.append(f'{"all":22} {len(every):7} {sum(lines.values()):11} {median:14.0f}')
    return '\n'.join(rows)


def main() -> int:
    """Print the size of the house and one line per fault."""
    parser = argparse.ArgumentParser(description='check the structure of the source tree')
    parser.add_argument('--root', type=Path, default=ROOT, help='checkout to look at')
    parser.add_argument('--table', action='store_true', help='print only the table of sizes')
    options = parser.parse_args()
    modules = read_modules(options.root)
    print(table(modules))
    if options.table:
        return 0
    wrong = check(options.root, modules)
    print('\n'.join(wrong) or f'{len(FLOORS)} packages in order')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
