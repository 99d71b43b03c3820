# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events as a struct of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""An array of float64."""


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """Events of a camera, one array per field, all of the same length.

    The producer of the events defines the clock of ``t``.

    Attributes:
        t: Time [us], ``int64``, non-decreasing in a stream.
        x: Column, ``uint16``, 0 at the left.
        y: Row, ``uint16``, 0 at the top.
        polarity: ``bool``, true where the pixel became brighter (ON).
    """

    t: NDArray[np.int64]
    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    polarity: NDArray[np.bool_]

    @property
    def fields(self) -> tuple[Any, ...]:
        """The arrays of times, columns, rows and polarities."""
        return self.t, self.x, self.y, self.polarity

    @classmethod
    def empty(cls, capacity: int = 0) -> Events:
        """Return no events, or room for `capacity` events, whose values are not set."""
        return cls(
            np.empty(capacity, np.int64),
            np.empty(capacity, np.uint16),
            np.empty(capacity, np.uint16),
            np.empty(capacity, np.bool_),
        )

    @classmethod
    def concatenate(cls, parts: Sequence[Events]) -> Events:
        """Return the events of all parts, in the order given."""
        if not parts:
            return cls.empty()
        if len(parts) == 1:
            return parts[0]
        return cls(*map(np.concatenate, zip(*(part.fields for part in parts), strict=True)))

    def __len__(self) -> int:
        """Return the number of events."""
        return len(self.t)

    def __getitem__(self, key: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Events:
        """Return the events chosen by a slice (views), a mask or an index array (copies)."""
        return Events(self.t[key], self.x[key], self.y[key], self.polarity[key])

    def between(self, start_us: int, end_us: int) -> Events:
        """Return the events with ``start_us <= t < end_us`` as views; ``t`` must be sorted."""
        first, last = np.searchsorted(self.t, (start_us, end_us))
        return self[first:last]

    def copy(self) -> Events:
        """Return a copy that shares no memory."""
        return Events(*(each.copy() for each in self.fields))

    def shifted(self, offset_us: int) -> Events:
        """Return the events with ``offset_us`` added to their times."""
        return Events(self.t + np.int64(offset_us), self.x, self.y, self.polarity)
