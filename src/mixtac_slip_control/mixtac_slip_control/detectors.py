# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Slip detectors: the event count of the paper and the translation of the skin, with hysteresis.

Count (paper, section Closed loop Slip Control): slip is detected when the event count N_t of a 1 ms
window exceeds the background threshold N_th. A count cannot distinguish slip from a change of
force, which moves beads too. It is the paper's law, kept as the baseline; added are a threshold by
false-alarm rate, hysteresis, and a threshold that rises with the advance in progress, which causes
events as well.

Flow: translation of the skin around the contact. Events of a changing normal force point away from
the contact and cancel in the translation, and so do pixels that flicker without motion. One window
is checked for fast slip, and a sum over several for slow slip, whose motion adds up while noise
does not. In either the events have to agree: where many fire at once, as when a lamp is switched
on, what is left of their sum is no motion.

`Detectors` runs both on the same windows and lets them learn their background while the contact is
at rest. Event counts at rest have tails much heavier than a Poisson process (frame read-out, hot
pixels, ripple), so neither a Poisson nor a normal distribution gives a threshold. `Background`
measures the tail itself: excesses over a high quantile follow a generalised Pareto distribution
(Pickands 1975, Balkema and de Haan 1974). Its scale comes from their mean, its shape is an
assumption (`tail_shape`).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mixtac_slip_control.features import COHERENCE, SlipWindow
from mixtac_slip_control.parameters import SlipControlParameters

TAIL: Final = 0.1
"""Share of the windows at rest that form the tail."""
CLIP_SCALES: Final = 12.0
"""Larger excesses count as this many scales: a single impact must not raise the threshold."""


class Background:
    """Median of a quantity at rest, and start and scale of its tail.

    Args:
        parameters: How it is learned and how far out the threshold lies.
        resolution: Smallest scale of the tail: 1 for counts.

    Attributes:
        learned: Whether enough windows have been seen.
        median: Median at rest; 0 until learned.
        start: Where the tail starts: the quantile of 1 - `TAIL`.
        scale: Scale of the tail.
    """

    def __init__(self, parameters: SlipControlParameters, resolution: float = 1.0) -> None:
        self._resolution = resolution
        self._first: list[float] = []
        self.median = self.start = 0.0
        self.scale = resolution
        self.learned = False
        self.configure(parameters)

    @property
    def threshold(self) -> float:
        """What a window at rest exceeds with the stated probability."""
        return self.start + self._reach * self.scale

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters; what was learned stays."""
        self._parameters = parameters
        self._followed = parameters.background_time_constant / parameters.window
        alarms = parameters.false_alarms_per_hour * parameters.window / 3600.0
        ratio, shape = TAIL / alarms, parameters.tail_shape
        # Distance of the threshold from the start of the tail, in scales.
        self._reach = math.log(ratio) if shape == 0.0 else (math.pow(ratio, shape) - 1.0) / shape

    def update(self, value: float) -> None:
        """Learn from a window at rest."""
        if not self.learned:
            self._learn(value)
            return
        # Stochastic approximation of the two quantiles: steps of a size set by the tail's scale.
        gain = 1.0 / self._followed
        step = gain * 10.0 * self.scale
        self.median += step * (0.5 if value > self.median else -0.5)
        above = value > self.start
        self.start += step * ((1.0 - TAIL) if above else -TAIL)
        if above:
            excess = min(value - self.start, CLIP_SCALES * self.scale)
            self.scale += gain / TAIL * (excess * (1.0 - self._parameters.tail_shape) - self.scale)
            self.scale = max(self.scale, self._resolution)

    def reset(self) -> None:
        """Forget the background; it is learned again."""
        self._first.clear()
        self.median = self.start = 0.0
        self.scale = self._resolution
        self.learned = False

    def _learn(self, value: float) -> None:
        self._first.append(value)
        if len(self._first) < self._parameters.learning_windows:
            return
        values = np.array(self._first)
        self.median, self.start = (float(q) for q in np.quantile(values, (0.5, 1.0 - TAIL)))
        excess = values[values > self.start] - self.start
        # The mean of a generalised Pareto distribution is scale / (1 - shape).
        mean = float(excess.mean()) if len(excess) else 0.0
        self.scale = max(mean * (1.0 - self._parameters.tail_shape), self._resolution)
        self._first.clear()
        self.learned = True


class Hysteresis:
    """Turns a value and its threshold into slipping or not.

    Args:
        parameters: When a slip has ended.

    Attributes:
        active: Whether it slipped in the latest window.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self.configure(parameters)
        self.reset()

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters."""
        self._ratio = parameters.release_ratio
        self._windows = max(1, parameters.windows(parameters.release_time))

    def update(self, value: float, background: float, threshold: float) -> bool:
        """Decide on a window and return whether it slips."""
        release = background + self._ratio * (threshold - background)
        if value > threshold:
            self.active = True
            self._quiet = 0
        elif self.active:
            self._quiet = self._quiet + 1 if value <= release else 0
            self.active = self._quiet < self._windows
        return self.active

    def reset(self) -> None:
        """Return to rest."""
        self.active = False
        self._quiet = 0


class Detector:
    """What both detectors share: backgrounds at rest and the hysteresis of the decision.

    Args:
        parameters: Thresholds, background and hysteresis.
        backgrounds: What it learns at rest.

    Attributes:
        threshold: Threshold in the latest window.
    """

    def __init__(
        self, parameters: SlipControlParameters, backgrounds: tuple[Background, ...]
    ) -> None:
        self._parameters = parameters
        self._backgrounds = backgrounds
        self._state = Hysteresis(parameters)
        self.threshold = 0.0

    @property
    def learned(self) -> bool:
        """Whether the background is learned."""
        return self._backgrounds[0].learned

    @property
    def slipping(self) -> bool:
        """Whether it slipped in the latest window."""
        return self._state.active

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters; what was learned stays."""
        self._parameters = parameters
        self._state.configure(parameters)
        for background in self._backgrounds:
            background.configure(parameters)

    def reset(self) -> None:
        """Forget the background."""
        self._state.reset()
        for background in self._backgrounds:
            background.reset()


