# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The command line as a user meets it: its own process, its exit status, its one line of error."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import pytest

from mixtac.main import INTERRUPTED, main, noting_interrupt

pytest.importorskip('rclpy', reason='needs ROS 2')


def assert_one_line(errors: str, *words: str) -> None:
    assert 'Traceback' not in errors
    lines = [line for line in errors.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1, errors
    for word in words:
        assert word in lines[0]


def test_help_lists_the_commands(capsys):
    assert main(['--help']) == 0
    shown = capsys.readouterr().out
    for command in ('demo', 'up', 'inspect', 'train', 'evaluate'):
        assert command in shown


def test_help_is_shown_as_it_is_written(commands):
    from rich.text import Text

    for words, command in commands.items():
        for text in (command.help, *(getattr(each, 'help', '') for each in command.params)):
            assert Text.from_markup(text or '').plain == (text or ''), words


@pytest.mark.parametrize(
    ('words', 'meant'),
    [(['demos'], 'demo'), (['up', 'slop'], 'slip'), (['doctor', '--secnds', '3'], '--seconds')],
)
def test_a_misspelt_name_is_refused_with_the_one_that_was_meant(words, meant, capsys):
    assert main(words) == 2
    assert_one_line(capsys.readouterr().err, words[-2] if len(words) > 2 else words[-1], meant)


def test_the_version_is_printed(capsys):
    assert main(['--version']) == 0
    assert version('mixtac') in capsys.readouterr().out


@pytest.mark.parametrize('delay_s', [0.0, 0.3, 1.0])
def test_ctrl_c_while_a_command_starts_ends_it_with_one_line(ros_domain, tmp_path, delay_s):
    # The tests themselves may run where it is ignored.
    words = ['env', '--default-signal=INT', '--block-signal=INT']
    words += [sys.executable, '-m', 'mixtac', 'doctor', '--device', 'virtual']
    # ./mixtac blocks it as well, until the command handles it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    with subprocess.Popen(
        words, env=ros_domain, cwd=tmp_path, stderr=subprocess.PIPE, text=True
    ) as process:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        time.sleep(delay_s)
        process.send_signal(signal.SIGINT)
        assert process.communicate()[1] == 'interrupted\n'
    # Python may end itself by the signal: a shell makes 130 of that, too.
    assert process.returncode in {INTERRUPTED, -signal.SIGINT}


def test_ctrl_c_while_llvm_calls_back_ends_what_follows():
    handled = signal.signal(signal.SIGINT, signal.default_int_handler)
    returned: list[int] = []
    text = compile('kill(2); note(1)', 'llvmlite', 'exec')
    names = {'kill': signal.raise_signal, 'note': returned.append}
    with pytest.raises(KeyboardInterrupt), noting_interrupt([]):  # noqa: PT012
        exec(text, names)
        time.sleep(600)
    signal.signal(signal.SIGINT, handled)
    assert returned


@pytest.mark.dds
@pytest.mark.parametrize(
    ('options', 'names'),
    [
        ([], ('driver', 'device:=virtual')),
        (['--device', 'gelsight'], ('driver', 'gelsight')),
        (['--device', 'nowhere.mcap'], ('driver', 'nowhere.mcap')),
        (['--device', 'virtual', '--model', 'nowhere.safetensors'], ('fger', 'nowhere')),
    ],
)
def test_the_error_of_a_node_is_that_of_up(
    ros_domain: dict[str, str], tmp_path: Path, options, names
):
    usb = Path('/sys/bus/usb/devices')
    if not options and any(each.read_text().strip() == '152a' for each in usb.glob('*/idVendor')):
        pytest.skip('an iniVation camera is attached to this machine')
    words = [sys.executable, '-m', 'mixtac', 'up', *options, '--seconds', '20']
    result = subprocess.run(
        words, env=ros_domain, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    assert_one_line(result.stderr, *names)
