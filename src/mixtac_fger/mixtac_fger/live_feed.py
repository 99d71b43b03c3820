# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From ROS messages to the estimator: decoding, counting losses, timing, diagnostics."""

from __future__ import annotations

import time
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from mixtac_core.events.codec import PacketMessage, decode_message
from mixtac_core.events.packets import CodecError, SequenceCounter
from mixtac_core.node.diagnostics import ERROR, OK, WARN, RateMeter, RecentValues
from mixtac_core.node.images import ImageConversionError, decompress_grey, grey
from mixtac_fger.features import ImageError
from mixtac_fger.validity import Reason

if TYPE_CHECKING:
    from mixtac_fger.estimator import Estimate, EstimatorStatus
    from mixtac_fger.streaming import ForceEstimator


COMPARABLE_NS = 10_000_000_000
"""Ages beyond this, or below zero, come from replayed stamps or another host's clock [ns]."""
WATCHED = (
    *('lost_packets', 'repeated_packets', 'bad_messages', 'bad_frames', 'resets', 'late_events'),
    *('withheld', 'saturated', 'late', 'frames_off_clock', 'frames_dropped'),
)
"""Counters whose rise is a warning."""
MOST_DRIFT_N = 0.05
"""Drift of the zero beyond which a tare is due [N]."""


class FeedStatus(NamedTuple):
    """Status of the estimator, and losses and times on the way to it.

    Attributes:
        estimator: Status of the estimator.
        rate_hz: Forces per second since the previous status.
        values: All figures by name, for /diagnostics: those of the estimator, `age_p50_ms` and
            `age_p99_ms`, the time from the arrival of a packet at the host to the publication of
            its forces over the latest ones, NaN if the clocks cannot be compared, `late`, forces
            after the deadline, `lost_packets` and `repeated_packets` by the sequence numbers, and
            `bad_messages` that could not be read.
        problem: Why the latest message or frame since the previous status was refused; empty if
            none was.
        lately: Counters that rose since the previous status, a part of `WATCHED`.
    """

    estimator: EstimatorStatus
    rate_hz: float
    values: dict[str, Any]
    problem: str
    lately: dict[str, int]


def _comparable(age_ns: int) -> bool:
    """Return whether an age [ns] is the difference of times of one clock."""
    return 0 <= age_ns < COMPARABLE_NS


