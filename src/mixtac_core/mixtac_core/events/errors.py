# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The base class of every error that users may see, and the line that reports it.

This class has a module of its own, because all other modules import it.
"""

from __future__ import annotations


class MixtacError(Exception):
    """An expected failure whose text is one clear line: the value at fault and the remedy.

    Command lines and node mains print ``str(error)`` and exit with a non-zero status; any other
    exception is a defect and keeps its traceback.

    Args:
        message: What is wrong, with the value.
        remedy: What the user can do about it; appended to the text.

    Attributes:
        remedy: As given, empty if the message holds it already.
    """

    def __init__(self, message: str = '', *, remedy: str = '') -> None:
        super().__init__(message)
        self.remedy = remedy

    @property
    def message(self) -> str:
        """The text without the remedy."""
        return super().__str__()

    def __str__(self) -> str:
        """Return the message and, after a semicolon, the remedy."""
        return f'{self.message}; {self.remedy}' if self.remedy else self.message


ERROR = 'error: '
"""Begins the line on stderr with which a command or a node that failed ends."""


def error_line(text: str) -> str:
    """Return the one line that reports why a process ends.

    Names of files may hold new lines and control characters: both are shown as escapes.
    """
    return ERROR + ''.join(each if each.isprintable() else repr(each)[1:-1] for each in text)
