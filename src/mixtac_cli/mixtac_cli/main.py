# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The `mixtac` command line.

Commands come from the entry points in the group `mixtac.commands` of whatever packages are
installed: functions for typer, named as the command is typed, with a dot before each sub-command
(`train`, `bench.decode`). A command is imported when it runs; lists of commands read only its
docstring.
"""

from __future__ import annotations

import ast
import importlib.util
import io
import sys
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from mixtac_events.errors import MixtacError, error_line

GROUP = 'mixtac.commands'
INTERRUPTED = 130
HELP = {
    '': 'Mixtac: event- and frame-based tactile force sensing in ROS 2.',
    'bench': 'Benchmarks of the parts.',
    'experiments': 'Experiments on the virtual sensor.',
}
"""Help texts of the groups that are not commands themselves."""


class Commands(TyperGroup):
    """The commands below one word of the command line, imported when they run.

    Attributes:
        prefix: Beginning of the names of their entry points.
    """

    prefix = ''

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401, ARG002
        """Return the names of the commands, sorted."""
        return sorted({name.partition('.')[0] for name in self._points})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401, ARG002
        """Return a command with its help text only, None for an unknown one."""
        point = self._points.get(cmd_name)
        if point is not None:
            return TyperCommand(cmd_name, help=summary(point))
        if not self._has_group(cmd_name):
            return None
        return TyperCommand(cmd_name, help=HELP.get(self.prefix + cmd_name, ''))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401
        """Return name, command and remaining words; the command is imported here."""
        name, _, rest = super().resolve_command(ctx, args)
        return name, self._load(str(name)), rest

    def _load(self, name: str) -> Any:  # noqa: ANN401
        point = self._points.get(name)
        function: Any = None if point is None else point.load()
        if self._has_group(name):
            return group(self.prefix + name, function)
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command(name)(function)
        return get_command(app)

    def _has_group(self, name: str) -> bool:
        return any(each.startswith(f'{name}.') for each in self._points)

    @cached_property
    def _points(self) -> dict[str, EntryPoint]:
        start = len(self.prefix)
        found = entry_points(group=GROUP)
        return {each.name[start:]: each for each in found if each.name.startswith(self.prefix)}


def group(name: str, function: Any = None) -> Any:  # noqa: ANN401
    """Return the group of the commands whose entry points begin with a name and a dot.

    Args:
        name: The name, empty for all commands.
        function: Called without a sub-command; None shows the help instead.
    """
    cls = type('Commands', (Commands,), {'prefix': f'{name}.' if name else ''})
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    if function is None:
        options: dict[str, Any] = {'no_args_is_help': True, 'help': HELP.get(name, '')}
        app.callback(cls=cls, **options)(lambda: None)
    else:
        app.callback(cls=cls, invoke_without_command=True)(function)
    command = get_command(app)
    command.name = name.rpartition('.')[2] or 'mixtac'
    return command


def summary(point: EntryPoint) -> str:
    """Return the first paragraph of a command's docstring without importing its module."""
    spec = importlib.util.find_spec(point.module)
    source = getattr(spec and spec.loader, 'get_source', lambda _: None)(point.module) or ''
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef) and node.name == point.attr:
            return (ast.get_docstring(node) or '').partition('\n\n')[0]
    return (point.load().__doc__ or '').partition('\n\n')[0]


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
        result = group('')(arguments, prog_name='mixtac', standalone_mode=False)
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