class LiveFeed:
    """Feeds an estimator with the contents of messages; bad messages are counted, never raised.

    Args:
        estimator: With `background_frames`.
        deadline_s: See below.

    Attributes:
        estimator: As given.
        deadline_s: Forces published later than this after the arrival of their packet are late [s];
            may be changed at any time.
    """

    def __init__(self, estimator: ForceEstimator, *, deadline_s: float = 0.003) -> None:
        self.estimator = estimator
        self.deadline_s = deadline_s
        self._sequence = SequenceCounter()
        self._late = self._bad_messages = 0
        self._missing = False
        self._before = dict.fromkeys(WATCHED, 0)
        self._problem = ''
        self._rate = RateMeter()
        self._ages = RecentValues()

    def packet(self, message: PacketMessage, age_ns: int = 0) -> list[Estimate]:
        """Return the forces of the windows that an event packet closes.

        Args:
            message: The packet.
            age_ns: Time since it arrived at the host [ns].
        """
        self.estimator.events_late_us = age_ns // 1000 if _comparable(age_ns) else 0
        repeated = self._sequence.repeated
        self._sequence.update(message.seq)
        if self._sequence.repeated > repeated:
            return []
        self._missing |= not self._sequence.continuous
        size, wanted = (message.width, message.height), self.estimator.size
        if size != wanted:
            self.refuse(
                f'events of a sensor of {size[0]} x {size[1]} pixels; the model reads'
                f' {wanted[0]} x {wanted[1]}'
            )
            return []
        try:
            packet = decode_message(message)
        except CodecError as error:
            self.refuse(str(error))
            return []
        missing, self._missing = self._missing, False
        forces = self.estimator.push_events(
            packet.events, packet.complete_until, lost_before=missing
        )
        self._rate.add(len(forces))
        return forces

    def refuse(self, problem: str) -> None:
        """Count a packet that could not be read: its events are missing.

        Args:
            problem: Why.
        """
        self._bad_messages += 1
        self._problem = problem
        self._missing = True

    def published(self, count: int, arrival_ns: int, now_ns: int) -> None:
        """Record that forces have been published.

        Args:
            count: How many.
            arrival_ns: `header.stamp` of the packet that completed them [ns, host].
            now_ns: Present time [ns, host].
        """
        age_ns = now_ns - arrival_ns
        if _comparable(age_ns):
            self._ages.add(age_ns / 1e6)
            if age_ns > 1e9 * self.deadline_s:
                self._late += count

    def image(self, message: Any, mid_us: int) -> None:  # noqa: ANN401
        """Push an image to the estimator; colours become grey.

        Args:
            message: A `sensor_msgs/Image`, or a `sensor_msgs/CompressedImage`, which is decoded
                where frames are encoded; its data must not be changed afterwards.
            mid_us: Centre of the exposure, camera clock [us].
        """
        compressed = hasattr(message, 'format')
        try:
            image: Any = partial(decompress_grey, message) if compressed else grey(message)
            self.estimator.push_frame(image, mid_us)
        except (ImageError, ImageConversionError) as error:
            self._problem = str(error)
            self._bad_messages += 1

    def status(self) -> FeedStatus:
        """Return the figures; rate and `lately` cover the time since the previous call."""
        estimator, rate_hz = self.estimator.status(), self._rate.read(time.monotonic())
        problem, self._problem = self._problem, ''
        values = asdict(estimator) | {
            'rate_hz': rate_hz,
            'age_p50_ms': self._ages.quantile(0.5),
            'age_p99_ms': self._ages.quantile(0.99),
            'late': self._late,
            'lost_packets': self._sequence.lost,
            'repeated_packets': self._sequence.repeated,
            'bad_messages': self._bad_messages,
        }
        now, before = {name: int(values[name]) for name in WATCHED}, self._before
        self._before = now
        lately = {name: rise for name in WATCHED if (rise := now[name] - before[name]) > 0}
        if 'bad_frames' in lately:
            problem = problem or estimator.problem
        return FeedStatus(estimator, rate_hz, values | {'problem': problem}, problem, lately)

    def close(self) -> None:
        """End the estimator's thread."""
        self.estimator.close()


def feed_diagnosis(found: FeedStatus) -> tuple[int, str]:
    """Return the level and the message of a status on /diagnostics.

    A force that cannot be trusted is an error, an unknown zero a warning: it waits for ~/tare.

    Args:
        found: Status of the active estimator.
    """
    estimator, level = found.estimator, WARN
    parts = []
    if estimator.reason:
        parts.append(estimator.reason)
    elif found.rate_hz == 0.0:
        parts.append('no force in the last second: no event packets arrive')
    if not estimator.reason and estimator.validity != Reason.TRUSTED.name:
        reason = Reason[estimator.validity]
        parts.append(f'the force is not valid: {reason.text}')
        level = WARN if reason is Reason.ZERO_UNKNOWN else ERROR
    if abs(estimator.zero_drift) > MOST_DRIFT_N:
        parts.append(
            f'the zero has drifted by {estimator.zero_drift:+.2f} N, or something light rests on'
            ' the sensor: release it and call ~/tare'
        )
    if found.lately:
        rises = (f'{count} {name.replace("_", " ")}' for name, count in found.lately.items())
        parts.append('since the last report: ' + ', '.join(rises))
    if found.problem and found.problem not in estimator.reason:
        parts.append(found.problem)
    return (level, '; '.join(parts)) if parts else (OK, 'estimating')
