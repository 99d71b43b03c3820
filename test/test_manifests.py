# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every package.xml declares what its package imports, under the keys that rosdep knows."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

ROOT = Path(__file__).resolve().parents[1]
TOPICS = ROOT / 'src' / 'mixtac_core' / 'mixtac_core' / 'node' / 'topics.py'
PACKAGES = sorted(each.parent.name for each in ROOT.glob('src/*/package.xml'))
NAMED_AS_IN_PYTHON = (
    'hypothesis', 'joblib', 'matplotlib', 'numba', 'numpy', 'psutil', 'pytest', 'rich', 'scipy',
    'torch', 'typer', 'usb', 'yaml',
)  # fmt: skip
KEYS = {name: f'python3-{name}' for name in NAMED_AS_IN_PYTHON}
KEYS |= {'cv2': 'python3-opencv', 'rosbags': 'python3-rosbags-pip'}
"""rosdep key of each module that has one (rosdep/python.yaml of rosdistro, August 2026)."""
WITHOUT_KEY = {
    'dv_processing', 'h5py', 'libusb_package', 'mcap', 'rerun', 'rerun_cli', 'ruckig',
    'safetensors', 'threadpoolctl', 'zstandard',
}  # fmt: skip
"""Modules without a key, which pip installs."""
OPTIONAL = {'hdf5plugin', 'llvmlite'}
"""Used where present (hdf5plugin), or a part of another (numba)."""


def imported(package: str) -> set[str]:
    """Return the top-level names of what the modules of a package import."""
    modules = [*(ROOT / 'src' / package / package).rglob('*.py')]
    if package == 'mixtac_bringup':
        modules += (ROOT / 'launch').glob('*.py')
    found = imports(modules)
    if package == 'mixtac_core':
        # Its table of topics names the messages of all nodes.
        found |= set(re.findall(r"'(\w+)/msg/\w+'", TOPICS.read_text()))
    return found - {package}


def imports(modules: Iterable[Path]) -> set[str]:
    found = set[str]().union(*map(imports_of, modules))
    return found - set(sys.stdlib_module_names) - {'__future__'} - OPTIONAL


@cache
def imports_of(path: Path) -> set[str]:
    text = path.read_text()
    found = set(re.findall(r"import_module\('(\w+)", text))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition('.')[0])
    return found


def manifest(package: str) -> ET.Element:
    return ET.parse(ROOT / 'src' / package / 'package.xml').getroot()


def declared(package: str, *kinds: str) -> set[str]:
    return {str(each.text) for each in manifest(package) if each.tag in {'exec_depend', *kinds}}


@pytest.mark.parametrize('package', PACKAGES)
def test_what_is_imported_is_declared(package):
    wanted = {KEYS.get(name, name) for name in imported(package) - WITHOUT_KEY}
    assert sorted(wanted - declared(package, 'depend')) == []
    names = imports((ROOT / 'src' / package / 'test').rglob('*.py'))
    ros = {each for each in names if each.endswith(('_msgs', '_interfaces')) or each == 'rclpy'}
    wanted = {KEYS[each] for each in names & set(KEYS)} | ros
    assert sorted(wanted - declared(package, 'depend', 'test_depend') - {package}) == []


@pytest.mark.parametrize('package', [each for each in PACKAGES if each != 'mixtac_msgs'])
def test_what_is_declared_is_imported(package):
    started = {'ros2launch'}
    # These two start the nodes of other packages.
    started = started | set(PACKAGES) if package in {'mixtac_bringup', 'mixtac'} else set()
    used = {KEYS.get(name, name) for name in imported(package)} | started
    assert sorted(declared(package, 'depend') - used) == []


def test_what_is_imported_is_asked_of_pip():
    project = (ROOT / 'pyproject.toml').read_text()
    names = {'cv2': 'opencv-contrib-python-headless', 'usb': 'pyusb', 'yaml': 'PyYAML'}
    for module in sorted(WITHOUT_KEY | set(KEYS) - {'hypothesis'}):
        name = names.get(module, module.replace('_', '-').removesuffix('-cli'))
        assert re.search(rf"'{name}[.>=\w]", project), module


def test_the_manifests_agree_on_version_licence_and_maintainer():
    facts = {
        tuple(manifest(each).findtext(tag) for tag in ('version', 'license', 'maintainer'))
        for each in PACKAGES
    }
    assert len(facts) == 1
    version = next(iter(facts))[0]
    assert f"version = '{version}'" in (ROOT / 'pyproject.toml').read_text()
    for path in ROOT.glob('src/*/setup.py'):
        assert f"version='{version}'" in path.read_text(), path
        # Without it, colcon does not run pytest.
        assert "extras_require={'test': ['pytest']}" in path.read_text(), path
