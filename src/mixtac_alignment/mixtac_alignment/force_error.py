# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running error of the estimated force against the reference, and the parameters of its node."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

from mixtac_node.parameters import fixed


@dataclass(frozen=True)
class ForceErrorParameters:
    """Topics and length of the running force error."""

    force_topic: str = fixed('force', 'WrenchStamped topic of the estimate.')
    reference_topic: str = fixed(
        'alignment/reference',
        'WrenchStamped topic of the reference on the camera clock.',
    )
    window: int = fixed(
        5000,
        'Number of latest pairs over which the errors are averaged; 5000 are 10 s of estimates.',
        within=(10, 1_000_000),
    )
    sign: int = fixed(
        1,
        'Sign that makes pressing positive in the reference.',
        within=(-1, 1),
    )


class ForcePairing:
    """Pairs estimates with the reference interpolated to their time, and keeps running errors.

    Both streams are on the camera clock. An estimate waits until the reference has passed it.

    Attributes:
        unpaired: Estimates without reference samples close enough on both sides.

    Args:
        window: Pairs over which errors run.
        longest_gap_ns: Reference samples further apart than this are not interpolated [ns].
    """

    def __init__(self, window: int = 5000, longest_gap_ns: int = 20_000_000) -> None:
        self.unpaired = 0
        self._gap_ns = longest_gap_ns
        self._errors: deque[float] = deque(maxlen=window)
        self._waiting: deque[tuple[int, float]] = deque(maxlen=window)
        self._times: deque[int] = deque(maxlen=window)
        self._forces: deque[float] = deque(maxlen=window)

    def push_estimate(self, t_ns: int, force: float) -> None:
        """Add an estimated normal force [N] at a camera time [ns]."""
        if len(self._waiting) == self._waiting.maxlen:
            self.unpaired += 1
        self._waiting.append((t_ns, force))
        self._pair()

    def push_reference(self, t_ns: int, force: float) -> None:
        """Add a reference normal force [N] at a camera time [ns]; one that steps back restarts."""
        if self._times and t_ns <= self._times[-1]:
            self._times.clear()
            self._forces.clear()
        self._times.append(t_ns)
        self._forces.append(force)
        self._pair()

    @property
    def pairs(self) -> int:
        """Return over how many pairs the errors run."""
        return len(self._errors)

    @property
    def mae(self) -> float:
        """Return the mean absolute error [N]; 0 without pairs."""
        return sum(map(abs, self._errors)) / max(1, len(self._errors))

    @property
    def rmse(self) -> float:
        """Return the root mean square error [N]; 0 without pairs."""
        mean = sum(error * error for error in self._errors) / max(1, len(self._errors))
        return float(mean**0.5)

    def _pair(self) -> None:
        while self._waiting and self._times and self._waiting[0][0] <= self._times[-1]:
            t_ns, force = self._waiting.popleft()
            k = bisect_left(self._times, t_ns)
            if k == 0 and self._times[0] != t_ns:
                self.unpaired += 1
                continue
            before = max(0, k - 1)
            span = self._times[k] - self._times[before]
            if span > self._gap_ns:
                self.unpaired += 1
                continue
            part = (t_ns - self._times[before]) / span if span else 0.0
            low = self._forces[before]
            self._errors.append(force - low - part * (self._forces[k] - low))
