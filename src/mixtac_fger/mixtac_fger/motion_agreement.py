# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
r"""Whether frames and the events between them tell of the same motion, at the same time.

Of two frames and the events between them, both in their noise, one motion makes a correlation of

.. math:: e = \sqrt{(1 - n_f^2 / f^2) (1 - n_e^2 / e^2)},

the geometric mean of their shares of signal, where f and e are the root mean squares of change and
events, n those at rest. Pairs with little of it are put together until their :math:`\sum e^2` is
enough to judge by. Late frames, or late events, tell of the motion of the pair before: there they
correlate better.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixtac_fger.comparisons import agreement

F32 = NDArray[np.float32]

CLEAR, CLEARER, EVIDENCE = 0.3, 0.7, 0.6
"""Expected correlation from which on a pair counts, and from which on one is clear; sum of its
squares at which it is judged."""
RESTED = 1500
"""Pairs below all that, a minute, after which what did not agree is forgotten: noise that has grown
disagrees, too, until it has become what is usual."""
LEAST_AGREEMENT, LEAST_CLEAR_AGREEMENT = 0.15, 0.3
"""Correlation over the expected one. In 1631 judgements of 72 trials without a fault (15 minutes)
0.39 and more, of 1195 clear ones 0.57. What does not agree is not trusted until it does."""
CERTAIN_AGREEMENT = 0.5
"""The same from which on events are right even if their noise has another pattern than before."""
TIMING_EVIDENCE, LATE_FRAMES, LATE_EVENTS = 2.5, 0.05, 0.3
"""Sum of squares at which the time is judged, and what the correlation with the pair before, of
frames and of events, may be more than that of the pair. In 1,377 judgements of 134 trials without
a fault -0.06 and 0.23 at most."""


class Pair(NamedTuple):
    """Two frames in a row, and the events between them.

    Attributes:
        before: Coarse log contrast of the earlier frame, float32 [rows, columns].
        after: The same of the later one.
        told: ON less OFF events per pixel between their centres, same shape.
        change: Root mean square of the change [log units].
        events: The same of `told`.
        correlation: Of both.
        changed: Share of signal in the square of `change`.
        moved: Share of signal in the square of `events`.
    """

    before: F32
    after: F32
    told: F32
    change: float
    events: float
    correlation: float
    changed: float
    moved: float


def pair_of(before: F32, after: F32, told: F32, noise: float, murmur: float) -> Pair:
    """Compare two frames with the events between them.

    Args:
        before: See `Pair`; not copied, as the next two.
        after: See `Pair`.
        told: See `Pair`.
        noise: Root mean square of a change at rest [log units]; 0 where it is unknown.
        murmur: The same of `told`.
    """
    change, events, correlation, *_ = agreement(before, after, told)
    shares = (_signal_share(change, noise), _signal_share(events, murmur))
    return Pair(before, after, told, change, events, correlation, *shares)


def _signal_share(total: float, noise: float) -> float:
    """Return the share of the variance that is not noise, of root mean squares."""
    return 1.0 - min(noise / total, 1.0) ** 2 if total > 0.0 and noise > 0.0 else 0.0


class MotionAgreement:
    """Follows pairs of frames.

    Attributes:
        apart: Frames and events tell of different motions.
        late: They tell of the same one at different times.
        certain: The latest judgement, of this pair, is that they agree.
    """

    def __init__(self) -> None:
        self.apart = self.late = self.certain = False
        self._expected = self._alike = 0.0
        self._rested = 0
        self._latest: Pair | None = None
        self._lag = [0.0, 0.0]
        self._timed = [0.0, 0.0]

    def skip(self) -> None:
        """Go on after a hole in the stream, or a pair that cannot be compared."""
        self._latest = None

    def contradict(self) -> None:
        """Note that they have told of different motions in some other way."""
        self.apart = True
        self._expected = self._alike = 0.0

    def pair(self, pair: Pair, *, usable: bool) -> None:
        """Take two frames in a row.

        Args:
            pair: Them, and the events between them.
            usable: Whether they can be compared with these: no blow, no motion to and fro.
        """
        latest, self._latest = self._latest, pair if usable else None
        self.certain = False
        expected = math.sqrt(pair.changed * pair.moved)
        self._rested = 0 if expected >= CLEAR else self._rested + 1
        if self._rested >= RESTED:
            self.apart = self.late = False
        if not usable:
            return
        if expected >= CLEAR:
            self._judge(pair, expected)
        if latest is not None and latest.after is pair.before:
            self._judge_time(latest, pair, expected)

    def _judge(self, pair: Pair, expected: float) -> None:
        self._expected += expected * expected
        self._alike += expected * pair.correlation
        clear = expected >= CLEARER and pair.correlation < LEAST_CLEAR_AGREEMENT * expected
        if clear or self._expected >= EVIDENCE:
            self.apart = clear or self._alike < LEAST_AGREEMENT * self._expected
            self.certain = self._alike > CERTAIN_AGREEMENT * self._expected
            self._expected = self._alike = 0.0

    def _judge_time(self, latest: Pair, pair: Pair, expected: float) -> None:
        """Compare the frames of a pair with the events of the pair before, and the reverse."""
        shares = (pair.changed * latest.moved, latest.changed * pair.moved)
        others = ((pair.before, pair.after, latest.told), (latest.before, latest.after, pair.told))
        late = []
        for index, most in enumerate((LATE_FRAMES, LATE_EVENTS)):
            weight = max(expected, math.sqrt(shares[index]))
            if weight >= CLEAR:
                *_, correlation, _, _ = agreement(*others[index])
                self._lag[index] += weight * (correlation - pair.correlation)
                self._timed[index] += weight * weight
            if self._timed[index] >= TIMING_EVIDENCE:
                late.append(self._lag[index] > most * self._timed[index])
                self._lag[index] = self._timed[index] = 0.0
        if late:
            self.late = any(late)
