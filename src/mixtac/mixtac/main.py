# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The `mixtac` command line, and the function of each command.

A command is a function for typer. Its module is imported only when the command runs or its help is
printed, so that a fast command does not wait for the imports of a slow one.
"""

from __future__ import annotations

import importlib
import io
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from threading import Timer, get_ident
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperGroup
from typer.main import get_command

from mixtac_core.events.errors import MixtacError, error_line

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


def show_version(asked: bool) -> None:
    """Print the version and exit, if `--version` is given."""
    if asked:
        print(f'mixtac {version("mixtac")}')
        raise typer.Exit


def mixtac(
    _version: Annotated[
        bool,
        typer.Option(
            '--version', is_eager=True, callback=show_version, help='Print the version and exit.'
        ),
    ] = False,
) -> None:
    """Mixtac: event- and frame-based tactile force sensing in ROS 2."""


def experiments() -> None:
    """The paper's experiments."""


PANELS: dict[str, dict[str, Any]] = {
    'Run': {
        'demo': 'mixtac.demo:demo',
        'up': {'': 'mixtac.up:up', 'slip': 'mixtac.up:slip'},
        'view': 'mixtac.up:view',
        'doctor': 'mixtac.doctor:doctor',
    },
    'Record': {
        'record': 'mixtac.record:record',
        'inspect': 'mixtac.export:inspect',
        'export': 'mixtac.export:export',
        'import': 'mixtac.export:import_',
        'repair': 'mixtac.export:repair',
    },
    'Calibrate': {
        'calibrate': 'mixtac.calibrate:calibrate',
        'calibrate-force': 'mixtac.calibrate_force:calibrate_force',
        'align': 'mixtac.align:align',
    },
    'Learn': {
        'simulate': 'mixtac.simulate:simulate',
        'train': 'mixtac_learning.commands:train',
        'evaluate': 'mixtac_learning.commands:evaluate',
        'experiments': 'mixtac_learning.experiments:EXPERIMENTS',
    },
}
"""Commands by the panel of the help that lists them; a new command is one line here.

The function of a command is named as `module:name`. A dictionary is a group, with its function at
''; the name of such a dictionary is one too: robots have no experiments.
"""
COMMANDS = {'': mixtac} | {name: each for part in PANELS.values() for name, each in part.items()}
SHOWN_IN = {name: panel for panel, part in PANELS.items() for name in part}


class Commands(TyperGroup):
    """A group whose commands are imported on demand.

    Attributes:
        targets: Its commands, as in `PANELS`.
    """

    targets: ClassVar[Mapping[str, Any]]

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002
        """Return the names of the commands."""
        return list(filter(None, self.targets))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401, ARG002
        """Return a command, or None if it is unknown."""
        target = self.targets.get(cmd_name) if cmd_name else None
        return target and make_command(cmd_name, target)


def make_command(name: str, target: str | Mapping[str, Any]) -> Any:  # noqa: ANN401
    """Return a command or a group of commands for typer.

    Args:
        name: Its name.
        target: `COMMANDS`, or one of its values.
    """
    helped: dict[str, Any] = {'help_option_names': ['-h', '--help']}
    panel = SHOWN_IN.get(name)
    app = typer.Typer(
        add_completion=name == 'mixtac', pretty_exceptions_enable=False, context_settings=helped
    )
    found = load(target) if isinstance(target, str) else target
    command: Any
    if callable(found):
        if found.__name__ == 'absent':
            # Whatever is given to it, it says what is not installed.
            helped |= {'ignore_unknown_options': True, 'allow_extra_args': True}
        app.command(name, rich_help_panel=panel, context_settings=helped)(found)
        command = get_command(app)
    else:
        cls = type('Group', (Commands,), {'targets': found})
        first = found.get('', experiments)
        works = isinstance(first, str)
        app.callback(
            cls=cls,
            invoke_without_command=works,
            no_args_is_help=not works,
            rich_help_panel=panel,
        )(load(first) if works else first)
        command = get_command(app)
        # From these names typer chooses what may have been meant.
        command.commands = dict.fromkeys(filter(None, found))
    command.name = name
    return command


def load(target: str) -> Any:  # noqa: ANN401
    """Return the function, or the dictionary of commands, that `module:name` names.

    Where a package that it needs is not installed, the returned function raises an error about it.
    """
    module, _, name = target.partition(':')
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        failure = missing(error)

    def absent() -> None:
        raise failure

    absent.__doc__ = str(failure)
    return absent


def missing(error: ModuleNotFoundError) -> MixtacError:
    """Return the error about a package that is not installed, with its remedy."""
    name = str(error.name).partition('.')[0]
    remedy = f"install it: pip install '{name}', or an extra of pyproject.toml"
    if name == 'rclpy' or name.endswith('_msgs'):
        remedy = 'this needs ROS 2: source it, or run ./mixtac of a checkout, which brings it'
    elif name.startswith('mixtac'):
        remedy = 'install the whole of Mixtac, not only the part for robots'
    return MixtacError(f'{name} is not installed', remedy=remedy)


def root() -> Any:  # noqa: ANN401
    """Return the command `mixtac`."""
    return make_command('mixtac', COMMANDS)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: Arguments without the program name; None for those of the process.

    Returns:
        Exit status: 0; 1 after an expected failure, with one line on stderr, or if a check fails;
        2 for wrong usage; 130 after Ctrl-C.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Names of files need not be UTF-8.
            stream.reconfigure(errors='backslashreplace')
    interrupted: list[int] = []
    try:
        with noting_interrupt(interrupted):
            result = root()(arguments, prog_name='mixtac', standalone_mode=False)
        # Typer returns the status of an exit, and makes one of Ctrl-C.
        status = result if isinstance(result, int) else 0
    except (KeyboardInterrupt, Exception) as error:
        if isinstance(error, ModuleNotFoundError) and not interrupted:
            error = missing(error)
        expected = isinstance(error, MixtacError | OSError)
        # A library may have made its own error of an interrupt.
        stopped = isinstance(error, (typer.Abort, KeyboardInterrupt)) or bool(interrupted)
        if stopped and not expected:
            status = INTERRUPTED
        elif not expected and not hasattr(error, 'format_message'):
            raise
        else:
            # The text is empty if the help was printed because no command was given.
            if text := error_text(error):
                print(error_line(text), file=sys.stderr)
            status = 1 if expected else 2
    if status == INTERRUPTED:
        print('interrupted', file=sys.stderr)
    return status


def error_text(error: Any) -> str:  # noqa: ANN401
    """Return the text of an expected failure, or of wrong usage."""
    if isinstance(error, MixtacError):
        return str(error)
    if isinstance(error, OSError):
        # A full disk, or a name that is too long.
        return f'{error.filename or ""}: {error.strerror or error}'.removeprefix(': ')
    return str(error.format_message())


@contextmanager
def noting_interrupt(noted: list[int]) -> Iterator[None]:
    """Raise KeyboardInterrupt on Ctrl-C, and note that in a list."""

    def interrupt(number: int, frame: Any) -> None:  # noqa: ANN401
        noted.append(number)
        while frame and 'llvmlite' not in frame.f_code.co_filename:
            frame = frame.f_back
        if not frame:
            raise KeyboardInterrupt
        # What is raised while LLVM calls back is lost, or ends the process.
        Timer(0.05, signal.pthread_kill, [get_ident(), number]).start()

    handled = signal.getsignal(signal.SIGINT)
    if callable(handled):
        signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handled)
