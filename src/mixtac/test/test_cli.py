# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command line as a user meets it: its own process, its exit status, its one line of error."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
MODEL = Path(__file__).resolve().parents[3] / 'models' / 'fger_small.safetensors'


def mixtac(env: dict[str, str], *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, '-m', 'mixtac', *arguments],
        env=env,
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def assert_one_clear_line(result: subprocess.CompletedProcess[str], *words: str) -> None:
    assert result.returncode not in (0, None)
    assert 'Traceback' not in result.stderr + result.stdout
    lines = [line for line in result.stderr.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1, result.stderr
    for word in words:
        assert word in lines[0]


def test_help_lists_the_commands(ros_domain: dict[str, str], tmp_path: Path):
    result = mixtac(ros_domain, '--help', cwd=tmp_path)
    assert result.returncode == 0
    for command in ('demo', 'up', 'inspect', 'train', 'evaluate'):
        assert command in result.stdout


def test_help_is_shown_as_it_is_written(commands):
    from rich.text import Text

    for words, command in commands.items():
        for text in (command.help, *(getattr(each, 'help', '') for each in command.params)):
            assert Text.from_markup(text or '').plain == (text or ''), words


def test_an_unknown_command_is_refused(ros_domain: dict[str, str], tmp_path: Path):
    assert_one_clear_line(mixtac(ros_domain, 'fly', cwd=tmp_path), 'fly')


def test_an_unknown_device_is_refused(ros_domain: dict[str, str], tmp_path: Path):
    result = mixtac(ros_domain, 'up', '--device', 'gelsight', '--seconds', '20', cwd=tmp_path)
    assert_one_clear_line(result, 'gelsight', 'virtual')


def test_no_camera_names_the_virtual_one(ros_domain: dict[str, str], tmp_path: Path):
    usb = Path('/sys/bus/usb/devices')
    if any(each.read_text().strip() == '152a' for each in usb.glob('*/idVendor')):
        pytest.skip('an iniVation camera is attached to this machine')
    result = mixtac(ros_domain, 'up', '--seconds', '20', cwd=tmp_path)
    assert_one_clear_line(result, 'device:=virtual')


def with_model(tmp_path: Path, model: Path) -> str:
    path = tmp_path / 'params.yaml'
    path.write_text(f"/**/fger:\n  ros__parameters:\n    model: '{model}'\n")
    return str(path)


def up_with_model(env: dict[str, str], tmp_path: Path, model: Path):
    params = with_model(tmp_path, model)
    return mixtac(
        env, 'up', '--device', 'virtual', '--params-file', params, '--seconds', '30', cwd=tmp_path
    )


@pytest.mark.dds
def test_a_missing_model_is_named(ros_domain: dict[str, str], tmp_path: Path):
    result = up_with_model(ros_domain, tmp_path, tmp_path / 'nowhere.safetensors')
    assert_one_clear_line(result, 'fger', 'nowhere.safetensors')


def test_up_refuses_a_missing_model_before_anything_starts(
    ros_domain: dict[str, str], tmp_path: Path
):
    options = ('--device', 'virtual', '--model', 'nowhere.safetensors')
    assert_one_clear_line(mixtac(ros_domain, 'up', *options, cwd=tmp_path), 'nowhere.safetensors')


def test_evaluating_a_missing_model_is_one_line(ros_domain: dict[str, str], tmp_path: Path):
    result = mixtac(ros_domain, 'evaluate', '--model', 'nowhere.safetensors', cwd=tmp_path)
    assert_one_clear_line(result, 'nowhere.safetensors')


def test_a_truncated_bag_is_one_line(ros_domain: dict[str, str], tmp_path: Path):
    from mixtac_core.recordings.bag_writer import BagWriter

    writer = BagWriter(tmp_path / 'bag')
    writer.add_topic('/mixtac/force', 'geometry_msgs/msg/WrenchStamped', latched=False)
    writer.close()
    data = next((tmp_path / 'bag').glob('*.mcap'))
    data.write_bytes(data.read_bytes()[:-40])
    assert_one_clear_line(mixtac(ros_domain, 'inspect', 'bag', cwd=tmp_path), 'bag')
