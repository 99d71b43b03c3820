# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip detectors: the translation of the skin, and the event count of the paper.

Count (paper, section Closed loop Slip Control): slip is detected when the event count N_t of a 1 ms
window exceeds the background threshold N_th. A count cannot distinguish slip from a change of
force, which moves beads too. The threshold at rest is learned once, from the first second, and
again after a tare.

Flow: translation of the skin around the contact. Events of a changing normal force point away from
the contact and cancel in the translation, and so do pixels that flicker without motion. A slip has
to be large enough and significant, in one window or in four. It is significant if the squares of
its translation exceed those that as many events at the same places give with signs at random, which
is how a sensor at rest behaves. Squares, because a skin that is dragged along springs back within a
few windows: the sum of both motions is small.

`Detectors` runs both on the same windows.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import islice
from typing import Final

import numpy as np

from mixtac_slip_control.features import SlipWindow
from mixtac_slip_control.parameters import PAPER, WINDOW_S, Current

LEARNING_WINDOWS: Final = 1000
"""Windows at rest from which the threshold of the count is learned: one second."""
TAIL: Final = 0.1
"""Share of the windows at rest that form the tail."""
TAIL_REACH: Final = 35.0
"""Mean excesses of the tail from its start to the threshold: windows at rest exceed it about once
in ten hours where the tail is a generalised Pareto distribution of shape 0.1."""
MIN_EXCESS: Final = 20.0
"""Smallest count threshold above the background [events]."""
SPANS: Final = {1: 17.4, 4: 25.4}
"""Windows that are checked together, and the sum of the squares of their translations over those of
random signs from which on they are significant: windows at rest exceed it once in ten hours (tail
of a gamma distribution whose shape is the number of windows)."""
FLOW_PER_M: Final = 4e3
"""Translation of the skin by an advance of the arm [px per contrast threshold and m]: raises the
threshold while the arm moves."""
RELEASE_SHARE: Final = 0.5
"""Share of the threshold below which a window is quiet."""
RELEASE_WINDOWS: Final = 5
"""Quiet windows that end a slip."""


class CountDetector:
    """The detector of the paper: slip if N_t > N_th.

    Attributes:
        median: Median count at rest; 0 until learned.
        scale: Mean excess of the tail of the counts at rest.
        limit: N_th; 0 until learned.
        slipping: Whether the latest window slipped.
    """

    def __init__(self) -> None:
        self.reset()

    @property
    def learned(self) -> bool:
        """Whether enough windows have been seen."""
        return self.limit > 0.0

    def update(self, window: SlipWindow) -> bool:
        """Return whether a window slips."""
        self.slipping = self.learned and window.count > self.limit
        return self.slipping

    def learn(self, count: int) -> None:
        """Use the count of a window at rest; ignored once the threshold is learned."""
        if self.learned:
            return
        self._counts.append(count)
        if len(self._counts) == LEARNING_WINDOWS:
            counts = np.array(self._counts)
            self.median, start = (float(q) for q in np.quantile(counts, (0.5, 1.0 - TAIL)))
            excess = counts[counts > start] - start
            self.scale = float(excess.mean()) if len(excess) else 0.0
            self.limit = max(start + TAIL_REACH * self.scale, self.median + MIN_EXCESS)

    def reset(self) -> None:
        """Forget the threshold; it is learned again."""
        self._counts: list[int] = []
        self.median = self.scale = self.limit = 0.0
        self.slipping = False


class FlowDetector:
    """Detects slip by the translation of the skin; lengths are in px per contrast threshold.

    Without a frame there is no translation: such windows count as quiet.

    Attributes:
        flow: Translation in the latest window, or the root of the sum of squares over four windows
            as a share of its own threshold if that is higher; 0 if it is not significant.
        threshold: Threshold of `flow` in the latest window.
        slipping: Whether the latest window slipped; a slip ends after some quiet windows.
    """

    def __init__(self) -> None:
        self._quiet = 0
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=max(SPANS))
        self.flow = self.threshold = 0.0
        self.slipping = False

    def update(self, window: SlipWindow, min_flow: float, advance_m: float) -> bool:
        """Return whether the object slips.

        Args:
            window: The next window.
            min_flow: Smallest translation that counts as slip.
            advance_m: Commanded motion of the arm within the window [m], of either sign.
        """
        square = window.flow_x**2 + window.flow_y**2
        significance = square / window.noise if window.noise > 0.0 else 0.0
        self._recent.appendleft((square, significance, abs(advance_m)))
        self.threshold = min_flow + FLOW_PER_M * abs(advance_m)
        self.flow = 0.0
        for windows, least in SPANS.items():
            squares, sure, moved_m = map(sum, zip(*islice(self._recent, windows), strict=True))
            if sure > least or self.slipping:
                # On one scale: as if the threshold were that of the single window.
                share = math.sqrt(squares) / (min_flow + FLOW_PER_M * moved_m)
                self.flow = max(self.flow, share * self.threshold)
        if self.flow > self.threshold:
            self.slipping, self._quiet = True, 0
        elif self.slipping:
            self._quiet = self._quiet + 1 if self.flow <= RELEASE_SHARE * self.threshold else 0
            self.slipping = self._quiet < RELEASE_WINDOWS
        return self.slipping

    def reset(self) -> None:
        """Forget the latest windows."""
        self.slipping = False
        self._recent.clear()


class Detectors:
    """Runs both detectors and lets the count learn at rest.

    Args:
        parameters: Returns the law, and the smallest translation of a slip.

    Attributes:
        count: The detector of the paper, which decides under the law `paper`.
        flow: The flow detector, which decides under the law `step`.
        slipping: Decision on the latest window.
    """

    def __init__(self, parameters: Current) -> None:
        self._parameters = parameters
        self.count = CountDetector()
        self.flow = FlowDetector()
        self.slipping = False

    def update(self, window: SlipWindow, advance_m: float) -> bool:
        """Return whether the object slips; windows at rest teach the count its threshold.

        Args:
            window: The next window. A change of light is not a slip.
            advance_m: Commanded motion of the arm within it [m].
        """
        if window.light:
            self.slipping = False
            return False
        by_count = self.count.update(window)
        by_flow = self.flow.update(window, self._parameters().min_flow, advance_m)
        self.slipping = by_count if self._parameters().law == PAPER else by_flow
        if window.complete and not self.slipping:
            self.count.learn(window.count)
        return self.slipping

    def reset(self) -> None:
        """Forget what was learned."""
        self.count.reset()
        self.flow.reset()
        self.slipping = False


LEARNING_S: Final = LEARNING_WINDOWS * WINDOW_S
"""Time at rest from which the threshold of the count is learned [s]."""
