# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip detectors: the translation of the skin, and the event count of the paper.

Count (paper, section Closed loop Slip Control): slip is detected when the event count N_t of a 1 ms
window exceeds the background threshold N_th. A count cannot distinguish slip from a change of
force, which moves beads too.

Flow: translation of the skin around the contact. Events of a changing normal force point away from
the contact and cancel in the translation, and so do pixels that flicker without motion. One window
is checked for fast slip, and a sum over several for slow slip, whose motion adds up while noise
does not. In both checks the events must agree: when many pixels fire at once, as when a lamp is
switched on, the remainder of their sum is not a motion.

`Detectors` runs both on the same windows. Their thresholds at rest are learned once, from the first
second, and again after a tare.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from mixtac_slip_control.features import COHERENCE, SlipWindow
from mixtac_slip_control.parameters import PAPER, WINDOW_S, Current

LEARNING_WINDOWS: Final = 1000
"""Windows at rest from which a threshold is learned: one second."""
TAIL: Final = 0.1
"""Share of the windows at rest that form the tail."""
TAIL_REACH: Final = 35.0
"""Mean excesses of the tail from its start to the threshold: windows at rest exceed it about once
in ten hours where the tail is a generalised Pareto distribution of shape 0.1."""
MIN_EXCESS: Final = 20.0
"""Smallest count threshold above the background [events]."""
SLOW_WINDOWS: Final = 4
"""Windows over which translation is summed to find slow slip."""
SLOW_SHARE: Final = 3.5
"""Threshold of that sum over `min_flow`."""
FLOW_PER_M: Final = 4e3
"""Translation of the skin by an advance of the arm [px per contrast threshold and m]: raises the
threshold while the arm moves."""
RELEASE_SHARE: Final = 0.5
"""Share of the threshold below which a window is quiet."""
RELEASE_WINDOWS: Final = 5
"""Quiet windows that end a slip."""


class RestThreshold:
    """A threshold that windows at rest do not exceed.

    Attributes:
        median: Median at rest; 0 until learned.
        scale: Mean excess of the tail of the values at rest.
        threshold: The threshold; infinite until learned.
    """

    def __init__(self) -> None:
        self.reset()

    @property
    def learned(self) -> bool:
        """Whether enough windows have been seen."""
        return math.isfinite(self.threshold)

    def learn(self, value: float) -> None:
        """Use the value of a window at rest; ignored once the threshold is learned."""
        if self.learned:
            return
        self._values.append(value)
        if len(self._values) == LEARNING_WINDOWS:
            values = np.array(self._values)
            self.median, start = (float(q) for q in np.quantile(values, (0.5, 1.0 - TAIL)))
            excess = values[values > start] - start
            self.scale = float(excess.mean()) if len(excess) else 0.0
            self.threshold = start + TAIL_REACH * self.scale

    def reset(self) -> None:
        """Forget the threshold; it is learned again."""
        self._values: list[float] = []
        self.median = self.scale = 0.0
        self.threshold = math.inf


class CountDetector(RestThreshold):
    """The detector of the paper: slip if N_t > N_th.

    Attributes:
        limit: N_th; 0 until learned.
        slipping: Whether the latest window slipped.
    """

    limit = 0.0
    slipping = False

    def update(self, window: SlipWindow) -> bool:
        """Return whether a window slips."""
        self.limit = max(self.threshold, self.median + MIN_EXCESS) if self.learned else 0.0
        self.slipping = self.learned and window.count > self.limit
        return self.slipping


