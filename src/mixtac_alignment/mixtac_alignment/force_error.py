# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Running error of the estimated force against the reference, and the parameters of its node."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from mixtac_node.parameters import fixed


@dataclass(frozen=True)
class ForceErrorParameters:
    """Topics and length of the running force error.

    Attributes:
        force_topic: WrenchStamped topic of the estimate.
        reference_topic: WrenchStamped topic of the reference on the camera clock.
        window: Number of latest pairs over which the errors are averaged; 5000 are 10 s of
            estimates.
        sign: Sign that makes pressing positive in the reference.
    """

    force_topic: str = fixed('force')
    reference_topic: str = fixed('alignment/reference')
    window: int = fixed(5000, within=(10, 1_000_000))
    sign: int = fixed(1, within=(-1, 1))


class RunningError:
    """Errors of the latest pairs of estimate and reference.

    Args:
        window: Number of pairs.
    """

    def __init__(self, window: int) -> None:
        self._errors: deque[float] = deque(maxlen=window)

    def push(self, estimate_n: float, reference_n: float) -> None:
        """Add a pair of normal forces [N]."""
        self._errors.append(estimate_n - reference_n)

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
