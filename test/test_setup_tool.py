# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The set-up's decisions and refusals; its steps are exercised by every run of the tests."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def tool(monkeypatch):
    """Return the set-up tool as a module."""
    monkeypatch.syspath_prepend(str(ROOT / 'tools'))
    spec = importlib.util.spec_from_file_location('mixtac_setup', ROOT / 'tools' / 'setup.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_sourced_installation_is_used_unless_it_is_old(tool, monkeypatch):
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    for path, used in (('/opt/ros/jazzy', 'jazzy'), (str(ROOT / '.venv'), '')):
        monkeypatch.setenv('AMENT_PREFIX_PATH', path)
        assert tool.full_ros() == used
    monkeypatch.setenv('AMENT_PREFIX_PATH', '/opt/ros/foxy')
    monkeypatch.setenv('ROS_DISTRO', 'foxy')
    with pytest.raises(tool.SetupError, match='foxy'):
        tool.full_ros()


@pytest.mark.parametrize('version', [(3, 9, 1), (3, 14, 0)])
def test_a_python_without_wheels_is_refused(tool, monkeypatch, version):
    monkeypatch.setattr(tool.sys, 'version_info', version)
    with pytest.raises(tool.SetupError):
        tool.check_python()


def test_a_missing_compiler_names_its_package(tool, monkeypatch):
    monkeypatch.setattr('setup_checks.shutil.which', lambda _name: None)
    with pytest.raises(tool.SetupError) as caught:
        tool.check_system()
    assert {'build-essential', 'make'} <= set(str(caught.value).split())


@pytest.mark.parametrize('folder', ['my clone', 'clone-without-links'])
def test_sources_that_cannot_be_built_are_refused(tool, monkeypatch, tmp_path, folder):
    monkeypatch.setattr('setup_checks.ROOT', tmp_path / folder)
    with pytest.raises(tool.SetupError):
        tool.check_place('jazzy')


def test_a_processor_without_wheels_is_refused_unless_ros_is_sourced(tool, monkeypatch):
    monkeypatch.setattr('setup_checks.platform.machine', lambda: 'aarch64')
    with pytest.raises(tool.SetupError):
        tool.check_place('')
    tool.check_place('jazzy')


def test_steps_are_remembered_and_changed_inputs_run_again(tool, tmp_path):
    record = tmp_path / 'record.json'
    record.write_text('{"damaged": ')
    tool.Steps(record).finish('install', 'a')
    again = tool.Steps(record)
    assert again.is_done('install', 'a')
    assert not again.is_done('install', 'b')
    again.forget('install')
    assert not tool.Steps(record).is_done('install', 'a')


@pytest.mark.parametrize(
    ('printed', 'found'), [('refused', 'PIP_FAILED'), ('No space left on device', 'NO_SPACE')]
)
def test_the_failure_of_a_step_is_named_with_its_output(
    tool, monkeypatch, tmp_path, printed, found
):
    monkeypatch.setattr('setup_steps.ROOT', tmp_path)
    with pytest.raises(tool.SetupError) as caught:
        tool.call(['sh', '-c', f'echo {printed}; exit 1'], tool.PIP_FAILED)
    assert {getattr(tool, found), printed} <= set(str(caught.value).splitlines())


def test_uv_has_the_index_of_pip_which_installs_where_uv_cannot(tool, monkeypatch):
    calls, given = [], {}

    def call(command, _failure, env=None):
        calls.append(command)
        if command[0].endswith('uv'):
            given.update(env)
            raise tool.SetupError('no such registry')

    monkeypatch.setattr(tool, 'call', call)
    monkeypatch.setenv('PIP_INDEX_URL', 'https://mirror.example/simple?a=b')
    tool.install_packages(Path(sys.prefix), ['numpy'])
    assert given['UV_DEFAULT_INDEX'] == 'https://mirror.example/simple?a=b'
    assert calls[-1][:-2] == [*tool.pip_install(Path(sys.prefix)), 'numpy']


def test_robots_get_what_nodes_need_and_optional_parts_are_added(tool):
    full, robot = tool.requirements(['view'], robot=False), tool.requirements([], robot=True)
    assert set(robot) < set(full)
    left = {each.partition('>')[0] for each in set(full) - set(robot)}
    assert left == {*tool.NOT_ON_ROBOTS, 'rerun-sdk'}


def test_an_installation_that_was_interrupted_is_made_anew(tool, monkeypatch, tmp_path):
    monkeypatch.setattr(tool, 'ROOT', tmp_path)
    for name in ('check_place', 'check_system', 'build_messages', 'compile_kernels', 'fingerprint'):
        monkeypatch.setattr(tool, name, lambda *_, **__: '')
    monkeypatch.setattr(tool, 'full_ros', lambda: '')
    monkeypatch.setattr(tool, 'requirements', lambda *_, **__: [])
    monkeypatch.setattr(tool, 'make_venv', lambda venv, **_: venv.mkdir())

    def interrupted(*_):
        (tmp_path / '.venv' / 'half').touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(tool, 'install_packages', interrupted)
    with pytest.raises(KeyboardInterrupt):
        tool.set_up(robot=False, extras=[])
    monkeypatch.setattr(tool, 'install_packages', lambda *_: None)
    tool.set_up(robot=False, extras=[])
    assert not (tmp_path / '.venv' / 'half').exists()
