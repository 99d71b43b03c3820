# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What an experiment gives: numbers beside the paper's, figures, and what was done differently."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Value:
    """A number of ours.

    Attributes:
        mean: Mean; NaN where there is nothing to take the mean of.
        spread: Standard deviation of one, 0 where there is only one.
        count: How many values.
        over: What they differ in: seeds, trials, repetitions.
    """

    mean: float
    spread: float
    count: int
    over: str

    @classmethod
    def of(cls, values: Iterable[float], over: str = 'seeds') -> Value:
        """Return mean and spread of the finite ones among some values."""
        good = [value for value in values if math.isfinite(value)]
        if not good:
            return cls(math.nan, 0.0, 0, over)
        spread = float(np.std(good, ddof=1)) if len(good) > 1 else 0.0
        return cls(float(np.mean(good)), spread, len(good), over)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-ready values; a mean of nothing is None."""
        known = math.isfinite(self.mean)
        return {
            'mean': round(self.mean, 5) if known else None,
            'spread': round(self.spread, 5),
            'count': self.count,
            'over': self.over,
        }


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a report.

    Attributes:
        name: What was measured, of what.
        ours: Our number.
        paper: The paper's, None where it gives none.
        place: Where in the paper it stands; empty if nowhere.
        unit: Of both; empty for ratios.
        conditions: Under which ours was measured.
        simulated: Whether the data are simulated.
    """

    name: str
    ours: Value
    paper: float | None
    place: str
    unit: str
    conditions: str
    simulated: bool = True

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-ready values."""
        return {
            'name': self.name,
            'ours': self.ours.as_dict(),
            'paper': self.paper,
            'place': self.place,
            'unit': self.unit,
            'conditions': self.conditions,
            'simulated': self.simulated,
        }


@dataclass(frozen=True, slots=True)
class Outcome:
    """What an experiment gave.

    Attributes:
        name: Of the experiment.
        title: For people.
        paper: What the paper did, in a sentence or two.
        data: Data set: name, seeds, preset, sizes.
        rows: Numbers.
        figures: Pictures by caption.
        deviations: What differs from the paper's protocol.
        skipped: Why the experiment was not carried out; empty if it was.
        table: The numbers as the paper sets them out, first line headings; empty for none.
    """

    name: str
    title: str
    paper: str
    data: str
    rows: list[Row] = field(default_factory=list)
    figures: dict[str, Path] = field(default_factory=dict)
    deviations: tuple[str, ...] = ()
    skipped: str = ''
    table: tuple[tuple[str, ...], ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-ready values; figures by their file names."""
        return {
            'name': self.name,
            'title': self.title,
            'paper': self.paper,
            'data': self.data,
            'rows': [row.as_dict() for row in self.rows],
            'figures': {caption: path.name for caption, path in self.figures.items()},
            'deviations': list(self.deviations),
            'skipped': self.skipped,
            'table': [list(line) for line in self.table],
        }
