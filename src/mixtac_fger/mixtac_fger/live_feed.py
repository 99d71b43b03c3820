# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""From message fields to the estimator: decoding, counting losses, timing."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from mixtac_events.codec import PacketMessage, decode_message
from mixtac_events.errors import CodecError
from mixtac_fger.errors import ImageError
from mixtac_fger.streaming import EstimatorStatus, ForceEstimator
from mixtac_node.image_conversion import ImageConversionError, grey
from mixtac_node.rates import RateMeter, RecentValues

if TYPE_CHECKING:
    from array import array

    from mixtac_fger.weights import LoadedModel


class NumberedPacket(PacketMessage, Protocol):
    """The fields of `event_camera_msgs/EventPacket` in use."""

    seq: int


class ImageMessage(Protocol):
    """The fields of `sensor_msgs/Image` in use."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: array[int]


@dataclass(frozen=True, slots=True)
class FeedStatus:
    """The estimator's status and the losses before it.

    Attributes:
        estimator: Of the estimator.
        rate_hz: Forces per second since the previous status.
        step_p50_ms: Median time of a window, packet decoding included.
        step_p99_ms: 99th percentile of it.
        lost_packets: Event packets missing by their sequence numbers.
        bad_messages: Packets and images that could not be read.
        problem: The latest reason for one, empty if there was none.
    """

    estimator: EstimatorStatus
    rate_hz: float
    step_p50_ms: float
    step_p99_ms: float
    lost_packets: int
    bad_messages: int
    problem: str


class LiveFeed:
    """Feeds an estimator with the contents of messages; never raises on bad ones.

    Args:
        model: Network with its weights.
        contact_threshold_n: See `ForceEstimator`.
        force_scale: See `ForceEstimator`.
    """

    def __init__(
        self, model: LoadedModel, contact_threshold_n: float, force_scale: float = 1.0
    ) -> None:
        self.estimator = ForceEstimator(
            model,
            background_frames=True,
            force_scale=force_scale,
            contact_threshold_n=contact_threshold_n,
        )
        self._size = (model.config.width, model.config.height)
        self._sequence: int | None = None
        self._lost_packets = 0
        self._bad_messages = 0
        self._problem = ''
        self._rate = RateMeter()
        self._durations = RecentValues()

    def packet(self, message: NumberedPacket) -> list[tuple[int, float]]:
        """Take an event packet and return (window end [us], force [N]) of the windows it closes."""
        started = time.perf_counter()
        self._count_losses(message.seq)
        size = (message.width, message.height)
        if size != self._size:
            self._refuse(f'events of a {size} sensor: the model reads {self._size}')
            return []
        try:
            packet = decode_message(message)
            forces = self.estimator.push_events(packet.events, packet.complete_until)
        except CodecError as error:
            self._refuse(str(error))
            return []
        if forces:
            self._durations.add((time.perf_counter() - started) * 1e3 / len(forces))
            self._rate.add(len(forces))
        return forces

    def image(self, message: ImageMessage, mid_us: int) -> None:
        """Take an image; colours become grey.

        Args:
            message: A `sensor_msgs/Image`; its data are not to be changed afterwards.
            mid_us: Centre of the exposure, camera clock [us].
        """
        try:
            self.estimator.push_frame(grey(message), mid_us)
        except (ImageError, ImageConversionError) as error:
            self._refuse(str(error))

    def status(self) -> FeedStatus:
        """Return the figures; the rate is that since the previous call."""
        return FeedStatus(
            estimator=self.estimator.status(),
            rate_hz=self._rate.read(time.monotonic()),
            step_p50_ms=self._durations.quantile(0.5),
            step_p99_ms=self._durations.quantile(0.99),
            lost_packets=self._lost_packets,
            bad_messages=self._bad_messages,
            problem=self._problem,
        )

    def close(self) -> None:
        """End the estimator's thread."""
        self.estimator.close()

    def _count_losses(self, sequence: int) -> None:
        if self._sequence is not None and sequence > self._sequence:
            self._lost_packets += sequence - self._sequence - 1
        self._sequence = sequence

    def _refuse(self, problem: str) -> None:
        self._bad_messages += 1
        self._problem = problem
