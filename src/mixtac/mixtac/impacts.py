# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of the impacts on a held object: as text, and as a figure of all impacts."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from mixtac.figures import MARK, REFERENCE, new_axes, save_figure

FALLEN_MM: Final = 5.0
"""An object that moves farther is lost [mm]: the contact of the fingertip is 12 mm wide."""
BEFORE_S: Final = 0.05
"""Time before an impact that its picture shows [s]."""
SHOWN_S: Final = 0.35
"""Time after an impact that its picture shows [s]."""
KEPT: Final = 2000
"""Samples that are kept of before the next impact."""


@dataclass(slots=True)
class Impact:
    """One impact and what followed.

    Attributes:
        struck_s: When the object was struck [s].
        start_mm: How far down the object was before [mm].
        places: Times [s] and places of the object, downwards [mm].
        advances: Times [s] and wanted advances of the arm [mm].
        detected_s: When slip was seen first [s]; None if it was not.
        stopped: Why slip control stopped; empty if it did not.
    """

    struck_s: float
    start_mm: float
    places: list[tuple[float, float]] = field(default_factory=list)
    advances: list[tuple[float, float]] = field(default_factory=list)
    detected_s: float | None = None
    stopped: str = ''

    @property
    def moved_mm(self) -> float:
        """Largest downward displacement of the object since the impact [mm]."""
        return max((place - self.start_mm for _, place in self.places), default=0.0)

    @property
    def held(self) -> bool:
        """Whether the object was held."""
        return self.moved_mm <= FALLEN_MM

    def words(self) -> str:
        """Return the result of the impact as text."""
        seen = 'detected' if self.detected_s is not None else 'not detected'
        end = f'the object moved {self.moved_mm:.2f} mm and is held'
        if not self.held:
            end = f'THE OBJECT FELL (more than {FALLEN_MM:g} mm down)'
        advance = max((each for _, each in self.advances), default=0.0)
        stop = f', slip control stopped: {self.stopped}' if self.stopped else ''
        return f'impact {seen}: {end}, the arm advanced {advance:.2f} mm{stop} (simulated)'


class ImpactLog:
    """Collects what objects and arm do, impact by impact.

    Attributes:
        impacts: The impacts so far, the last one perhaps still open.
        place_mm: Place of the object, downwards [mm].
    """

    def __init__(self) -> None:
        self.impacts: list[Impact] = []
        self.place_mm = 0.0
        self._open = False
        self._before: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def struck(self, now_s: float) -> None:
        """Begin with an impact [s]."""
        impact = Impact(now_s, self.place_mm)
        impact.places = [each for each in self._before if each[0] >= now_s - BEFORE_S]
        self.impacts.append(impact)
        self._open = True

    def on_place(self, now_s: float, place_mm: float) -> None:
        """Add the place of the object, downwards [mm]."""
        self.place_mm = place_mm
        (self.impacts[-1].places if self._open else self._before).append((now_s, place_mm))

    def on_slip(self, now_s: float, advance_mm: float, stopped: str, *, slipping: bool) -> None:
        """Add the wanted advance [mm] of slip control, why it stopped, and whether it sees slip."""
        if not self._open:
            return
        impact = self.impacts[-1]
        impact.advances.append((now_s, advance_mm))
        impact.stopped = impact.stopped or stopped
        if slipping and impact.detected_s is None:
            impact.detected_s = now_s

    def close(self) -> str:
        """End the open impact; return what happened."""
        self._open = False
        return self.impacts[-1].words()

    def summary(self) -> str:
        """Return how many impacts were held."""
        if not self.impacts:
            return 'no impact so far: give it more time (--seconds)'
        held = [each for each in self.impacts if each.held]
        text = f'{len(held)} of {len(self.impacts)} impacts held'
        if held:
            middle = sorted(each.moved_mm for each in held)[len(held) // 2]
            text += f', the object moved {middle:.2f} mm in the middle one of them'
        return f'{text} (simulated)'


def draw_impacts(impacts: Sequence[Impact], path: Path) -> None:
    """Save a picture of impacts: object and arm over time, each from its impact.

    Raises:
        FileError: The file cannot be written.
    """
    figure, (upper, lower) = new_axes(rows=2, width=9.0, height=6.0)
    held = sum(each.held for each in impacts)
    upper.set_title(f'Simulated grasp: {held} of {len(impacts)} impacts held (red: fallen)')
    for impact in impacts:
        colour = REFERENCE if impact.held else MARK
        series = (upper, impact.places, impact.start_mm), (lower, impact.advances, 0.0)
        for axes, rows, zero in series:
            after_s, value_mm = np.array(rows).T - [[impact.struck_s], [zero]]
            shown = after_s <= SHOWN_S
            axes.plot(1e3 * after_s[shown], value_mm[shown], color=colour, alpha=0.7)
    upper.set_ylabel('object, downwards [mm]')
    lower.set(ylabel='arm, wanted advance [mm]', xlabel='time since the impact [ms]')
    save_figure(figure, path)