class CountDetector(Detector):
    """Decides for each window by its count whether the object slips.

    Args:
        parameters: When a count means slip.

    Attributes:
        background: The counts at rest.
        threshold: N_th in the latest window: what no count at rest exceeds.
        expected: What counts at rest seldom exceed, and the events of the advance: what is above
            comes from slip once slip is known by other means.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self.background = Background(parameters)
        super().__init__(parameters, (self.background,))
        self.expected = 0.0

    def update(self, window: SlipWindow, advance_m: float = 0.0) -> bool:
        """Decide on a window.

        Args:
            window: The window.
            advance_m: Commanded motion of the arm within it [m], of either sign.

        Returns:
            Whether the object slips; never before the background is learned.
        """
        middle = self.background.median
        still = max(self.background.threshold, middle + self._parameters.min_excess)
        own = 1e3 * self._parameters.advance_events_per_mm * abs(advance_m)
        self.threshold, self.expected = still + own, self.background.start + own
        return self.learned and self._state.update(window.count, middle, self.threshold)

    def learn(self, window: SlipWindow) -> None:
        """Learn from a complete window at rest."""
        self.background.update(float(window.count))


FLOW_RESOLUTION: Final = 1e-5
"""Smallest scale of the tail of the translation [px per contrast threshold]."""


class FlowDetector(Detector):
    """Decides for each window by the translation of the skin whether the object slips.

    Without a frame there is no translation: such windows are quiet, and `learned` is false until
    enough windows with a frame have been seen. Lengths are in px per contrast threshold.

    Args:
        parameters: When translation means slip.

    Attributes:
        threshold: Threshold of the translation in the latest window.
        flow: Translation in the latest window, or the share of the slow sum where that is higher;
            0 where the events do not agree on one.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self._fast = Background(parameters, FLOW_RESOLUTION)
        self._slow = Background(parameters, FLOW_RESOLUTION)
        super().__init__(parameters, (self._fast, self._slow))
        self._ring = np.zeros((parameters.slow_windows, 4))
        self._next = 0
        self._latest = (0.0, 0.0)
        self._moves = False
        self.flow = 0.0

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters; another slow_time starts learning again."""
        super().configure(parameters)
        if parameters.slow_windows != len(self._ring):
            self._ring = np.zeros((parameters.slow_windows, 4))
            self._next = 0
            self._slow.reset()
            self._fast.reset()

    def update(self, window: SlipWindow, advance_m: float = 0.0) -> bool:
        """Decide on a window.

        Args:
            window: The window.
            advance_m: Commanded motion of the arm within it [m], of either sign.

        Returns:
            Whether the object slips; never before the background is learned.
        """
        self._ring[self._next] = (window.flow_x, window.flow_y, abs(advance_m), window.noise)
        self._next = (self._next + 1) % len(self._ring)
        total = self._ring.sum(axis=0)
        fast = math.hypot(window.flow_x, window.flow_y)
        slow = math.hypot(float(total[0]), float(total[1]))
        self._latest = (fast, slow)
        p = self._parameters
        per_m = 1e3 * p.advance_flow_per_mm
        self.threshold = max(self._fast.threshold, p.min_flow) + per_m * abs(advance_m)
        slow_threshold = max(self._slow.threshold, p.min_slow_flow) + per_m * float(total[2])
        least = COHERENCE**2
        agree = fast * fast >= least * window.noise or slow * slow >= least * float(total[3])
        self._moves = agree and (fast > 0.5 * p.min_flow or slow > 0.5 * p.min_slow_flow)
        # On one scale: the sum as if its threshold were that of the single window.
        found = max(fast, slow * self.threshold / slow_threshold)
        self.flow = found if agree or self.slipping else 0.0
        return self.learned and self._state.update(self.flow, 0.0, self.threshold)

    def learn(self, window: SlipWindow) -> None:
        """Learn from a complete window at rest, the one of the latest update.

        One in which the skin moves is not at rest: objects that hardly hold slip by some hundredths
        of a millimetre now and then, and one such slip would raise the thresholds several times.
        """
        if window.guided and not self._moves:
            self._fast.update(self._latest[0])
            self._slow.update(self._latest[1])

    def reset(self) -> None:
        """Forget the background."""
        super().reset()
        self._ring[:] = 0.0


class Detectors:
    """Runs both detectors and lets them learn at rest.

    Args:
        parameters: Which of them decides, and the settings of both.

    Attributes:
        count: The paper's law.
        flow: The flow detector.
        slipping: Decision of the chosen one on the latest window.
    """

    def __init__(self, parameters: SlipControlParameters) -> None:
        self._parameters = parameters
        self.count = CountDetector(parameters)
        self.flow = FlowDetector(parameters)
        self.slipping = False
        self._rest = parameters.settle_windows

    @property
    def learned(self) -> bool:
        """Whether the background that the chosen detector and the law need is known."""
        return self.count.learned and (self._parameters.detector == 'count' or self.flow.learned)

    @property
    def law_threshold(self) -> float:
        """N_th of the advance law: with the flow detector, counts need not detect slip as well."""
        by_flow = self._parameters.detector == 'flow'
        return self.count.expected if by_flow else self.count.threshold

    def configure(self, parameters: SlipControlParameters) -> None:
        """Use other parameters; what was learned stays."""
        self._parameters = parameters
        self.count.configure(parameters)
        self.flow.configure(parameters)

    def update(self, window: SlipWindow, advance_m: float) -> bool:
        """Decide on a window, and learn from it if the contact is at rest.

        Args:
            window: The next window.
            advance_m: Commanded motion of the arm within it [m].

        Returns:
            Whether the object slips, by the chosen detector; a change of light is no slip.
        """
        if window.light:
            # Neither detector sees it, and no advance answers it; a slip goes on afterwards.
            self._rest = 0
            self.slipping = False
            return False
        by_count = self.count.update(window, advance_m)
        by_flow = self.flow.update(window, advance_m)
        self.slipping = by_flow if self._parameters.detector == 'flow' else by_count
        moving = by_count or by_flow or advance_m != 0.0
        self._rest = 0 if moving else self._rest + 1
        if window.complete and self._rest >= self._parameters.settle_windows:
            self.count.learn(window)
            self.flow.learn(window)
        return self.slipping

    def reset(self) -> None:
        """Forget what was learned."""
        self.count.reset()
        self.flow.reset()
        self.slipping = False
        self._rest = self._parameters.settle_windows
