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
from typing import Any, ClassVar

import typer
from typer.core import TyperGroup
from typer.main import get_command

from mixtac_core.events.errors import MixtacError, error_line

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


def mixtac() -> None:
    """Mixtac: event- and frame-based tactile force sensing in ROS 2."""


def experiments() -> None:
    """The paper's experiments."""


COMMANDS = {
    '': mixtac,
    'align': 'mixtac.align:align',
    'calibrate': 'mixtac.calibrate:calibrate',
    'calibrate-force': 'mixtac.calibrate_force.command:calibrate_force',
    'demo': 'mixtac.demo.command:demo',
    'doctor': 'mixtac.doctor:doctor',
    'evaluate': 'mixtac_learning.commands:evaluate',
    'experiments': 'mixtac_learning.experiments:EXPERIMENTS',
    'export': 'mixtac.export:export',
    'import': 'mixtac.export:import_',
    'inspect': 'mixtac.export:inspect',
    'record': 'mixtac.record.session:record',
    'repair': 'mixtac.export:repair',
    'simulate': 'mixtac.simulate:simulate',
    'train': 'mixtac_learning.commands:train',
    'up': {'': 'mixtac.up:up', 'slip': 'mixtac.up:slip'},
    'view': 'mixtac.up:view',
}
"""Function of each command as `module:name`; a dictionary is a group, with its function at ''.

A name may also be that of such a dictionary: robots have no experiments.
"""


class Commands(TyperGroup):
    """A group whose commands are imported on demand.

    Attributes:
        targets: Its part of `COMMANDS`.
    """

    targets: ClassVar[Mapping[str, Any]]

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002
        """Return the names of the commands, sorted."""
        return sorted(filter(None, self.targets))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401, ARG002
        """Return a command, None for an unknown one."""
        target = self.targets.get(cmd_name) if cmd_name else None
        return target and make_command(cmd_name, target)


def make_command(name: str, target: str | Mapping[str, Any]) -> Any:  # noqa: ANN401
    """Return a command or a group of commands for typer.

    Args:
        name: Its name.
        target: One of the values of `COMMANDS`, or all of it.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    found = load(target) if isinstance(target, str) else target
    if callable(found):
        app.command(name)(found)
    else:
        cls = type('Group', (Commands,), {'targets': found})
        first = found.get('', experiments)
        works = isinstance(first, str)
        function = load(first) if works else first
        app.callback(cls=cls, invoke_without_command=works, no_args_is_help=not works)(function)
    command = get_command(app)
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
        if error.name is None or (error.name.startswith('mixtac') and error.name in module):
            remedy = 'install the whole of Mixtac, not only the part for robots'
        else:
            remedy = f"install it: pip install '{error.name}', or an extra of pyproject.toml"
        failure = MixtacError(f'{error.name} is not installed', remedy=remedy)

    def absent() -> None:
        raise failure

    absent.__doc__ = str(failure)
    return absent


def root() -> Any:  # noqa: ANN401
    """Return the command `mixtac`."""
    return make_command('mixtac', COMMANDS)


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
        # A full disk, or a name that is too long.
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
