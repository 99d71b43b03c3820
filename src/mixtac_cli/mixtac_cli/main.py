# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The `mixtac` command line: which function stands behind each command.

A command is a function for typer. Its module is imported when the command runs or its help is
printed, so that a short command does not wait for the imports of a long one.
"""

from __future__ import annotations

import importlib
import io
import sys
from collections.abc import Mapping
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from mixtac_events.errors import MixtacError, error_line

COMMANDS = {
    'align': 'mixtac_cli.align:align',
    'calibrate': 'mixtac_cli.calibrate:calibrate',
    'calibrate-force': 'mixtac_cli.calibrate_force.command:calibrate_force',
    'demo': 'mixtac_cli.demo.command:demo',
    'doctor': 'mixtac_cli.doctor:doctor',
    'evaluate': 'mixtac_learning.commands:evaluate',
    'experiments': 'mixtac_learning.experiments:EXPERIMENTS',
    'export': 'mixtac_cli.export:export',
    'import': 'mixtac_cli.export:import_',
    'inspect': 'mixtac_cli.export:inspect',
    'record': 'mixtac_cli.record.session:record',
    'repair': 'mixtac_cli.export:repair',
    'simulate': 'mixtac_cli.simulate:simulate',
    'train': 'mixtac_learning.commands:train',
    'up': 'mixtac_cli.up:up',
    'view': 'mixtac_cli.up:view',
}
UP = {'slip': 'mixtac_cli.up:slip'}
INTERRUPTED = 130


class Commands(TyperGroup):
    """Commands that are imported on demand.

    Attributes:
        targets: Function of each command as `module:name`, or a group of commands.
    """

    targets: Mapping[str, Any]

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002
        """Return the names of the commands, sorted."""
        return sorted(self.targets)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401, ARG002
        """Return a command, None for an unknown one."""
        target = self.targets.get(cmd_name)
        if not isinstance(target, str):
            return target
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        try:
            found = load(target)
            if isinstance(found, dict):
                return group(cmd_name, found, "The paper's experiments.")
            app.command(cmd_name)(found)
        except MixtacError as error:
            app.command(cmd_name, help=str(error))(raising(error))
        return get_command(app)


def load(target: str) -> Any:  # noqa: ANN401
    """Return the function that `module:name` names.

    Raises:
        MixtacError: A package that it needs is not installed.
    """
    module, _, name = target.partition(':')
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if error.name is None or (error.name.startswith('mixtac') and error.name in module):
            remedy = 'install the whole of Mixtac, not only the part for robots'
        else:
            remedy = f"install it: pip install '{error.name}', or an extra of pyproject.toml"
        raise MixtacError(f'{error.name} is not installed', remedy=remedy) from error


def raising(error: MixtacError) -> Any:  # noqa: ANN401
    """Return a command that raises an error: the help lists it, with the reason."""

    def command() -> None:
        raise error

    return command


def group(name: str, targets: Mapping[str, Any], text: str, function: Any = None) -> Any:  # noqa: ANN401
    """Return a group of commands.

    Args:
        name: Its name.
        targets: Its commands, see `Commands`.
        text: Its help.
        function: Called without a sub-command; None prints the help.
    """
    cls = type('Commands', (Commands,), {'targets': targets})
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    if function is None:
        app.callback(cls=cls, no_args_is_help=True, help=text)(lambda: None)
    else:
        app.callback(cls=cls, invoke_without_command=True)(function)
    command = get_command(app)
    command.name = name
    return command


class Root(Commands):
    """The commands, with `up` as a group that also runs by itself."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401
        """Return a command, None for an unknown one."""
        if cmd_name == 'up':
            return group('up', UP, '', load(COMMANDS['up']))
        return super().get_command(ctx, cmd_name)


def root() -> Any:  # noqa: ANN401
    """Return the command `mixtac`."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    cls = type('Commands', (Root,), {'targets': COMMANDS})
    text = 'Mixtac: event- and frame-based tactile force sensing in ROS 2.'
    app.callback(cls=cls, no_args_is_help=True, help=text)(lambda: None)
    command = get_command(app)
    command.name = 'mixtac'
    return command


def main(arguments: list[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: Without the program's name; None for those of the process.

    Returns:
        Exit status: 0, 1 after an expected failure (one line on stderr), 2 for wrong usage,
        130 after Ctrl-C.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Names of files need not be UTF-8.
            stream.reconfigure(errors='backslashreplace')
    try:
        result = root()(arguments, prog_name='mixtac', standalone_mode=False)
    except MixtacError as error:
        print(error_line(str(error)), file=sys.stderr)
        return 1
    except OSError as error:
        # A disk that is full, a name that is too long: what a path meets outside of the program.
        place = f'{error.filename}: ' if error.filename else ''
        print(error_line(f'{place}{error.strerror or error}'), file=sys.stderr)
        return 1
    except typer.Exit as leave:
        return leave.exit_code
    except (typer.Abort, KeyboardInterrupt):
        print('interrupted', file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if not hasattr(error, 'format_message'):
            raise
        # Empty if the help was printed because no command was given.
        if text := error.format_message():
            print(error_line(text), file=sys.stderr)
        return 2
    return result if isinstance(result, int) else 0
