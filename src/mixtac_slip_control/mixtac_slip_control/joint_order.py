# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The joints of an arm out of joint states in any order."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


class JointOrder:
    """Picks the joints of an arm out of joint states, whatever their order.

    Args:
        names: Of the arm's joints.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._seen: tuple[str, ...] | None = None
        self._places: tuple[int, ...] | None = None

    def pick(self, names: Sequence[str], positions: Sequence[float]) -> tuple[float, ...] | None:
        """Return the arm's joint positions [rad], or None where some are missing."""
        key = tuple(names)
        if key != self._seen:
            self._seen = key
            known = {name: place for place, name in enumerate(key)}
            complete = all(name in known for name in self._names)
            self._places = tuple(known[name] for name in self._names) if complete else None
        if self._places is None or len(positions) < len(key):
            return None
        return tuple(float(positions[place]) for place in self._places)
