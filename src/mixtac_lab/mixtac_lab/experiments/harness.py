# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What an experiment is given and what it returns.

An experiment is a function that takes a `Context` and returns an `Outcome`: rows that set our
values beside those of the paper, figures, and a list of what was done differently. The rows that
all force experiments share are made here as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mixtac_lab.store import carry_out
from mixtac_learning.judge.metrics import measure, peak_error

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from rich.progress import Progress

    from mixtac_lab.experiments.sizes import Sizes
    from mixtac_lab.store import Piece
    from mixtac_learning.judge.estimators import TrialEstimate
    from mixtac_learning.judge.metrics import Metrics


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


def pooled(estimates: Sequence[TrialEstimate]) -> Metrics:
    """Return the errors of all windows of some trials together."""
    known = np.concatenate([each.known for each in estimates])
    return measure(known, np.concatenate([each.force for each in estimates]))


def error_rows(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    paper: Mapping[str, float],
    place: str,
    conditions: str,
    *,
    simulated: bool,
) -> list[Row]:
    """Return MAE, RMSE and R2 of a model; one value per seed.

    Args:
        name: Of the model.
        by_seed: Its estimates.
        paper: The paper's numbers by `mae`, `rmse`, `r2`; missing ones were not given.
        place: Where in the paper.
        conditions: Of the data.
        simulated: Whether the data are.
    """
    metrics = [pooled(estimates) for estimates in by_seed.values()]
    return [
        Row(
            f'{name}: {title}',
            Value.of(getattr(each, key) for each in metrics),
            paper.get(key),
            place if key in paper else '',
            unit,
            conditions,
            simulated,
        )
        for key, title, unit in (('mae', 'MAE', 'N'), ('rmse', 'RMSE', 'N'), ('r2', 'R2', ''))
    ]


def constant_row(
    by_seed: Mapping[int, Sequence[TrialEstimate]], conditions: str, *, simulated: bool
) -> Row:
    """Return the MAE of the best constant: what no sensor at all achieves."""
    values = Value.of(pooled(estimates).constant_mae for estimates in by_seed.values())
    return Row('best constant: MAE', values, None, '', 'N', conditions, simulated)


def peak_row(
    name: str,
    by_seed: Mapping[int, Sequence[TrialEstimate]],
    conditions: str,
    *,
    simulated: bool,
) -> Row:
    """Return the mean relative error at the largest force of each trial."""
    values = Value.of(
        float(np.mean([peak_error(e.known, e.force, interval_s(e)) for e in estimates]))
        for estimates in by_seed.values()
    )
    return Row(f'{name}: error of the peak', values, None, '', '', conditions, simulated)


def interval_s(estimate: TrialEstimate) -> float:
    """Return the time between estimates [s]."""
    return 1e-6 * float(np.median(np.diff(estimate.t_us)))


def rate_hz(estimates: Sequence[TrialEstimate]) -> float:
    """Return how many different forces per second a model gives [Hz]."""
    changes = sum(int(np.count_nonzero(np.diff(e.force))) for e in estimates)
    return changes / sum(1e-6 * float(e.t_us[-1] - e.t_us[0]) for e in estimates)


@dataclass(frozen=True, slots=True)
class Context:
    """A run.

    Attributes:
        sizes: How large.
        folder: Where everything is kept.
        seeds: How many seeds: each is another training and, simulated, another sensor.
        jobs: Processes.
        bags: The user's recordings; None for simulated ones.
        progress: Where bars are shown.
    """

    sizes: Sizes
    folder: Path
    seeds: int
    jobs: int
    bags: Path | None
    progress: Progress

    @property
    def figures(self) -> Path:
        """Folder of the figures; made when it is asked for."""
        folder = self.folder / 'figures'
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @property
    def pieces(self) -> Path:
        """Folder of finished pieces of work."""
        return self.folder / 'pieces'

    def run(self, title: str, pieces: Sequence[Piece]) -> list[dict[str, Any]]:
        """Return the results of pieces of work, with a bar meanwhile.

        Raises:
            MixtacError: One cannot be carried out.
        """
        bar = self.progress.add_task(title, total=len(pieces))

        def say(words: str) -> None:
            text = f'{title} ({words})' if words else title
            self.progress.update(bar, description=text)

        return carry_out(pieces, self.pieces, self.jobs, lambda: self.progress.advance(bar), say)
