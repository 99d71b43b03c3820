# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The base of every error that a user may see."""

from __future__ import annotations


class MixtacError(Exception):
    """An expected failure whose text is one clear line: the value at fault and the remedy.

    Command lines and node mains print ``str(error)`` and exit with a non-zero status; anything
    that is not a ``MixtacError`` is a defect and keeps its traceback.
    """