class FlowDetector:
    """Detects slip by the translation of the skin; lengths are in px per contrast threshold.

    Without a frame there is no translation: such windows count as quiet and are not used for
    learning.

    Attributes:
        flow: Translation in the latest window, or the share of the slow sum if that is higher; 0 if
            the events do not agree on a translation.
        threshold: Threshold of `flow` in the latest window.
        moves: Whether the events of the latest window agree on a motion of the skin.
        slipping: Whether the latest window slipped; a slip ends after some quiet windows.
    """

    def __init__(self) -> None:
        self._fast, self._slow = RestThreshold(), RestThreshold()
        self._quiet = 0
        self._recent: deque[tuple[float, float, float, float]] = deque(maxlen=SLOW_WINDOWS)
        self._latest = 0.0, 0.0
        self.flow = self.threshold = 0.0
        self.moves = self.slipping = False

    @property
    def learned(self) -> bool:
        """Whether the thresholds are known."""
        return self._fast.learned

    def update(self, window: SlipWindow, min_flow: float, advance_m: float) -> bool:
        """Return whether the object slips; never before the thresholds are learned.

        Args:
            window: The next window.
            min_flow: Smallest translation in one window that counts as slip.
            advance_m: Commanded motion of the arm within the window [m], of either sign.
        """
        self._recent.append((window.flow_x, window.flow_y, abs(advance_m), window.noise))
        x, y, moved_m, noise = map(sum, zip(*self._recent, strict=True))
        fast, slow = math.hypot(window.flow_x, window.flow_y), math.hypot(x, y)
        self._latest = fast, slow
        self.threshold = min_flow + FLOW_PER_M * abs(advance_m)
        slow_threshold = SLOW_SHARE * min_flow + FLOW_PER_M * moved_m
        agree = fast**2 >= COHERENCE**2 * window.noise or slow**2 >= COHERENCE**2 * noise
        self.moves = agree and (fast > 0.5 * self.threshold or slow > 0.5 * slow_threshold)
        if self.learned:
            self.threshold = max(self.threshold, self._fast.threshold)
            slow_threshold = max(slow_threshold, self._slow.threshold)
        # On one scale: the sum as if its threshold were that of the single window.
        found = max(fast, slow * self.threshold / slow_threshold)
        self.flow = found if agree or self.slipping else 0.0
        if self.learned and self.flow > self.threshold:
            self.slipping, self._quiet = True, 0
        elif self.slipping:
            self._quiet = self._quiet + 1 if self.flow <= RELEASE_SHARE * self.threshold else 0
            self.slipping = self._quiet < RELEASE_WINDOWS
        return self.slipping

    def learn(self, window: SlipWindow) -> None:
        """Learn from the latest window; a skin that moves is not at rest."""
        if window.guided and not self.moves:
            self._fast.learn(self._latest[0])
            self._slow.learn(self._latest[1])

    def reset(self) -> None:
        """Forget the thresholds."""
        self._fast.reset()
        self._slow.reset()
        self.slipping = False
        self._recent.clear()


class Detectors:
    """Runs both detectors and lets them learn at rest.

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

    @property
    def by_count(self) -> bool:
        """Whether the event count decides."""
        return self._parameters().law == PAPER

    @property
    def learned(self) -> bool:
        """Whether the thresholds of the detector that decides are known."""
        return self.count.learned and (self.by_count or self.flow.learned)

    def update(self, window: SlipWindow, advance_m: float) -> bool:
        """Return whether the object slips; until they are learned, learn from the window instead.

        Args:
            window: The next window. A change of light is not a slip.
            advance_m: Commanded motion of the arm within it [m].
        """
        if window.light:
            self.slipping = False
            return False
        by_count = self.count.update(window)
        by_flow = self.flow.update(window, self._parameters().min_flow, advance_m)
        self.slipping = by_count if self.by_count else by_flow
        if window.complete and not self.slipping:
            self.count.learn(float(window.count))
            self.flow.learn(window)
        return self.slipping

    def reset(self) -> None:
        """Forget the thresholds."""
        self.count.reset()
        self.flow.reset()
        self.slipping = self.count.slipping = False


LEARNING_S: Final = LEARNING_WINDOWS * WINDOW_S
"""Time at rest from which thresholds are learned [s]."""
